//! Third-party clients suffice: `busctl` reads a map from the session bus, a short Python program reads the stream.

use std::io::Read;
use std::os::fd::OwnedFd;
use std::process::{Child, Command, Stdio};

use dbus::{Address, Options, Session1Proxy};

use crate::test_rig::{self, Needs, ask, baseline};

/// A private message bus, ended with the story.
struct Broker {
    child: Child,
    address: String,
}

impl Broker {
    fn start(folder: &std::path::Path) -> Self {
        let config = folder.join("bus.conf");
        std::fs::write(
            &config,
            format!(
                "<busconfig><type>session</type><listen>unix:path={}/bus</listen><auth>EXTERNAL</auth>\
                 <policy context=\"default\"><allow send_destination=\"*\" eavesdrop=\"true\"/><allow own=\"*\"/>\
                 <allow eavesdrop=\"true\"/></policy></busconfig>",
                folder.display()
            ),
        )
        .expect("the story's folder can be written");
        let mut child = Command::new("dbus-daemon")
            .arg(format!("--config-file={}", config.display()))
            .args(["--print-address=1", "--nofork"])
            .stdout(Stdio::piped())
            .spawn()
            .expect("dbus-daemon is installed");
        let mut address = Vec::new();
        let mut pipe = child.stdout.take().expect("its output is a pipe");
        let mut byte = [0];
        while pipe.read_exact(&mut byte).is_ok() && byte[0] != b'\n' {
            address.push(byte[0]);
        }
        Self {
            child,
            address: String::from_utf8(address).expect("an address is text"),
        }
    }
}

impl Drop for Broker {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn busctl_reads_a_map() {
    if !(needs::program("DBUS", "dbus-daemon") && needs::program("DBUS", "busctl")) {
        return;
    }
    let on_the_bus = |config: &str| format!("{config}session = true\n");
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, on_the_bus) else {
        return;
    };
    let broker = Broker::start(stage.path());
    let _guard = stage
        .start_daemon_with(|command| {
            command.env("DBUS_SESSION_BUS_ADDRESS", &broker.address);
        })
        .unwrap_or_else(|fault| panic!("{fault}"));
    baseline(&stage, 2);
    let id = test_rig::measure(&stage, 1);
    let busctl = |words: &[&str]| {
        let message = Command::new("busctl")
            .arg(format!("--address={}", broker.address))
            .args(words)
            .output()
            .expect("busctl runs");
        assert!(
            message.status.success(),
            "busctl {words:?}: {}",
            String::from_utf8_lossy(&message.stderr)
        );
        String::from_utf8_lossy(&message.stdout).into_owned()
    };
    let session = format!("/org/tactus/Tactus1/session/{id}");
    let map = busctl(&[
        "call",
        dbus::BUS_NAME,
        &session,
        dbus::SESSION_INTERFACE,
        "LatestMap",
    ]);
    // the value of a key in a reply: the word after the key and its type
    let value = |reply: &str, key: &str| {
        let mut words = reply.split_whitespace().map(str::to_owned);
        assert_eq!(words.next().as_deref(), Some("a{sv}"), "{reply:.200}");
        words.find(|word| *word == format!("\"{key}\""));
        words.nth(1)
    };
    let sequence = value(&map, "sequence");
    assert_eq!(sequence.as_deref(), Some("1"), "the first frame's map");
    let values = value(&map, "values").expect("a map has values");
    let values: usize = values.parse().expect("the length of the array");
    assert!((3000..5000).contains(&values), "{values} triangles");
    let frame = busctl(&[
        "call",
        dbus::BUS_NAME,
        &session,
        dbus::SESSION_INTERFACE,
        "LatestFrame",
    ]);
    let volts = value(&frame, "volts");
    assert_eq!(volts.as_deref(), Some("598"), "598 voltages");
    let state = busctl(&[
        "get-property",
        dbus::BUS_NAME,
        dbus::ROOT_PATH,
        dbus::MANAGER_INTERFACE,
        "State",
    ]);
    assert_eq!(state.trim(), "s \"idle\"");
    // the daemon that owns the name keeps it: a second one with another state directory is refused
    let second = Command::new("busctl")
        .arg(format!("--address={}", broker.address))
        .args(["status", dbus::BUS_NAME])
        .output()
        .expect("busctl runs");
    assert!(second.status.success());
}

#[test]
fn twenty_lines_of_python_read_the_stream() {
    if !needs::program("PYTHON", "python3") {
        return;
    }
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 2);
    let id = ask(&stage, &["start", "--step"])[0]["session"]
        .as_str()
        .expect("an id")
        .to_owned();
    let stream: OwnedFd = test_rig::runtime().block_on(async {
        let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path())))
            .await
            .expect("the daemon listens");
        let path = dbus::session_path(&id).expect("an id makes a path");
        let session = Session1Proxy::new(&connection, path)
            .await
            .expect("the session is there");
        let stream = session
            .open_stream(&Options::new())
            .await
            .expect("a stream is handed out");
        session.step(3).await.expect("frames are taken");
        session.stop().await.expect("the session ends");
        stream.into()
    });
    let reader = Command::new("python3")
        .arg(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../dbus/stream_reader.py"
        ))
        .stdin(Stdio::from(stream))
        .output()
        .expect("python3 runs");
    assert!(
        reader.status.success(),
        "{}",
        String::from_utf8_lossy(&reader.stderr)
    );
    let records: Vec<serde_json::Value> = String::from_utf8_lossy(&reader.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).expect("one object a line"))
        .collect();
    let of = |kind: &str| {
        records
            .iter()
            .filter(|record| record["kind"] == kind)
            .collect::<Vec<_>>()
    };
    assert_eq!(of("frame").len(), 3);
    assert_eq!(of("map").len(), 3);
    assert_eq!(of("end").len(), 1);
    for (frame, sequence) in of("frame").iter().zip(1..) {
        assert_eq!(frame["sequence"], sequence);
        assert_eq!(frame["gap"], 0);
        assert_eq!(frame["volts"].as_array().map(Vec::len), Some(598));
        assert_eq!(frame["simulated"], std::env::var_os("TACTUS_RIG").is_none());
    }
}
