//! A temporary rig: configuration, state directory, peer socket, and the processes that use them.

use std::ffi::OsString;
use std::io;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

/// The timeout of every wait in the system tests.
pub const DEADLINE: Duration = Duration::from_secs(120);

/// A simulated rig in instant time with 2 uV of voltmeter noise, pair wiring, one-step reconstruction, peer bus only.
pub const SIMULATED: &str = include_str!("../rigs/simulated.toml");

/// The instruments of that rig.
const INSTANT: &str = include_str!("../rigs/instant.toml");

/// Errors of the temporary rig and its programs.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// The operating system returned an error.
    #[error("{what}")]
    System {
        /// What was attempted.
        what: String,
        /// The error.
        #[source]
        cause: io::Error,
    },
    /// The daemon exited, or did not report within the timeout that it is ready.
    #[error("tactusd was not ready within {deadline:?}; its standard error:\n{stderr}")]
    NotReady {
        /// The timeout.
        deadline: Duration,
        /// Its standard error.
        stderr: String,
    },
    /// A program exceeded the timeout.
    #[error("`{command}` did not end within {deadline:?}")]
    Slow {
        /// The command line.
        command: String,
        /// The timeout.
        deadline: Duration,
    },
    /// A program failed where success was expected.
    #[error("`{command}` ended with {code:?}:\n{stdout}{stderr}")]
    Failed {
        /// The command line.
        command: String,
        /// Its exit code; `None` if a signal ended it.
        code: Option<i32>,
        /// Its standard output.
        stdout: String,
        /// Its standard error.
        stderr: String,
    },
}

/// A folder for one system test.
#[derive(Debug)]
pub struct Stage {
    folder: tempfile::TempDir,
    program: PathBuf,
    launcher: Vec<OsString>,
}

/// Output and exit code of a program.
#[derive(Debug)]
pub struct Spoken {
    /// The command line, for messages.
    pub command: String,
    /// Exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
}

impl Stage {
    /// Writes `config` into a new folder; `STAGE` in it becomes the folder's path. The programs are this process's own
    /// binary; in a test harness use [`Stage::with_program`].
    ///
    /// # Errors
    /// The temporary folder cannot be made.
    pub fn new(config: &str) -> Result<Self, StageError> {
        let program = std::env::current_exe()
            .map_err(|cause| system("cannot tell which binary this is", cause))?;
        Self::with_program(config, program)
    }

    /// Like [`Stage::new`], with the given binary.
    ///
    /// # Errors
    /// The temporary folder cannot be made.
    pub fn with_program(config: &str, program: impl Into<PathBuf>) -> Result<Self, StageError> {
        let folder = tempfile::Builder::new()
            .prefix("tactus-")
            .tempdir()
            .map_err(|cause| system("cannot make a temporary folder", cause))?;
        let stage = Self {
            folder,
            program: program.into(),
            launcher: Vec::new(),
        };
        stage.configure(config)?;
        std::fs::write(stage.path().join("profile.toml"), INSTANT)
            .map_err(|cause| system("cannot write profile.toml", cause))?;
        Ok(stage)
    }

    /// Replaces the configuration.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn configure(&self, config: &str) -> Result<(), StageError> {
        let text = config.replace("STAGE", &self.folder.path().display().to_string());
        std::fs::write(self.config_path(), text)
            .map_err(|cause| system("cannot write config.toml", cause))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Path of the configuration.
    pub fn config_path(&self) -> PathBuf {
        self.folder.path().join("config.toml")
    }

    /// Directory of sessions.
    pub fn state_path(&self) -> PathBuf {
        self.folder.path().join("state")
    }

    /// Path of the daemon's socket.
    pub fn peer_path(&self) -> PathBuf {
        self.folder.path().join("peer")
    }

    /// Starts all later programs through this command line, as its arguments (`nsenter`, `prlimit`).
    pub fn launch_by(&mut self, launcher: impl IntoIterator<Item = impl Into<OsString>>) {
        self.launcher = launcher.into_iter().map(Into::into).collect();
    }

    /// The command that runs one of the programs.
    pub fn command(&self, program: &str) -> Command {
        let mut words = self.launcher.iter().map(OsString::as_os_str);
        let mut command = match words.next() {
            Some(launcher) => {
                let mut command = Command::new(launcher);
                command.args(words).arg(&self.program);
                command
            }
            None => Command::new(&self.program),
        };
        command.arg(program).stdin(Stdio::null());
        for variable in [
            "TACTUS_BUS",
            "TACTUS_STATE",
            "NOTIFY_SOCKET",
            "DBUS_SESSION_BUS_ADDRESS",
        ] {
            command.env_remove(variable);
        }
        command
            .env("XDG_RUNTIME_DIR", self.folder.path())
            .env("XDG_STATE_HOME", self.folder.path());
        command
    }

    /// Starts `tactusd` with this configuration and waits until it reports that it is ready.
    ///
    /// # Errors
    /// It exits or does not report before the timeout; its standard error is in the message.
    pub fn start_daemon(&self) -> Result<DaemonProcess, StageError> {
        self.start_daemon_with(|_| {})
    }

    /// Like [`Stage::start_daemon`], with changes to the command (environment, more arguments).
    ///
    /// # Errors
    /// As [`Stage::start_daemon`].
    pub fn start_daemon_with(
        &self,
        adjust: impl FnOnce(&mut Command),
    ) -> Result<DaemonProcess, StageError> {
        let notify_path = self.folder.path().join("notify");
        let _ = std::fs::remove_file(&notify_path);
        let notify = UnixDatagram::bind(&notify_path)
            .map_err(|cause| system("cannot bind the notify socket", cause))?;
        let log_path = self.folder.path().join("tactusd.log");
        let log = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&log_path)
            .map_err(|cause| system("cannot write tactusd.log", cause))?;
        let mut command = self.command("tactusd");
        command
            .arg("--config")
            .arg(self.config_path())
            .env("NOTIFY_SOCKET", &notify_path)
            .stdout(Stdio::null())
            .stderr(log);
        adjust(&mut command);
        let child = command
            .spawn()
            .map_err(|cause| system("cannot start tactusd", cause))?;
        let mut daemon = DaemonProcess { child, log_path };
        notify
            .set_read_timeout(Some(Duration::from_millis(50)))
            .map_err(|cause| system("cannot set up the notify socket", cause))?;
        let begun = Instant::now();
        let mut buffer = [0; 4096];
        loop {
            match notify.recv(&mut buffer) {
                Ok(length) => {
                    let mut lines = buffer[..length].split(|byte| *byte == b'\n');
                    if lines.any(|line| line == b"READY=1") {
                        return Ok(daemon);
                    }
                }
                Err(_) => {
                    let ended = daemon.child.try_wait().ok().flatten().is_some();
                    if ended || begun.elapsed() > DEADLINE {
                        return Err(StageError::NotReady {
                            deadline: DEADLINE,
                            stderr: daemon.log(),
                        });
                    }
                }
            }
        }
    }

    /// Runs `tactus` with this daemon and waits for its exit.
    ///
    /// # Errors
    /// It cannot be started, or does not exit before the timeout. A failing exit code is not an error here: see
    /// [`Spoken::succeeded`].
    pub fn tactus(&self, args: &[&str]) -> Result<Spoken, StageError> {
        self.tactus_with(args, |_| {})
    }

    /// Like [`Stage::tactus`], with changes to the command (environment, more arguments).
    ///
    /// # Errors
    /// As [`Stage::tactus`].
    pub fn tactus_with(
        &self,
        args: &[&str],
        adjust: impl FnOnce(&mut Command),
    ) -> Result<Spoken, StageError> {
        let mut command = self.command("tactus");
        command.env("TACTUS_BUS", format!("unix:{}", self.peer_path().display()));
        command.env("TACTUS_STATE", self.state_path());
        command.args(args);
        adjust(&mut command);
        listen(command)
    }

    /// Runs a command made by [`Stage::command`] and waits for its exit.
    ///
    /// # Errors
    /// As [`Stage::tactus`].
    pub fn run_command(&self, command: Command) -> Result<Spoken, StageError> {
        listen(command)
    }

    /// Runs any of the programs and waits for its exit.
    ///
    /// # Errors
    /// As [`Stage::tactus`].
    pub fn run(&self, program: &str, args: &[&str]) -> Result<Spoken, StageError> {
        let mut command = self.command(program);
        command.args(args);
        listen(command)
    }
}

/// Runs a command with the timeout and collects its output.
fn listen(mut command: Command) -> Result<Spoken, StageError> {
    let line = std::iter::once(command.get_program())
        .chain(command.get_args())
        .skip(1)
        .map(|word| word.to_string_lossy().into_owned())
        .collect::<Vec<_>>()
        .join(" ");
    let child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|cause| system(&format!("cannot start `{line}`"), cause))?;
    let process = Pid::from_child(&child);
    let (tell, reported) = mpsc::channel();
    // within the timeout, too: a process that the program left behind may keep the pipes open
    std::thread::spawn(move || tell.send(child.wait_with_output()));
    let Ok(output) = reported.recv_timeout(DEADLINE) else {
        let _ = kill_process(process, Signal::KILL);
        return Err(StageError::Slow {
            command: line,
            deadline: DEADLINE,
        });
    };
    let output = output.map_err(|cause| system(&format!("cannot await `{line}`"), cause))?;
    Ok(Spoken {
        command: line,
        code: output.status.code(),
        stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
        stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
    })
}

impl Spoken {
    /// Itself if the exit code is 0.
    ///
    /// # Errors
    /// A different exit code.
    pub fn succeeded(self) -> Result<Self, StageError> {
        if self.code == Some(0) {
            return Ok(self);
        }
        Err(StageError::Failed {
            command: self.command,
            code: self.code,
            stdout: self.stdout,
            stderr: self.stderr,
        })
    }

    /// Each line of standard output as JSON.
    ///
    /// # Panics
    /// If a line is not JSON: a test with `--json` has found a bug.
    pub fn json(&self) -> Vec<serde_json::Value> {
        self.stdout
            .lines()
            .map(|line| {
                serde_json::from_str(line).unwrap_or_else(|fault| {
                    panic!(
                        "`{}` printed a line that is not JSON ({fault}): {line}",
                        self.command
                    )
                })
            })
            .collect()
    }
}

/// A running daemon; killed when dropped, unless it was stopped.
#[derive(Debug)]
pub struct DaemonProcess {
    child: Child,
    log_path: PathBuf,
}

impl DaemonProcess {
    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether it is still running.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Its standard error so far.
    pub fn log(&self) -> String {
        std::fs::read_to_string(&self.log_path).unwrap_or_default()
    }

    /// Sends SIGTERM and waits for its exit.
    ///
    /// # Errors
    /// It does not exit before the timeout, or not with exit code 0.
    pub fn stop(mut self) -> Result<(), StageError> {
        let _ = kill_process(Pid::from_child(&self.child), Signal::TERM);
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = self
                .child
                .try_wait()
                .map_err(|cause| system("cannot await tactusd", cause))?
            {
                break status;
            }
            if begun.elapsed() > DEADLINE {
                return Err(StageError::Slow {
                    command: "tactusd after SIGTERM".into(),
                    deadline: DEADLINE,
                });
            }
            std::thread::yield_now();
            std::thread::park_timeout(Duration::from_millis(10));
        };
        if status.code() == Some(0) {
            return Ok(());
        }
        Err(StageError::Failed {
            command: "tactusd".into(),
            code: status.code(),
            stdout: String::new(),
            stderr: self.log(),
        })
    }

    /// Kills it (SIGKILL).
    pub fn kill(self) {
        drop(self);
    }
}

impl Drop for DaemonProcess {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn system(what: &str, cause: io::Error) -> StageError {
    StageError::System {
        what: what.to_owned(),
        cause,
    }
}
