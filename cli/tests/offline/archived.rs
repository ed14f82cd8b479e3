//! Sessions in an archive with a real PostgreSQL: listed, fetched, read like local ones, played on the page.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

use crate::scene::{lines, session_of};
use crate::server::{DATABASE, OWNER, PASSWORD, Server};

/// A machine of a site with a record and a store, and in addition a reader without a record.
struct Archive {
    server: Server,
    folder: TempDir,
}

impl Archive {
    /// `None` without PostgreSQL.
    fn start() -> Option<Self> {
        let server = Server::start()?;
        let archive = Self {
            server,
            folder: tempfile::tempdir().unwrap(),
        };
        for name in ["record", "store", "nothing", "cache"] {
            std::fs::create_dir(archive.path(name)).unwrap();
        }
        let password = archive.path("password");
        std::fs::write(&password, PASSWORD).unwrap();
        std::fs::set_permissions(password, PermissionsExt::from_mode(0o600)).unwrap();
        archive.server.add_role("berlin");
        archive.server.add_role("ward");
        archive.configure("owner", OWNER, "site = \"owner\"");
        archive.configure(
            "berlin",
            "berlin",
            "site = \"berlin\"\ndaq = \"bed3\"\npassword_file = \"password\"",
        );
        archive.configure("ward", "ward", "password_file = \"password\"");
        let owner = archive.path("owner.toml");
        for words in [
            &["migrate"][..],
            &["add-site", "berlin", "--role", "berlin"],
        ] {
            let words = ["tactus-archive"].iter().chain(words).chain(&["--config"]);
            let words = words
                .map(|word| (*word).into())
                .chain([owner.clone().into()]);
            let done = archive::run(words);
            assert_eq!(
                format!("{done:?}"),
                format!("{:?}", std::process::ExitCode::SUCCESS)
            );
        }
        archive.server.sql("GRANT tactus_reader TO ward");
        Some(archive)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn configure(&self, name: &str, user: &str, more: &str) {
        let (socket, port) = (self.server.socket().display(), self.server.port());
        let text = format!(
            "[record]\ndirectory = \"record\"\n[archive]\nstore = \"store\"\ndsn = \"host={socket} port={port} dbname={DATABASE} user={user}\"\n{more}\n"
        );
        std::fs::write(self.path(&format!("{name}.toml")), text).unwrap();
    }

    /// The command `tactus` with a folder of sessions and the configuration of an archive.
    fn command(&self, state: &str, config: &str, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tactus"));
        command
            .args(words)
            .current_dir(self.folder.path())
            .env_remove("TACTUS_BUS")
            .env_remove("CACHE_DIRECTORY")
            .env("TACTUS_STATE", self.path(state))
            .env("TACTUS_ARCHIVE", self.path(config))
            .env("XDG_CACHE_HOME", self.path("cache"));
        command
    }

    fn run(&self, state: &str, config: &str, words: &[&str]) -> Output {
        self.command(state, config, words)
            .output()
            .expect("the program was built")
    }

    /// Runs `tactus` as the reader, expects success, and returns its output.
    fn reads(&self, words: &[&str]) -> String {
        done(self.run("nothing", "ward.toml", words), words)
    }

    fn refuses(&self, config: &str, words: &[&str], code: i32) -> String {
        let output = self.run("nothing", config, words);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{words:?}: {message}");
        assert!(output.stdout.is_empty(), "{words:?}");
        message
    }

    /// Records a session with maps and archives it.
    fn archived_session(&self) {
        session_of(
            &self.path("record"),
            "m20270115_1",
            "[model]\nnoise_uv = 3.0\n",
        );
        let words = ["archive", "push", "--json"];
        let steps = lines(&done(self.run("record", "berlin.toml", &words), &words));
        assert_eq!(
            (&steps[0]["what"], &steps[0]["part"]),
            (&"archived".into(), &"m20270115_1".into())
        );
    }

    /// All files below a folder.
    fn files(&self, name: &str) -> Vec<PathBuf> {
        let (mut files, mut open) = (Vec::new(), vec![self.path(name)]);
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    open.push(path)
                } else {
                    files.push(path)
                }
            }
        }
        files
    }
}

fn done(output: Output, words: &[&str]) -> String {
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{words:?}: {message}");
    String::from_utf8(output.stdout).expect("text")
}

#[test]
fn sessions_of_the_archive_are_listed_and_filtered() {
    let Some(archive) = Archive::start() else {
        return;
    };
    let empty = archive.reads(&["sessions", "--archive"]);
    assert!(empty.contains("no session of the archive"), "{empty}");
    archive.archived_session();
    let listed = lines(&archive.reads(&["sessions", "--archive", "--json"]));
    assert_eq!(listed.len(), 1);
    let wanted = serde_json::json!({
        "site": "berlin", "daq": "bed3", "id": "m20270115_1", "kind": "measurement", "started": "2027-01-15T08:00:00Z",
        "last_frame": "2027-01-15T08:00:03Z", "frames": 3, "parts": 1, "bytes": listed[0]["bytes"], "simulated": true,
        "closed_at": "2027-01-15T08:00:04Z", "reason": "count reached", "complete": true, "electrodes": 16, "readings": 208,
        "note": "three frames",
    });
    assert_eq!(listed[0], wanted);
    let text = archive.reads(&["sessions", "--archive", "--site", "berlin", "--daq", "bed3"]);
    assert!(
        text.contains("berlin/bed3/m20270115_1  measurement (SIMULATED)"),
        "{text}"
    );
    for (words, count) in [
        (&["--site", "paris"][..], 0),
        (&["--daq", "bed4"], 0),
        (&["--from", "2027-01-15T08:00:05Z"], 0),
        (&["--from", "2027-01-15T08:00:04Z"], 1),
        (&["--to", "2027-01-15T08:00:00Z"], 0),
        (&["--to", "2027-01-15T08:00:01Z"], 1),
    ] {
        let words = [&["sessions", "--archive", "--json"], words].concat();
        assert_eq!(archive.reads(&words).lines().count(), count, "{words:?}");
        if !words.contains(&"--site") && !words.contains(&"--daq") {
            let local: Vec<&str> = words
                .iter()
                .copied()
                .filter(|word| *word != "--archive")
                .collect();
            let output = archive.run("record", "ward.toml", &local);
            assert_eq!(done(output, &local).lines().count(), count, "{local:?}");
        }
    }
    let status = archive.run("record", "berlin.toml", &["archive", "status"]);
    assert!(done(status, &["status"]).contains("1 of 1 closed parts are archived"));
    assert!(archive.reads(&["archive", "verify"]).contains(": intact"));
    archive.refuses("ward.toml", &["sessions", "--site", "berlin"], 2);
    archive.refuses("ward.toml", &["sessions", "--from", "noon"], 2);
}

#[test]
fn archived_session_is_read_as_the_local_one() {
    let Some(archive) = Archive::start() else {
        return;
    };
    archive.archived_session();
    let name = "archive:berlin/bed3/m20270115_1";
    // the same command on the record and on the archive
    let both = |words: &[&str]| -> [String; 2] {
        let with = |session: &'static str| -> Vec<&str> {
            words
                .iter()
                .map(|word| if *word == "SESSION" { session } else { *word })
                .collect()
        };
        let local = with("m20270115_1");
        let local = done(archive.run("record", "ward.toml", &local), &local);
        [
            local,
            archive.reads(&with("archive:berlin/bed3/m20270115_1")),
        ]
    };
    for words in [
        &["replay", "SESSION", "--verify", "--json"][..],
        &["quantities", "SESSION", "--recompute", "--json"],
        &["events", "SESSION", "--json"],
        &[
            "export",
            "SESSION",
            "--format",
            "csv",
            "--out",
            "/dev/stdout",
        ],
    ] {
        let [local, archived] = both(words);
        assert!(!local.is_empty() || words[0] == "events", "{words:?}");
        assert_eq!(archived, local, "{words:?}");
    }
    archive.reads(&["report", name, "--out", "night"]);
    let page = std::fs::read_dir(archive.path("night")).unwrap().count();
    assert!(page > 0);
    // fetched once, complete, and readable by this user only
    let cached = archive.path("cache/tactus/archive/berlin/bed3/m20270115_1");
    let same = |path: &Path| std::fs::read(path).unwrap();
    let record = archive.path("record/m20270115_1.tactus");
    assert!(same(&cached.join("m20270115_1.tactus")) == same(&record));
    assert_eq!(
        std::fs::metadata(&cached).unwrap().permissions().mode() & 0o777,
        0o700
    );
    // by a prefix, and as the newest
    for name in ["archive:m2027", "archive:last", "archive:berlin/bed3/last"] {
        let shown = archive.reads(&["sessions", "show", name, "--json"]);
        assert!(shown.contains("m20270115_1"), "{name}: {shown}");
    }
}

#[test]
fn archive_that_cannot_be_read_is_named_and_nothing_is_kept() {
    let Some(mut archive) = Archive::start() else {
        return;
    };
    archive.archived_session();
    archive.server.add_role("stranger");
    archive.configure("stranger", "stranger", "password_file = \"password\"");
    let name = "archive:berlin/bed3/m20270115_1";
    for (config, session, code, words) in [
        (
            "ward.toml",
            "archive:m9",
            3,
            "the archive has no session 'm9'",
        ),
        ("ward.toml", "archive:a/b", 2, "SITE/DAQ/SESSION"),
        ("ward.toml", "archive:", 2, "SITE/DAQ/SESSION"),
        ("none.toml", name, 78, "none.toml"),
        ("stranger.toml", name, 1, "GRANT tactus_reader TO stranger"),
    ] {
        let error = archive.refuses(config, &["replay", session, "--json"], code);
        assert!(error.contains(words), "{session}: {error}");
    }
    let store = archive.path("store");
    let stored = archive.files("store").remove(0);
    let whole = std::fs::read(&stored).unwrap();
    let mut altered = whole.clone();
    *altered.last_mut().unwrap() ^= 1;
    std::fs::remove_file(&stored).unwrap();
    std::fs::write(&stored, altered).unwrap();
    let error = archive.refuses("ward.toml", &["replay", name], 1);
    assert!(
        error.contains("m20270115_1") && error.contains("SHA-256"),
        "{error}"
    );
    std::fs::rename(&store, archive.path("unmounted")).unwrap();
    let error = archive.refuses("ward.toml", &["replay", name], 75);
    assert!(error.contains("mount or create it"), "{error}");
    archive.server.kill(rustix::process::Signal::QUIT);
    for words in [
        &["replay", name][..],
        &["sessions", "--archive"],
        &["archive", "verify"],
    ] {
        let error = archive.refuses("ward.toml", words, 75);
        assert!(
            error.contains("cannot reach PostgreSQL at"),
            "{words:?}: {error}"
        );
    }
    assert_eq!(archive.files("cache"), Vec::<PathBuf>::new());
}

/// `tactus web`, killed when dropped.
struct Page {
    process: Child,
    port: u16,
    token: String,
}

impl Page {
    fn open(archive: &Archive, state: &str, words: &[&str]) -> Self {
        let words = [
            &["web", "--no-browser", "--json", "--listen", "127.0.0.1:0"],
            words,
        ]
        .concat();
        let mut command = archive.command(state, "ward.toml", &words);
        let mut process = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        let serving: Value = serde_json::from_str(&line).unwrap();
        let url = serving["url"].as_str().unwrap();
        let (address, token) = url.split_once("/#token=").unwrap();
        let (_, port) = address.rsplit_once(':').unwrap();
        Self {
            process,
            port: port.parse().unwrap(),
            token: token.to_owned(),
        }
    }

    /// Status and body of a response.
    fn get(&self, path: &str) -> (u16, Vec<u8>) {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).unwrap();
        let (port, token) = (self.port, &self.token);
        let request = format!(
            "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAuthorization: Bearer {token}\r\nConnection: close\r\n\r\n"
        );
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer
            .windows(4)
            .position(|four| four == b"\r\n\r\n")
            .unwrap();
        let body = answer.split_off(end + 4);
        let head = String::from_utf8(answer).unwrap();
        (head.split(' ').nth(1).unwrap().parse().unwrap(), body)
    }

    fn json(&self, path: &str) -> Value {
        let (code, body) = self.get(path);
        assert_eq!(code, 200, "{path}: {}", String::from_utf8_lossy(&body));
        serde_json::from_slice(&body).unwrap()
    }

    fn refusal(&self, path: &str, wanted: u16) -> String {
        let (code, body) = self.get(path);
        let text = String::from_utf8(body).unwrap();
        assert_eq!(code, wanted, "{path}: {text}");
        text
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn page_shows_all_sheets_and_plays_their_sessions() {
    let Some(mut archive) = Archive::start() else {
        return;
    };
    archive.archived_session();
    let page = Page::open(&archive, "nothing", &["--archive"]);
    let machines = page.json("/api/sheets");
    let machine = &machines[0];
    assert_eq!(machines.as_array().unwrap().len(), 1);
    assert_eq!(
        (&machine["site"], &machine["daq"], &machine["frames"]),
        (&"berlin".into(), &"bed3".into(), &3.into())
    );
    assert!(
        machine["silent_s"]
            .as_f64()
            .is_some_and(|s| (0.0..600.0).contains(&s)),
        "{machine}"
    );
    let sessions = page.json("/api/sheets/berlin/bed3");
    assert_eq!(sessions[0]["id"], "m20270115_1");
    assert_eq!(page.json("/api/sheets/berlin/bed4"), serde_json::json!([]));
    // the exact map equals that of the local record
    let named = "/api/sessions/archive%3Aberlin%2Fbed3%2Fm20270115_1";
    let opened = page.json(named);
    assert_eq!(opened["overview"]["id"], "archive:berlin/bed3/m20270115_1");
    assert_eq!(opened["overview"]["last_frame"], 3);
    while page.json(&format!("{named}/course"))["progress"].as_f64() < Some(1.0) {}
    let (code, archived) = page.get(&format!("{named}/maps/exact/frame/3"));
    assert_eq!(code, 200);
    let local = Page::open(&archive, "record", &[]);
    while local.json("/api/sessions/m20270115_1/course")["progress"].as_f64() < Some(1.0) {}
    let (_, recorded) = local.get("/api/sessions/m20270115_1/maps/exact/frame/3");
    assert!(recorded.len() > 1000 && archived == recorded);
    // errors are readable sentences
    let none = page.refusal("/api/sessions/archive%3Aberlin%2Fbed3%2Fm9", 409);
    assert!(none.contains("no session 'berlin/bed3/m9'"), "{none}");
    let closed = local.refusal(named, 409);
    assert!(closed.contains("tactus web --archive"), "{closed}");
    local.refusal("/api/sheets", 404);
    archive.server.kill(rustix::process::Signal::QUIT);
    let down = page.refusal("/api/sheets", 409);
    assert!(down.contains("cannot reach PostgreSQL"), "{down}");
    // an open session is played while the archive is not available
    assert_eq!(page.get(&format!("{named}/maps/quick/frame/2")).0, 200);
    archive.server.resume();
    page.json("/api/sheets");
}
