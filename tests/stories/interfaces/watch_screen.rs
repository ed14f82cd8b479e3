//! `tactus watch` on a terminal of 80 columns and 24 rows.

use std::fs::File;
use std::io::Read;
use std::os::fd::OwnedFd;
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, channel};

use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};
use tactus_tests::{DEADLINE, Stage};

use crate::test_rig::{self, Needs, ask, baseline};

const ROWS: usize = 24;
const ENTER: &str = "\x1b[?1049h";
const LEAVE: &str = "\x1b[?1049l";

/// A program on a pseudo-terminal, and its output.
struct Terminal {
    child: Child,
    output: Receiver<Vec<u8>>,
    text: String,
    // closed only at the end of the test
    _master: OwnedFd,
}

impl Terminal {
    fn watch(stage: &Stage) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
        grantpt(&master).expect("it is ours");
        unlockpt(&master).expect("it is ours");
        let name = ptsname(&master, Vec::new()).expect("it has a name");
        let size = Winsize {
            ws_row: ROWS as u16,
            ws_col: 80,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        tcsetwinsize(&master, size).expect("it has a size");
        let terminal = File::options()
            .read(true)
            .write(true)
            .open(name.to_str().expect("ASCII"))
            .expect("it can be opened");
        let mut command = stage.command("tactus");
        let copy = || Stdio::from(terminal.try_clone().expect("a descriptor"));
        command
            .env(
                "TACTUS_BUS",
                format!("unix:{}", stage.peer_path().display()),
            )
            .args(["watch", "--colour", "never"])
            .stdout(copy())
            .stderr(copy());
        let child = command.spawn().expect("tactus starts");
        let mut reader = File::from(master.try_clone().expect("a descriptor"));
        let (sender, output) = channel();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            // an error means that the terminal is closed
            while let Ok(count @ 1..) = reader.read(&mut bytes) {
                if sender.send(bytes[..count].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self {
            child,
            output,
            text: String::new(),
            _master: master,
        }
    }

    /// Reads until the output contains a text.
    fn until(&mut self, wanted: &str) {
        while !self.text.contains(wanted) {
            let bytes = self.output.recv_timeout(DEADLINE);
            let bytes = bytes.unwrap_or_else(|_| panic!("no {wanted:?} in {:?}", self.text));
            self.text += &String::from_utf8_lossy(&bytes);
        }
    }

    /// The rows of the last complete picture.
    fn rows(&self) -> Vec<&str> {
        let picture = self.text.rsplit("\x1b[H").next().unwrap_or_default();
        let (picture, _) = picture.split_once("\x1b[J").expect("a complete picture");
        picture.lines().collect()
    }

    /// Sends a signal and returns the exit code.
    fn end(mut self, signal: Signal) -> (Option<i32>, String) {
        let id = Pid::from_child(&self.child);
        kill_process(id, signal).expect("it runs");
        self.until(LEAVE);
        let status = self.child.wait().expect("it ends");
        (status.code(), self.text)
    }
}

#[test]
fn watch_shows_the_last_map_on_80_by_24_and_leaves_it() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 4);
    ask(&stage, &["start", "--step"]);
    let mut empty = Terminal::watch(&stage);
    empty.until("waiting for the first frame");
    empty.until("tactus step");
    let (code, text) = empty.end(Signal::INT);
    assert_eq!(code, Some(130), "{text:?}");
    ask(&stage, &["step", "1"]);
    // no further frame follows: the last one is displayed
    let mut terminal = Terminal::watch(&stage);
    terminal.until("frame 1");
    terminal.until("\x1b[J");
    let rows = terminal.rows();
    assert!(rows.len() <= ROWS - 2, "{} rows: {rows:#?}", rows.len());
    assert!(
        rows.iter().any(|row| row.contains("frame 1  [SIMULATED]")),
        "{rows:#?}"
    );
    assert!(rows.iter().any(|row| row.contains("%")), "{rows:#?}");
    let (code, text) = terminal.end(Signal::TERM);
    assert_eq!(code, Some(143), "{text:?}");
    assert!(text.starts_with(ENTER), "{text:?}");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}
