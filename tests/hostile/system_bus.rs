//! A private system bus: Debian's policy for system buses, the policy shipped with this project, and polkit with our
//! actions and rules only.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tactus_tests::DEADLINE;

const POLICY: &str = concat!(
    env!("CARGO_MANIFEST_DIR"),
    "/../systemd/org.tactus.Tactus1.conf"
);
const ACTIONS: &str = include_str!("../../systemd/org.tactus.Tactus1.policy");
const RULES: &str = include_str!("../../systemd/org.tactus.Tactus1.rules");
const POLKIT_POLICY: &str = "/usr/share/dbus-1/system.d/org.freedesktop.PolicyKit1.conf";
const POLKIT_NAME: &str = "org.freedesktop.PolicyKit1";
/// Paths of polkitd: Debian's, then that of other distributions.
const POLKITD: [&str; 2] = ["/usr/lib/polkit-1/polkitd", "/usr/libexec/polkitd"];
/// Replaces the machine's actions and rules by ours, for polkit's process only.
const POLKIT_HERE: &str = "mount --make-rprivate / && mount --bind \"$1/actions\" /usr/share/polkit-1/actions && \
                           mount --bind \"$1/rules.d\" /usr/share/polkit-1/rules.d && exec \"$0\" --no-debug";

/// A message bus, and polkit on it; both end when this is dropped.
#[derive(Debug)]
pub struct SystemBus {
    broker: Child,
    polkit: Option<Child>,
    socket: PathBuf,
}

impl SystemBus {
    /// Starts it in this folder; without polkit if that is not available, which is printed.
    pub async fn start(folder: &Path) -> Self {
        let socket = folder.join("system-bus");
        let config = folder.join("system-bus.conf");
        std::fs::write(
            &config,
            format!(
                r#"<!DOCTYPE busconfig PUBLIC "-//freedesktop//DTD D-Bus Bus Configuration 1.0//EN"
 "http://www.freedesktop.org/standards/dbus/1.0/busconfig.dtd">
<busconfig>
  <type>system</type>
  <listen>unix:path={}</listen>
  <auth>EXTERNAL</auth>
  <policy context="default">
    <allow user="*"/>
    <deny own="*"/>
    <deny send_type="method_call"/>
    <allow send_type="signal"/>
    <allow send_requested_reply="true" send_type="method_return"/>
    <allow send_requested_reply="true" send_type="error"/>
    <allow receive_type="method_call"/>
    <allow receive_type="method_return"/>
    <allow receive_type="error"/>
    <allow receive_type="signal"/>
    <allow send_destination="org.freedesktop.DBus" send_interface="org.freedesktop.DBus"/>
    <allow send_destination="org.freedesktop.DBus" send_interface="org.freedesktop.DBus.Introspectable"/>
    <allow send_destination="org.freedesktop.DBus" send_interface="org.freedesktop.DBus.Properties"/>
    <deny send_destination="org.freedesktop.DBus" send_interface="org.freedesktop.DBus" send_member="UpdateActivationEnvironment"/>
  </policy>
  <include>{POLICY}</include>
  <include ignore_missing="yes">{POLKIT_POLICY}</include>
</busconfig>
"#,
                socket.display()
            ),
        )
        .unwrap();
        let mut broker = Command::new("dbus-daemon")
            .arg(format!("--config-file={}", config.display()))
            .args(["--nofork", "--nopidfile", "--print-address=1"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // it prints its address once it is listening
        let mut line = String::new();
        let stdout = broker.stdout.take().unwrap();
        BufReader::new(stdout).read_line(&mut line).unwrap();
        assert!(line.contains("unix:path="), "dbus-daemon: {line}");
        let mut bus = Self {
            broker,
            polkit: None,
            socket,
        };
        if let Err(why) = bus.start_polkit(folder).await {
            assert!(
                !needs::required("POLKIT"),
                "TACTUS_REQUIRE_POLKIT=1, and {why}"
            );
            eprintln!("without polkit, by the daemon's own rule: {why}");
        }
        bus
    }

    async fn start_polkit(&mut self, folder: &Path) -> Result<(), String> {
        let program = POLKITD
            .into_iter()
            .find(|path| Path::new(path).exists())
            .ok_or("polkitd is not installed")?;
        let files = folder.join("polkit");
        for (name, text) in [
            ("actions/org.tactus.Tactus1.policy", ACTIONS),
            ("rules.d/50-tactus.rules", RULES),
        ] {
            let path = files.join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        }
        let log = folder.join("polkitd.log");
        let child = Command::new("unshare")
            .args(["--mount", "sh", "-c", POLKIT_HERE, program])
            .arg(&files)
            .env("DBUS_SYSTEM_BUS_ADDRESS", self.address())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(&log).unwrap())
            .spawn()
            .map_err(|error| format!("unshare: {error}"))?;
        let child = self.polkit.insert(child);
        let client = zbus::connection::Builder::address(
            format!("unix:path={}", self.socket.display()).as_str(),
        )
        .build()
        .await
        .unwrap();
        let broker = zbus::fdo::DBusProxy::new(&client).await.unwrap();
        let begun = Instant::now();
        while !broker
            .name_has_owner(POLKIT_NAME.try_into().unwrap())
            .await
            .unwrap()
        {
            if let Some(ended) = child.try_wait().unwrap() {
                let message = std::fs::read_to_string(&log).unwrap_or_default();
                self.polkit = None;
                return Err(format!("polkitd ended ({ended}): {message}"));
            }
            assert!(
                begun.elapsed() < DEADLINE,
                "polkitd does not come to the bus"
            );
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        Ok(())
    }

    /// Path of its socket.
    pub fn socket(&self) -> &Path {
        &self.socket
    }

    /// Value for `DBUS_SYSTEM_BUS_ADDRESS`.
    pub fn address(&self) -> String {
        format!("unix:path={}", self.socket.display())
    }
}

impl Drop for SystemBus {
    fn drop(&mut self) {
        for child in self.polkit.iter_mut().chain([&mut self.broker]) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
