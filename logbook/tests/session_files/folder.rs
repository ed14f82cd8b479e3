//! The sessions of a folder: listed, found by their ids, cached in an index.

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;

use crate::content::{at, baseline, frame, header};

use logbook::{LogbookError, SessionHeader, SessionKind, SessionWriter};

#[test]
fn sessions_are_listed_and_found_by_the_beginning_of_their_id() {
    let dir = tempfile::tempdir().unwrap();
    assert!(
        logbook::list(dir.path().join("absent"))
            .unwrap()
            .sessions
            .is_empty()
    );
    for (second, id, kind) in [
        (5, "20250105_a", SessionKind::Measurement),
        (1, "20250101_b", SessionKind::Baseline),
        (3, "20250103_b", SessionKind::Baseline),
    ] {
        let mut header = header(id);
        header.started = at(second);
        header.kind = kind;
        let mut writer = SessionWriter::create(dir.path(), &header).unwrap();
        writer.append(&frame(1), None).unwrap();
        if id == "20250101_b" {
            writer.baseline(&baseline()).unwrap();
        }
        writer.close(at(second + 1), "done").unwrap();
    }
    let running = SessionWriter::create(dir.path(), &header("20250107_a")).unwrap();
    let listing = logbook::list(dir.path()).unwrap();
    let ids: Vec<&str> = listing
        .sessions
        .iter()
        .map(|session| session.id.as_str())
        .collect();
    assert_eq!(
        ids,
        ["20250107_a", "20250101_b", "20250103_b", "20250105_a"]
    );
    assert_eq!(
        (listing.sessions[3].frames, listing.sessions[3].last),
        (1, Some(at(1)))
    );
    assert!(listing.sessions[0].closed.is_none());
    let found = |asked: &str| logbook::find(dir.path(), asked);
    assert!(found("20250105").unwrap().ends_with("20250105_a.tactus"));
    assert!(matches!(
        found("nothing"),
        Err(LogbookError::NoSuchSession { .. })
    ));
    let refusal = found("2025010").unwrap_err();
    assert!(
        matches!(&refusal, LogbookError::Ambiguous { .. }),
        "{refusal:?}"
    );
    assert!(refusal.to_string().contains("20250103_b"), "{refusal}");
    // The newer baseline session was closed before it had a baseline.
    let now = at(1_000_000_000);
    let latest = |now| {
        let mut index = logbook::Index::load(dir.path());
        index.refresh().unwrap();
        index.latest_baseline(now).unwrap().unwrap()
    };
    let (summary, kept) = latest(now);
    assert_eq!((summary.id.as_str(), kept), ("20250101_b", baseline()));
    // A baseline dated in the future is the latest only if there is no other.
    let ahead = SessionHeader {
        kind: SessionKind::Baseline,
        started: now + std::time::Duration::from_secs(30_000 * 86_400),
        ..header("20990101_b")
    };
    let mut writer = SessionWriter::create(dir.path(), &ahead).unwrap();
    writer.baseline(&baseline()).unwrap();
    writer.close(ahead.started, "done").unwrap();
    assert_eq!(latest(now).0.id, "20250101_b");
    assert_eq!(latest(ahead.started).0.id, "20990101_b");
    std::fs::remove_file(dir.path().join("20250101_b.tactus")).unwrap();
    assert_eq!(latest(now).0.id, "20990101_b");
    drop(running);
}

/// A folder with three closed sessions, and an index that contains them all.
fn indexed() -> (tempfile::TempDir, logbook::Index) {
    let dir = tempfile::tempdir().unwrap();
    for id in ["a", "b", "c"] {
        let mut writer = SessionWriter::create(dir.path(), &header(id)).unwrap();
        writer.append(&frame(1), None).unwrap();
        writer.close(at(2), "done").unwrap();
    }
    let mut index = logbook::Index::load(dir.path());
    assert_eq!(index.unknown().unwrap(), 3);
    // a file changed within the last tick of the file system's clock could change again unnoticed, so it is not
    // indexed yet
    while index.unknown().unwrap() > 0 {
        index.refresh().unwrap();
    }
    index.save().unwrap();
    (dir, index)
}

#[test]
fn an_index_opens_only_what_has_changed() {
    let (dir, mut index) = indexed();
    let file = |id: &str| dir.path().join(format!("{id}.tactus"));
    let kept = |index: &logbook::Index| index.sessions().into_iter().cloned().collect::<Vec<_>>();
    assert_eq!(kept(&index).len(), 3);
    // another process loads the saved index
    let mut again = logbook::Index::load(dir.path());
    assert_eq!((again.unknown().unwrap(), kept(&again)), (0, kept(&index)));

    // an open session is read each time
    let mut writer = SessionWriter::create(dir.path(), &header("d")).unwrap();
    for frames in 1..=3 {
        writer.append(&frame(frames), None).unwrap();
        index.refresh().unwrap();
        let open = index.sessions().into_iter().find(|open| open.id == "d");
        let open = open.unwrap();
        assert_eq!((open.frames, &open.closed), (frames, &None));
    }
    assert_eq!(index.interrupted()[0].id, "d");
    index.save().unwrap();
    writer.close(at(9), "done").unwrap();
    // a replaced, a deleted and a damaged session, and a pipe, on which the index must not block
    std::fs::copy(file("a"), file("b")).unwrap();
    std::fs::remove_file(file("a")).unwrap();
    std::fs::write(file("c"), "SQLite format 3, but no more").unwrap();
    let made = std::process::Command::new("mkfifo")
        .arg(file("pipe"))
        .status();
    assert!(made.unwrap().success());
    for index in [&mut index, &mut logbook::Index::load(dir.path())] {
        index.refresh().unwrap();
        let ids: Vec<&str> = index
            .sessions()
            .iter()
            .map(|kept| kept.id.as_str())
            .collect();
        assert_eq!(ids, ["a", "d"]);
        assert!(index.interrupted().is_empty());
        let unreadable = index.unreadable();
        assert_eq!(unreadable.len(), 2);
        assert!(unreadable[1].why.to_string().contains("it is a FIFO"));
    }
}

#[test]
fn a_damaged_index_costs_a_reading_and_nothing_else() {
    let (dir, _) = indexed();
    let whole = logbook::list(dir.path()).unwrap().sessions;
    let path = dir.path().join("sessions-1.index");
    let bytes = std::fs::read(&path).unwrap();
    let seen = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        logbook::list(dir.path()).unwrap().sessions
    };
    for place in (0..bytes.len()).step_by(7) {
        let mut damaged = bytes.clone();
        damaged[place] ^= 1 << (place % 8);
        assert_eq!(seen(&damaged), whole, "a bit of byte {place}");
    }
    for length in (0..bytes.len()).step_by(31) {
        assert_eq!(seen(&bytes[..length]), whole, "{length} bytes");
    }
    // new entries begin on a new line after a torn one
    std::fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
    let mut index = logbook::Index::load(dir.path());
    assert_eq!(index.unknown().unwrap(), 1);
    index.refresh().unwrap();
    index.save().unwrap();
    assert_eq!(logbook::Index::load(dir.path()).unknown().unwrap(), 0);
}

#[test]
fn sessions_of_today_are_found_without_opening_older_ones() {
    let (dir, _) = indexed();
    std::fs::remove_file(dir.path().join("sessions-1.index")).unwrap();
    let long_ago = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1_000_000_000);
    for id in ["a", "b", "c"] {
        let file = std::fs::File::open(dir.path().join(format!("{id}.tactus"))).unwrap();
        file.set_modified(long_ago).unwrap();
    }
    let mut writer = SessionWriter::create(dir.path(), &header("d")).unwrap();
    writer.append(&frame(1), None).unwrap();
    // the newest data are only in the journal: the file itself looks old
    let path = dir.path().join("d.tactus");
    std::fs::File::open(&path)
        .unwrap()
        .set_modified(long_ago)
        .unwrap();
    let mut index = logbook::Index::load(dir.path());
    let ids = |index: &logbook::Index| -> Vec<String> {
        let mut ids: Vec<_> = index.sessions().iter().map(|one| one.id.clone()).collect();
        ids.sort();
        ids
    };
    index
        .refresh_since(chrono::DateTime::from_timestamp(1_500_000_000, 0).unwrap())
        .unwrap();
    assert_eq!(ids(&index), ["d"]);
    assert_eq!(index.interrupted()[0].id, "d");
    index.refresh().unwrap();
    assert_eq!(ids(&index), ["a", "b", "c", "d"]);
}

#[test]
fn a_folder_that_was_not_walked_again_is_still_seen_to_change() {
    let (dir, mut index) = indexed();
    let names = |index: &logbook::Index| index.sessions().len();
    // wait until no later change can have the folder's modification time
    let changed = std::fs::metadata(dir.path()).unwrap().modified().unwrap();
    while changed.elapsed().is_ok_and(|since| since.as_millis() < 200) {
        index.refresh().unwrap();
    }
    for count in [3, 2, 1] {
        index.refresh().unwrap();
        assert_eq!(names(&index), count);
        let id = ["a", "b", "c"][count - 1];
        std::fs::remove_file(dir.path().join(format!("{id}.tactus"))).unwrap();
    }
    index.refresh().unwrap();
    assert_eq!(names(&index), 0);
    SessionWriter::create(dir.path(), &header("e")).unwrap();
    index.refresh().unwrap();
    assert_eq!(names(&index), 1);
}

#[test]
fn names_that_are_not_utf8_are_parts_of_their_own_session() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &[u8]| dir.path().join(OsStr::from_bytes(name));
    let names: [&[u8]; 3] = [b"one\xff.tactus", b"one\xff_p2.tactus", b"other\xff.tactus"];
    for name in names {
        std::fs::write(path(name), "").unwrap();
    }
    let [first, second, other] = names.map(path);
    assert_eq!(logbook::parts(&second).unwrap(), [first, second]);
    assert_eq!(logbook::parts(&other).unwrap(), [other]);
}
