//! A running `tactus-archive run` with live topics.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use tempfile::TempDir;

use crate::live::mosquitto::Mosquitto;

/// A catalogue that cannot be reached: live topics do not need it.
pub const NO_CATALOGUE: &str = "host=127.0.0.1 port=1 dbname=tactus user=berlin";

pub struct Publisher {
    pub child: Child,
    folder: PathBuf,
}

impl Publisher {
    /// `folder` is the machine's; `mqtt` are the lines of `[mqtt]`.
    pub fn start(folder: &Path, mqtt: &str) -> Self {
        let text = format!(
            "[record]\ndirectory = \"record\"\n[bus]\npeer_path = \"peer\"\n[archive]\nsite = \"berlin\"\ndaq = \"bed3\"\n\
             store = \"store\"\ndsn = \"{NO_CATALOGUE}\"\n[mqtt]\n{mqtt}"
        );
        std::fs::write(folder.join("config.toml"), text).unwrap();
        Self::with_config(folder)
    }

    /// Starts with the existing configuration.
    pub fn with_config(folder: &Path) -> Self {
        let log = std::fs::File::create(folder.join("log")).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_tactus-archive"))
            .args(["run", "--config"])
            .arg(folder.join("config.toml"))
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .expect("the program runs");
        Self {
            child,
            folder: folder.to_owned(),
        }
    }

    /// Waits until the log has these words.
    pub fn wait_for(&self, words: &str) {
        let log = || std::fs::read_to_string(self.folder.join("log")).unwrap();
        crate::server::wait_until(
            || log().contains(words),
            || format!("never so: {words}: {}", log()),
        );
    }

    pub fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The lines of `[mqtt]` for a broker.
pub fn mqtt(broker: &Mosquitto, every_s: f64) -> String {
    let port = broker.port();
    format!("host = \"127.0.0.1\"\nport = {port}\nevery_s = {every_s:.1}\n")
}

/// A machine's folder.
pub fn machine() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["record", "store"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
    }
    folder
}
