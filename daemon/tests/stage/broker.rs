//! A private bus for a test.

use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A broker that ends with the test.
pub struct Broker {
    child: Child,
    pub address: String,
}

impl Broker {
    /// `None`, with a message, if there is no dbus-daemon.
    pub fn start(folder: &Path) -> Option<Self> {
        let address = format!("unix:path={}", folder.join("bus").display());
        let config = format!(
            "<busconfig><type>session</type><listen>{address}</listen><auth>EXTERNAL</auth>\
             <policy context=\"default\"><allow user=\"*\"/><allow send_destination=\"*\"/><allow receive_sender=\"*\"/>\
             <allow own=\"*\"/></policy></busconfig>"
        );
        let file = folder.join("bus.conf");
        std::fs::write(&file, config).unwrap();
        let started = Command::new("dbus-daemon")
            .arg(format!("--config-file={}", file.display()))
            .args(["--nofork", "--nopidfile", "--print-address=1"])
            .stdout(Stdio::piped())
            .spawn();
        let Ok(mut child) = started else {
            needs::lacking("DBUS", "there is no dbus-daemon here");
            return None;
        };
        // the broker prints its address when it listens
        let mut line = String::new();
        let stdout = child.stdout.take().unwrap();
        std::io::BufRead::read_line(&mut std::io::BufReader::new(stdout), &mut line).unwrap();
        assert!(line.contains("unix:path="), "{line}");
        Some(Self { child, address })
    }

    pub async fn connect(&self) -> zbus::Connection {
        zbus::connection::Builder::address(self.address.as_str())
            .build()
            .await
            .unwrap()
    }
}

impl Drop for Broker {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
