//! A program on a pseudo-terminal, and the content of its screen.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, channel};

use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};
use tactus_tests::{DEADLINE, Stage};

const LEAVE: &str = "\x1b[?1049l";

/// A program on a pseudo-terminal, and its output.
pub(super) struct Terminal {
    child: Child,
    output: Receiver<Vec<u8>>,
    bytes: Vec<u8>,
    size: [u16; 2],
    master: OwnedFd,
}

impl Terminal {
    /// Runs `tactus` with these arguments on a terminal of this size.
    pub(super) fn run(stage: &Stage, arguments: &[&str], [columns, rows]: [u16; 2]) -> Self {
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
        grantpt(&master).expect("it is ours");
        unlockpt(&master).expect("it is ours");
        let name = ptsname(&master, Vec::new()).expect("it has a name");
        let size = Winsize {
            ws_row: rows,
            ws_col: columns,
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
            .args(arguments)
            .stdin(copy())
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
            bytes: Vec::new(),
            size: [columns, rows],
            master,
        }
    }

    /// Reads the next output; `wanted` is named if there is none in time.
    pub(super) fn receive(&mut self, wanted: &str) {
        let bytes = self.output.recv_timeout(DEADLINE);
        let bytes = bytes.unwrap_or_else(|_| panic!("no {wanted:?} in {:?}", self.text()));
        self.bytes.extend(bytes);
    }

    /// All output.
    pub(super) fn text(&self) -> String {
        String::from_utf8_lossy(&self.bytes).into_owned()
    }

    /// Reads until the output contains a text.
    pub(super) fn until(&mut self, wanted: &str) {
        while !self.text().contains(wanted) {
            self.receive(wanted);
        }
    }

    /// Reads until a row of the screen contains a text.
    pub(super) fn until_shown(&mut self, wanted: &str) {
        while !self.screen().iter().any(|row| row.contains(wanted)) {
            self.receive(wanted);
        }
    }

    /// Types keys.
    pub(super) fn keys(&self, keys: &str) {
        let mut writer = File::from(self.master.try_clone().expect("a descriptor"));
        writer.write_all(keys.as_bytes()).expect("it is open");
    }

    /// The rows of the screen, computed from the program's output: text, positions and clearing; colours are ignored.
    pub(super) fn screen(&self) -> Vec<String> {
        let [columns, rows] = self.size.map(usize::from);
        let mut cells = vec![vec![' '; columns]; rows];
        let (mut row, mut column) = (0, 0);
        let text = self.text();
        let mut letters = text.chars();
        while let Some(letter) = letters.next() {
            if letter != '\x1b' {
                if !letter.is_control() && row < rows && column < columns {
                    cells[row][column] = letter;
                    column += 1;
                }
                continue;
            }
            // a sequence `ESC [ parameters letter`
            if letters.next() != Some('[') {
                continue;
            }
            let mut parameters = String::new();
            let end = loop {
                match letters.next() {
                    Some(part) if part.is_ascii_digit() || ";?".contains(part) => {
                        parameters.push(part);
                    }
                    Some(end) => break end,
                    // the rest has not arrived yet
                    None => break ' ',
                }
            };
            if end == 'H' {
                let mut at = parameters
                    .split(';')
                    .map(|number| number.parse().unwrap_or(1));
                let mut next = || at.next().unwrap_or(1_usize).saturating_sub(1);
                (row, column) = (next(), next());
            } else if end == 'J' {
                cells = vec![vec![' '; columns]; rows];
            }
        }
        cells.iter().map(|row| row.iter().collect()).collect()
    }

    /// Sends a signal and returns the exit code with all output.
    pub(super) fn end(self, signal: Signal) -> (Option<i32>, String) {
        let id = Pid::from_child(&self.child);
        kill_process(id, signal).expect("it runs");
        self.ended()
    }

    /// Waits until the program has left the screen, and returns its exit code with all output.
    pub(super) fn ended(mut self) -> (Option<i32>, String) {
        self.until(LEAVE);
        let status = self.child.wait().expect("it ends");
        (status.code(), self.text())
    }
}
