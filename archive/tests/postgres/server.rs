//! A private PostgreSQL server for a test: on a socket in a temporary folder, run by a user other than root.

use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, getuid, kill_process};
use tempfile::TempDir;

/// Timeout of all waits: a busy machine may need minutes for what an idle one does in a second.
const PATIENCE: Duration = Duration::from_secs(300);

/// Waits until `done` returns true; on timeout panics with `missing`.
pub fn wait_until(mut done: impl FnMut() -> bool, missing: impl Fn() -> String) {
    let limit = Instant::now() + PATIENCE;
    while !done() {
        assert!(Instant::now() < limit, "{}", missing());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Role that owns the catalogue.
pub const OWNER: &str = "owner";
/// Database of the catalogue.
pub const DATABASE: &str = "tactus";
/// Password of every other role.
pub const PASSWORD: &str = "a word";

pub struct Server {
    folder: TempDir,
    programs: PathBuf,
    /// User and group of the server, if the test runs as root.
    user: Option<(u32, u32)>,
    port: u16,
    running: Option<Child>,
}

/// The folder of Debian's newest `initdb`, otherwise that of the one in the search path.
fn programs() -> Option<PathBuf> {
    let mut found: Vec<PathBuf> = std::fs::read_dir("/usr/lib/postgresql")
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path().join("bin"))
        .collect();
    found.sort();
    let path = std::env::var_os("PATH").unwrap_or_default();
    let all = std::env::split_paths(&path).chain(found);
    all.filter(|folder| folder.join("initdb").is_file()).last()
}

/// User and group `postgres`.
fn postgres_user() -> Option<(u32, u32)> {
    let users = std::fs::read_to_string("/etc/passwd").ok()?;
    let line = users.lines().find(|line| line.starts_with("postgres:"))?;
    let mut fields = line.split(':').skip(2);
    Some((fields.next()?.parse().ok()?, fields.next()?.parse().ok()?))
}

impl Server {
    /// A running server with an empty database; `None` (reported, kind `POSTGRES`) if there is no server program.
    pub fn start() -> Option<Self> {
        let Some(programs) = programs() else {
            needs::lacking(
                "POSTGRES",
                "PostgreSQL is not installed (Debian package postgresql)",
            );
            return None;
        };
        let user = match getuid().is_root() {
            false => None,
            true => match postgres_user() {
                Some(user) => Some(user),
                None => {
                    needs::lacking(
                        "POSTGRES",
                        "PostgreSQL does not run as root, and there is no user postgres",
                    );
                    return None;
                }
            },
        };
        let folder = tempfile::Builder::new()
            .prefix("pg")
            .tempdir()
            .expect("a folder");
        std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o755)).unwrap();
        if let Some((uid, gid)) = user {
            chown(folder.path(), Some(uid), Some(gid)).unwrap();
        }
        let port = std::net::TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr());
        let mut server = Self {
            folder,
            programs,
            user,
            port: port.expect("a port").port(),
            running: None,
        };
        let made = server
            .command("initdb")
            .args([
                "--no-sync",
                "--auth=trust",
                "--encoding=UTF8",
                "--locale=C",
                "-U",
                OWNER,
                "-D",
            ])
            .arg(server.data())
            .output()
            .expect("initdb runs");
        assert!(
            made.status.success(),
            "{}",
            String::from_utf8_lossy(&made.stderr)
        );
        // the owner logs in by socket without a password, all others with one
        let access = format!(
            "local all {OWNER} trust\nlocal all all scram-sha-256\nhostssl all all 127.0.0.1/32 scram-sha-256\n"
        );
        server.write("data/pg_hba.conf", &access);
        server.resume();
        server.sql_in("postgres", &format!("CREATE DATABASE {DATABASE}"));
        Some(server)
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// Folder of the socket.
    pub fn socket(&self) -> &Path {
        self.folder.path()
    }

    pub fn port(&self) -> u16 {
        self.port
    }

    /// Writes a file that the server's user owns.
    pub fn write(&self, name: &str, text: &str) {
        let path = self.folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o600)).unwrap();
        if let Some((uid, gid)) = self.user {
            chown(&path, Some(uid), Some(gid)).unwrap();
        }
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(self.programs.join(program));
        command.current_dir(self.folder.path()).env("LC_ALL", "C");
        if let Some((uid, gid)) = self.user {
            command.uid(uid).gid(gid);
        }
        command
    }

    /// Starts the server and waits until it accepts connections.
    pub fn resume(&mut self) {
        let limit = Instant::now() + PATIENCE;
        loop {
            let mut command = self.command("postgres");
            command.arg("-D").arg(self.data());
            command.arg("-k").arg(self.folder.path());
            command.args([
                "-p",
                &self.port.to_string(),
                "-c",
                "listen_addresses=127.0.0.1",
            ]);
            command.args(["-c", "shared_buffers=16MB", "-c", "max_connections=20"]);
            let tls = self.folder.path().join("server.crt").exists();
            if tls {
                command.args([
                    "-c",
                    "ssl=on",
                    "-c",
                    "ssl_cert_file=../server.crt",
                    "-c",
                    "ssl_key_file=../server.key",
                ]);
            }
            let log = std::fs::File::options()
                .append(true)
                .create(true)
                .open(self.folder.path().join("log"))
                .unwrap();
            command.stdout(Stdio::null()).stderr(log);
            let mut child = command.spawn().expect("postgres starts");
            loop {
                if let Some(port) = self.answers() {
                    assert_eq!(port, self.port);
                    self.running = Some(child);
                    return;
                }
                assert!(Instant::now() < limit, "{}", self.log());
                std::thread::sleep(Duration::from_millis(20));
                // after a kill the processes of the previous server may need a moment to exit
                if child.try_wait().expect("a child").is_some() {
                    break;
                }
            }
        }
    }

    fn answers(&self) -> Option<u16> {
        let asked = self.psql("postgres", "SHOW port").output().ok()?;
        asked.status.success().then(|| {
            String::from_utf8_lossy(&asked.stdout)
                .trim()
                .parse()
                .unwrap()
        })
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap_or_default()
    }

    /// Sends a signal to the main process and waits for its end.
    pub fn kill(&mut self, signal: Signal) {
        let mut child = self.running.take().expect("it runs");
        let pid = Pid::from_raw(child.id().try_into().unwrap()).unwrap();
        kill_process(pid, signal).unwrap();
        child.wait().unwrap();
    }

    fn psql(&self, database: &str, statements: &str) -> Command {
        let mut command = self.command("psql");
        command.args([
            "-X",
            "-q",
            "-A",
            "-t",
            "-v",
            "ON_ERROR_STOP=1",
            "-U",
            OWNER,
            "-d",
            database,
            "-h",
        ]);
        command.arg(self.folder.path());
        command.args(["-p", &self.port.to_string(), "-c", statements]);
        command
    }

    fn sql_in(&self, database: &str, statements: &str) -> String {
        let done = self.psql(database, statements).output().expect("psql runs");
        let error = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{statements}: {error}");
        String::from_utf8_lossy(&done.stdout).trim().to_owned()
    }

    /// Runs statements as the owner, and returns what they print.
    pub fn sql(&self, statements: &str) -> String {
        self.sql_in(DATABASE, statements)
    }

    /// Starts statements as the owner and leaves them running.
    pub fn session(&self, statements: &str) -> Child {
        let mut command = self.psql(DATABASE, statements);
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().expect("psql runs")
    }

    /// Waits until a query returns this.
    pub fn wait_for(&self, query: &str, expected: &str) {
        wait_until(
            || self.sql(query) == expected,
            || format!("{query}: {}, not {expected}", self.sql(query)),
        );
    }

    /// Runs statements as a role, which must fail, and returns the error.
    pub fn refusal(&self, role: &str, statements: &str) -> String {
        let mut command = self.psql(DATABASE, statements);
        command.args(["-U", role]).env("PGPASSWORD", PASSWORD);
        let done = command.output().expect("psql runs");
        assert!(!done.status.success(), "{role}: {statements}");
        String::from_utf8_lossy(&done.stderr).into_owned()
    }

    /// Runs statements as a role, and returns what they print.
    pub fn sql_as(&self, role: &str, statements: &str) -> String {
        let mut command = self.psql(DATABASE, statements);
        command.args(["-U", role]).env("PGPASSWORD", PASSWORD);
        let done = command.output().expect("psql runs");
        let error = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{role}: {statements}: {error}");
        String::from_utf8_lossy(&done.stdout).trim().to_owned()
    }

    /// A role that may log in with [`PASSWORD`].
    pub fn add_role(&self, role: &str) {
        self.sql(&format!("CREATE ROLE {role} LOGIN PASSWORD '{PASSWORD}'"));
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if self.running.is_some() {
            self.kill(Signal::QUIT);
        }
    }
}
