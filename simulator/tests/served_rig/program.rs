//! The running program.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;

/// A server on free ports; killed if a test leaves it running.
pub struct Served {
    child: Child,
    pub ready: Value,
}

impl Served {
    /// Starts it in instant time.
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_in_time(&[&["--instant"], arguments].concat())
    }

    /// Starts it with the profile's speed.
    pub fn start_in_time(arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
            .arg("serve")
            .args(["--port-6221", "0", "--port-34980a", "0"])
            .args(arguments)
            .env("TACTUS_LOG", "error")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let ready: Value = serde_json::from_str(&line).unwrap();
        assert_eq!(ready["ready"], true);
        Self { child, ready }
    }

    pub fn address(&self, key: &str) -> &str {
        self.ready[key].as_str().unwrap()
    }

    /// Terminates it like systemd, and returns its exit code.
    pub fn terminate(self) -> Option<i32> {
        self.end("-TERM")
    }

    /// Ends it by a signal, and returns its exit code.
    pub fn end(mut self, signal: &str) -> Option<i32> {
        let killed = Command::new("kill")
            .args([signal, &self.child.id().to_string()])
            .status();
        assert!(killed.unwrap().success());
        self.child.wait().unwrap().code()
    }

    /// Runs `tactus-sim` with its control socket.
    pub fn command(&self, command: &str, words: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
            .args([command, "--control", self.address("control")])
            .args(words.split_whitespace())
            .output()
            .unwrap()
    }

    /// Applies a fault.
    pub fn fault(&self, words: &str) {
        let done = self.command("fault", words);
        let reported = String::from_utf8_lossy(&done.stderr).into_owned();
        assert!(done.status.success(), "{words}: {reported}");
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
