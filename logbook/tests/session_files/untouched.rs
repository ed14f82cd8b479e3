//! Reading sessions changes nothing in their folder, whatever files are there.

use std::collections::BTreeMap;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::example_frames::taken::{at, taken};
use crate::example_frames::written::written;
use logbook::{LogbookError, SessionReader, SessionWriter, repair, verify};
use rusqlite::Connection;
use survey::{Protocol, Reading};

const FRAMES: u64 = 20;

fn beside(path: &Path, end: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(end);
    name.into()
}

/// Copies a session as a killed writer leaves it.
fn as_killed(writer: &SessionWriter, to: &Path, ends: &[&str]) -> PathBuf {
    let copy = to.join(writer.path().file_name().unwrap());
    for end in ends {
        std::fs::copy(beside(writer.path(), end), beside(&copy, end)).unwrap();
    }
    copy
}

/// Bytes, inode and time of the last change of every file of a folder.
type Folder = BTreeMap<PathBuf, (Vec<u8>, u64, SystemTime)>;

fn all(dir: &Path) -> Folder {
    std::fs::read_dir(dir)
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let found = std::fs::symlink_metadata(&path).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            (path, (bytes, found.ino(), found.modified().unwrap()))
        })
        .collect()
}

/// Calls every reading function; returns the number of frames found.
fn looked_at(path: &Path) -> u64 {
    logbook::list(path.parent().unwrap()).unwrap();
    verify(path, |_| {}).unwrap();
    let _ = logbook::volume(path);
    let session = SessionReader::open(path).unwrap();
    session
        .frames()
        .map(|record| record.unwrap().frame.sequence)
        .max()
        .unwrap_or(0)
}

#[test]
fn looking_changes_no_byte_no_time_and_no_listing() {
    let made = tempfile::tempdir().unwrap();
    let writer = written(made.path(), "m1", 8, FRAMES);
    for ends in [&["", "-wal", "-shm"][..], &["", "-wal"]] {
        let dir = tempfile::tempdir().unwrap();
        let path = as_killed(&writer, dir.path(), ends);
        let before = all(dir.path());
        assert_eq!(looked_at(&path), FRAMES, "{ends:?}");
        assert!(before == all(dir.path()), "{ends:?}: something was changed");
    }
    let path = writer.path().to_owned();
    writer.close(at(100), "done").unwrap();
    let before = all(made.path());
    assert_eq!(before.len(), 1);
    assert_eq!(looked_at(&path), FRAMES);
    assert!(before == all(made.path()), "something was changed");
}

/// Runs scripts on a copy of the session; returns its companion file `end` as it is while the connection is still open.
fn left_by(path: &Path, scripts: &[&str], end: &str) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let copy = dir.path().join("copy.tactus");
    std::fs::copy(path, &copy).unwrap();
    let connection = Connection::open(&copy).unwrap();
    for script in scripts {
        connection.execute_batch(script).unwrap();
    }
    std::fs::read(beside(&copy, end)).unwrap()
}

const OTHERWISE: &str =
    "DELETE FROM frame WHERE sequence > 5; UPDATE session SET note = 'otherwise'";

/// A rollback journal that would restore a file without the frames after 5.
fn hostile_journal(path: &Path) -> Vec<u8> {
    // without a sync the number of pages is not written before the end, and SQLite uses the size of the journal
    let changing =
        "PRAGMA synchronous = OFF; BEGIN; UPDATE session SET note = 'x'; DELETE FROM frame";
    left_by(path, &[OTHERWISE, changing], "-journal")
}

/// A write-ahead log with a transaction that deletes the frames after 5.
fn hostile_log(path: &Path) -> Vec<u8> {
    left_by(path, &["PRAGMA journal_mode = WAL", OTHERWISE], "-wal")
}

#[test]
fn a_stray_journal_beside_a_closed_session_is_not_played_back() {
    let dir = tempfile::tempdir().unwrap();
    let writer = written(dir.path(), "m1", 8, FRAMES);
    let path = writer.path().to_owned();
    writer.close(at(100), "done").unwrap();
    let header = SessionReader::open(&path).unwrap().header().clone();
    for (end, journal) in [
        ("-journal", hostile_journal(&path)),
        ("-wal", hostile_log(&path)),
    ] {
        std::fs::write(beside(&path, end), journal).unwrap();
        let before = all(dir.path());
        assert_eq!(looked_at(&path), FRAMES, "{end}");
        assert_eq!(
            *SessionReader::open(&path).unwrap().header(),
            header,
            "{end}"
        );
        assert!(before == all(dir.path()), "{end}: something was changed");
        // the copy made by a repair has the frames of this session, too
        let out = tempfile::tempdir().unwrap();
        let repaired = repair(&path, Some(&out.path().join("r.tactus")), at(200), |_| {}).unwrap();
        assert_eq!(repaired.frames, FRAMES, "{end}");
        assert!(before == all(dir.path()), "{end}: something was changed");
        std::fs::remove_file(beside(&path, end)).unwrap();
    }
}

#[test]
fn a_damaged_header_of_the_journal_is_reported() {
    let made = tempfile::tempdir().unwrap();
    let writer = written(made.path(), "m1", 8, FRAMES);
    let found_in = |change: &dyn Fn(&mut Vec<u8>), ends: &[&str]| {
        let dir = tempfile::tempdir().unwrap();
        let path = as_killed(&writer, dir.path(), ends);
        let log = beside(&path, "-wal");
        let mut bytes = std::fs::read(&log).unwrap();
        change(&mut bytes);
        std::fs::write(&log, bytes).unwrap();
        let opened = SessionReader::open(&path).map(|session| session.frames().count() as u64);
        (opened, verify(&path, |_| {}).unwrap().findings)
    };
    for ends in [&["", "-wal", "-shm"][..], &["", "-wal"]] {
        assert_eq!(found_in(&|_| {}, ends).0.unwrap(), FRAMES);
        let refused = |change: &dyn Fn(&mut Vec<u8>)| {
            let (opened, findings) = found_in(change, ends);
            let refused = opened.unwrap_err();
            assert!(
                matches!(refused, LogbookError::Damaged { .. }),
                "{refused:?}"
            );
            assert!(refused.to_string().contains("m1.tactus-wal"), "{refused}");
            assert_eq!(findings.len(), 1, "{findings:?}");
        };
        for at in 0..32 {
            refused(&|log| log[at] ^= 1);
        }
        // the header is synced before a frame is written
        refused(&|log| log[..32].fill(0));
        // a power cut before the first sync leaves no header, or zeros: nothing was acknowledged
        for left in [vec![0; 31], vec![0; 32]] {
            let (opened, _) = found_in(&|log| log.clone_from(&left), ends);
            assert!(
                matches!(opened, Err(LogbookError::NotASession { .. })),
                "{opened:?}"
            );
        }
    }
}

#[test]
fn an_interrupted_session_resumes_without_a_stray_journal() {
    let made = tempfile::tempdir().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let writer = written(made.path(), "m1", 8, FRAMES);
    let path = as_killed(&writer, dir.path(), &["", "-wal"]);
    writer.close(at(100), "done").unwrap();
    let stray = hostile_journal(&made.path().join("m1.tactus"));
    std::fs::write(beside(&path, "-journal"), stray).unwrap();
    let before = all(dir.path());
    let refused = SessionReader::open(&path).map(|_| ()).unwrap_err();
    assert!(
        matches!(refused, LogbookError::Damaged { .. }),
        "{refused:?}"
    );
    assert!(
        refused.to_string().contains("m1.tactus-journal"),
        "{refused}"
    );
    let findings = verify(&path, |_| {}).unwrap().findings;
    assert_eq!(findings[0].kind, "header", "{findings:?}");
    assert!(before == all(dir.path()), "something was changed");

    let (writer, resumed) = SessionWriter::resume(&path).unwrap();
    assert_eq!(resumed.acknowledged, FRAMES);
    writer.close(at(200), "done").unwrap();
    assert_eq!(looked_at(&path), FRAMES);
}

#[test]
fn a_reader_of_another_process_reads_what_is_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = written(dir.path(), "m1", 8, FRAMES);
    let protocol = Protocol::sheffield(8).unwrap();
    let session = SessionReader::open(writer.path()).unwrap();
    for number in FRAMES + 1..FRAMES + 30 {
        let readings = vec![Reading::Overload; protocol.len()];
        let frame = taken(&protocol, number, number as i64, readings);
        writer.append(&frame, None).unwrap();
        assert_eq!(session.last_sequence().unwrap(), number);
        let again = SessionReader::open(writer.path()).unwrap();
        assert_eq!(again.last_sequence().unwrap(), number);
    }
}
