//! Sessions after a crash, a full disk or a flipped bit, and files that are not sessions.

use crate::content::{assert_is, at, baseline, frame, header};

use logbook::{LogbookError, SessionReader, SessionWriter, Storage};
use std::path::Path;

#[test]
fn a_killed_writer_leaves_an_open_session_with_every_frame() {
    let dir = tempfile::tempdir().unwrap();
    let copy = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("cut")).unwrap();
    for number in 1..=5 {
        writer.append(&frame(number), None).unwrap();
    }
    // Copy the files as they are on disk now, before the writer is dropped.
    for entry in std::fs::read_dir(dir.path()).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), copy.path().join(entry.file_name())).unwrap();
    }
    for place in [copy.path(), dir.path()] {
        let session = SessionReader::open(place.join("cut.tactus")).unwrap();
        assert_eq!(session.closed(), None);
        assert_eq!(session.len().unwrap(), 5);
        assert_is(&session.frame(5).unwrap(), 5);
    }
    drop(writer);
    let session = SessionReader::open(dir.path().join("cut.tactus")).unwrap();
    assert_eq!((session.closed(), session.len().unwrap()), (None, 5));
}

#[test]
fn a_torn_journal_costs_only_the_unacknowledged_frame() {
    let dir = tempfile::tempdir().unwrap();
    let copy = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("torn")).unwrap();
    for number in 1..=4 {
        writer.append(&frame(number), None).unwrap();
    }
    let journal = |place: &Path| place.join("torn.tactus-wal");
    let acknowledged = std::fs::metadata(journal(dir.path())).unwrap().len();
    writer.append(&frame(5), None).unwrap();
    std::fs::copy(writer.path(), copy.path().join("torn.tactus")).unwrap();
    let whole = std::fs::read(journal(dir.path())).unwrap();
    std::fs::write(journal(copy.path()), &whole[..acknowledged as usize + 300]).unwrap();
    let session = SessionReader::open(copy.path().join("torn.tactus")).unwrap();
    assert_eq!(session.len().unwrap(), 4);
    assert_is(&session.frame(4).unwrap(), 4);
}

#[test]
fn full_disk_is_reported_and_earlier_frames_are_whole() {
    let dir = tempfile::tempdir().unwrap();
    let storage = Storage {
        page_limit: Some(960),
        ..Storage::default()
    };
    let mut writer = SessionWriter::create_with(dir.path(), &header("full"), storage).unwrap();
    let mut kept = 0;
    let refusal = loop {
        match writer.append(&frame(kept + 1), None) {
            Ok(sequence) => kept = sequence,
            Err(refusal) => break refusal,
        }
        assert!(kept < 10_000, "the limit does not hold");
    };
    assert!(refusal.is_disk(), "{refusal}");
    assert!(refusal.to_string().contains("full.tactus"), "{refusal}");
    assert!(kept > 10);
    assert_eq!(writer.acknowledged(), kept);
    drop(writer);
    let session = SessionReader::open(dir.path().join("full.tactus")).unwrap();
    assert_eq!(session.len().unwrap(), kept);
    for (record, number) in session.frames().zip(1..) {
        assert_is(&record.unwrap(), number);
    }
}

#[test]
fn a_disk_too_full_for_a_header_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let storage = Storage {
        page_limit: Some(3),
        ..Storage::default()
    };
    let refusal = SessionWriter::create_with(dir.path(), &header("none"), storage).unwrap_err();
    assert!(refusal.is_disk(), "{refusal:?}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    SessionWriter::create(dir.path(), &header("none")).unwrap();
}

#[test]
fn a_flipped_bit_is_an_error_in_its_place_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("flip")).unwrap();
    writer.baseline(&baseline()).unwrap();
    for number in 1..=9 {
        writer.append(&frame(number), None).unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(at(10), "done").unwrap();
    let connection = rusqlite::Connection::open(&path).unwrap();
    for (column, sequence) in [("skew_us", 4), ("duration_us", 6)] {
        let change =
            format!("UPDATE frame SET {column} = {column} + 1 WHERE sequence = {sequence}");
        connection.execute(&change, []).unwrap();
    }
    let blob: Vec<u8> = connection
        .query_row("SELECT readings FROM frame WHERE sequence = 8", [], |row| {
            row.get(0)
        })
        .unwrap();
    let mut bent = blob;
    let last = bent.len() - 3;
    bent[last] ^= 1;
    connection
        .execute("UPDATE frame SET readings = ?1 WHERE sequence = 8", [bent])
        .unwrap();
    drop(connection);
    let session = SessionReader::open(&path).unwrap();
    let outcomes: Vec<bool> = session.frames().map(|record| record.is_ok()).collect();
    assert_eq!(
        outcomes,
        [true, true, true, false, true, false, true, false, true]
    );
    let refusal = session.frame(8).unwrap_err().to_string();
    assert!(
        refusal.contains("frame 8") && refusal.contains("flip.tactus"),
        "{refusal}"
    );
}

#[test]
fn a_damaged_frame_number_does_not_stop_the_reader() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("number")).unwrap();
    for number in 1..=5 {
        writer.append(&frame(number), None).unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(at(10), "done").unwrap();
    let change = |text: &str| {
        let connection = rusqlite::Connection::open(&path).unwrap();
        connection.execute_batch(text).unwrap();
    };
    let read = || {
        let session = SessionReader::open(&path).unwrap();
        let outcomes: Vec<bool> = session
            .frames()
            .take(50)
            .map(|record| record.is_ok())
            .collect();
        (outcomes, session.len().unwrap())
    };
    change("UPDATE frame SET sequence = 9223372036854775807 WHERE sequence = 5");
    assert_eq!(
        read(),
        (vec![true, true, true, true, false], i64::MAX as u64)
    );
    assert_eq!(logbook::verify(&path, |_| {}).unwrap().frames, 4);
    // Negative sequence numbers are never written; now all rows have one.
    change("UPDATE frame SET sequence = -sequence");
    assert_eq!(read(), (Vec::new(), 0));
}

#[test]
fn strangers_and_newer_files_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(format!("{name}.tactus"));
    std::fs::write(path("text"), "dear diary, ".repeat(500)).unwrap();
    std::fs::write(path("empty"), "").unwrap();
    rusqlite::Connection::open(path("other"))
        .unwrap()
        .execute_batch("CREATE TABLE t (x)")
        .unwrap();
    for stranger in ["text", "empty", "other"] {
        let refusal = SessionReader::open(path(stranger)).unwrap_err();
        assert!(
            matches!(refusal, LogbookError::NotASession { .. }),
            "{stranger}: {refusal:?}"
        );
    }
    let writer = SessionWriter::create(dir.path(), &header("newer")).unwrap();
    writer.close(at(1), "done").unwrap();
    rusqlite::Connection::open(path("newer"))
        .unwrap()
        .pragma_update(None, "user_version", 99)
        .unwrap();
    let refusal = SessionReader::open(path("newer")).unwrap_err();
    assert!(
        matches!(refusal, LogbookError::OtherSchema { has: 99, .. }),
        "{refusal:?}"
    );
    assert!(matches!(
        SessionReader::open(path("absent")),
        Err(LogbookError::Io { .. })
    ));
    let listing = logbook::list(dir.path()).unwrap();
    assert_eq!((listing.sessions.len(), listing.unreadable.len()), (0, 4));
}
