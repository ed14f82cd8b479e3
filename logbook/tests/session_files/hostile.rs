//! Malicious files: foreign tables, endless SQL, texts that fill the memory, and paths that are not regular files.

use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

use crate::example_frames::taken::at;
use crate::example_frames::written::written;
use logbook::{LogbookError, SessionReader, verify};
use rusqlite::Connection;

/// Ends a hung test.
const DEADLINE: Duration = Duration::from_secs(120);

fn closed(dir: &Path, id: &str) -> PathBuf {
    let writer = written(dir, id, 8, 20);
    let path = writer.path().to_owned();
    writer.close(at(100), "done").unwrap();
    path
}

/// Runs `act` in a thread; panics if it does not end.
fn ends<T: Send + 'static>(what: &str, act: impl FnOnce() -> T + Send + 'static) -> T {
    let (send, receive) = mpsc::channel();
    std::thread::spawn(move || send.send(act()));
    let done = receive.recv_timeout(DEADLINE);
    done.unwrap_or_else(|_| panic!("{what}: did not end"))
}

/// Reads a session in every way that clients use.
fn read(path: &Path) -> Option<LogbookError> {
    let _ = logbook::list(path.parent().unwrap());
    let _ = logbook::volume(path);
    match SessionReader::open(path) {
        Err(refusal) => Some(refusal),
        Ok(session) => {
            let _ = (session.summary(), session.baseline(), session.events());
            session.frames().take(10_000).find_map(Result::err)
        }
    }
}

const ENDLESS: &str = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT";

#[test]
fn a_file_with_other_tables_than_ours_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let columns = "sequence, stretch, tick_us, skew_us, duration_us, reference, flags, loop_sum, remarks, map_hash, \
                   readings, checksum";
    let cases = [
        (
            "a view in place of a table",
            format!(
                "DROP VIEW taken; ALTER TABLE frame RENAME TO hidden;
                 CREATE VIEW frame AS {ENDLESS} x AS sequence, {} FROM n",
                columns.replacen("sequence, ", "", 1).replace(", ", " , NULL AS ").replacen("stretch", "1 AS stretch", 1)
            ),
        ),
        (
            "a header without an end",
            format!(
                "CREATE TABLE kept AS SELECT * FROM session; DROP TABLE session;
                 CREATE VIEW session AS {ENDLESS} kept.* FROM n, kept"
            ),
        ),
        (
            "another view of times",
            format!(
                "DROP VIEW taken; CREATE VIEW taken AS {ENDLESS} x AS sequence, x AS monotonic_us, x AS wall_us,
                 x AS duration_us FROM n WHERE x < 0"
            ),
        ),
        (
            "a virtual table",
            "CREATE VIRTUAL TABLE words USING fts5(text)".to_owned(),
        ),
        (
            "a trigger",
            "CREATE TRIGGER t AFTER UPDATE ON session BEGIN DELETE FROM frame; END".to_owned(),
        ),
        (
            "a generated column",
            "ALTER TABLE event ADD COLUMN more ANY AS (hex(zeroblob(id * 1000000)))".to_owned(),
        ),
        ("an index", "CREATE INDEX i ON event (kind)".to_owned()),
    ];
    for (index, (name, sql)) in cases.into_iter().enumerate() {
        let path = closed(dir.path(), &format!("m{index}"));
        Connection::open(&path)
            .unwrap()
            .execute_batch(&format!("PRAGMA legacy_alter_table = ON; {sql}"))
            .unwrap();
        let refusal = ends(name, {
            let path = path.clone();
            move || read(&path)
        });
        let text = refusal
            .as_ref()
            .map(ToString::to_string)
            .unwrap_or_default();
        assert!(
            matches!(refusal, Some(LogbookError::Damaged { .. })) && text.contains("its tables"),
            "{name}: {refusal:?}"
        );
        let findings = verify(&path, |_| {}).unwrap().findings;
        assert_eq!(findings[0].kind, "header", "{name}: {findings:?}");
        std::fs::remove_file(path).unwrap();
    }
}

#[test]
fn a_text_of_400_mb_is_refused_before_it_is_in_memory() {
    let dir = tempfile::tempdir().unwrap();
    for (index, sql) in [
        "UPDATE session SET note = CAST(zeroblob(400000000) AS TEXT)",
        "UPDATE event SET text = CAST(zeroblob(400000000) AS TEXT)",
        "UPDATE frame SET readings = zeroblob(400000000) WHERE sequence = 3",
    ]
    .into_iter()
    .enumerate()
    {
        let path = closed(dir.path(), &format!("m{index}"));
        let connection = Connection::open(&path).unwrap();
        connection
            .execute_batch(
                "PRAGMA synchronous = OFF; PRAGMA journal_mode = OFF;
                 INSERT INTO event VALUES (1, 1, 'note', 'text', x'00')",
            )
            .unwrap();
        connection.execute(sql, []).unwrap();
        drop(connection);
        // reset the peak, which includes the memory of the writer
        std::fs::write("/proc/self/clear_refs", "5").unwrap();
        let before = peak();
        let verified = ends(sql, {
            let path = path.clone();
            move || {
                let _ = read(&path);
                verify(&path, |_| {}).unwrap()
            }
        });
        assert!(!verified.findings.is_empty(), "{sql}");
        let grown = peak() - before;
        assert!(grown < 200_000, "{sql}: {grown} kB more at the peak");
        std::fs::remove_file(path).unwrap();
    }
}

/// The peak memory of this process so far, kB.
fn peak() -> i64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status
        .lines()
        .find(|line| line.starts_with("VmHWM"))
        .unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn what_is_no_file_is_passed_by_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let whole = closed(dir.path(), "m1");
    let path = |name: &str| dir.path().join(format!("{name}.tactus"));
    let made = std::process::Command::new("mkfifo")
        .arg(path("fifo"))
        .status()
        .unwrap();
    assert!(made.success());
    let _socket = UnixListener::bind(path("socket")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", path("device")).unwrap();
    std::fs::create_dir(path("folder")).unwrap();
    std::fs::write(path("empty"), "").unwrap();
    let folder = dir.path().to_owned();
    let listing = ends("a list", move || logbook::list(folder).unwrap());
    assert_eq!(listing.sessions.len(), 1);
    assert_eq!(listing.sessions[0].path, whole);
    assert_eq!(listing.unreadable.len(), 5);
    for unreadable in &listing.unreadable {
        let name = unreadable.path.file_stem().unwrap().to_string_lossy();
        let name = name.replace("fifo", "FIFO");
        assert!(
            unreadable.why.to_string().contains(&name),
            "{}",
            unreadable.why
        );
        let path = unreadable.path.clone();
        let verified = ends("verify", move || verify(path, |_| {}).unwrap());
        assert_eq!(verified.findings[0].kind, "unreadable", "{verified:?}");
    }
    // a journal that is a pipe
    std::fs::remove_file(path("fifo")).unwrap();
    let mut wal = whole.clone().into_os_string();
    wal.push("-wal");
    let made = std::process::Command::new("mkfifo")
        .arg(wal)
        .status()
        .unwrap();
    assert!(made.success());
    let refusal = ends("a reader", move || read(&whole));
    assert!(
        refusal.is_none(),
        "a closed session has no journal: {refusal:?}"
    );
}
