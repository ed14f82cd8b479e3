//! Sessions that continue: after a crash, in the next part, after a disk error.

use std::path::Path;
use std::time::Duration;

use crate::example_frames::taken::{at, taken};
use logbook::{
    CONTINUED, LogbookError, RESUMED, SessionHeader, SessionReader, SessionWriter, Storage,
};
use survey::{Baseline, Frame, Protocol, Reading, Volts};

fn protocol() -> Protocol {
    Protocol::sheffield(8).unwrap()
}

fn frame(number: u64) -> Frame {
    let readings = (0..protocol().len() as u64)
        .map(|k| Reading::Ok(Volts((7919 * k + (number * k) % 41) as f64 / 1e7)))
        .collect();
    taken(&protocol(), number, number as i64, readings)
}

fn baseline() -> Baseline {
    Baseline::from_frames("b1", &(1..5).map(frame).collect::<Vec<_>>()).unwrap()
}

fn header(id: &str) -> SessionHeader {
    SessionHeader {
        note: "kept over parts".into(),
        asked: "{\"every\":1}".into(),
        ..SessionHeader::new(id, at(0), protocol())
    }
}

fn begun(dir: &Path, id: &str, frames: u64) -> SessionWriter {
    let mut writer = SessionWriter::create(dir, &header(id)).unwrap();
    writer.baseline(&baseline()).unwrap();
    for number in 1..=frames {
        assert_eq!(writer.append(&frame(number), None).unwrap(), number);
    }
    writer
}

/// Copies the files of a session as they are on disk now, before the writer is dropped.
fn copy_of_files(from: &Path) -> tempfile::TempDir {
    let to = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), to.path().join(entry.file_name())).unwrap();
    }
    to
}

fn holds(path: impl AsRef<Path>, frames: std::ops::RangeInclusive<u64>) -> SessionReader {
    let session = SessionReader::open(path).unwrap();
    let kept: Vec<Frame> = session
        .frames()
        .map(|record| record.unwrap().frame)
        .collect();
    let expected: Vec<Frame> = frames.map(frame).collect();
    assert_eq!(kept, expected);
    session
}

#[test]
fn a_session_whose_writer_was_killed_goes_on_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let writer = begun(dir.path(), "m1", 20);
    let place = copy_of_files(dir.path());
    drop(writer);
    let path = place.path().join("m1.tactus");
    let found = logbook::interrupted(place.path()).unwrap();
    assert_eq!((found.len(), &found[0].path), (1, &path));
    let (mut writer, resumed) = SessionWriter::resume(&path).unwrap();
    assert_eq!(resumed.header, header("m1"));
    assert_eq!((resumed.acknowledged, resumed.before.len()), (20, 0));
    let last = resumed.last.unwrap();
    assert_eq!(
        (last.wall, last.monotonic),
        (at(20), Duration::from_secs(20))
    );
    writer
        .event(at(30), RESUMED, "the daemon was killed")
        .unwrap();
    for number in 21..=60 {
        assert_eq!(writer.append(&frame(number), None).unwrap(), number);
    }
    drop(writer);
    let (writer, resumed) = SessionWriter::resume(&path).unwrap();
    assert_eq!((resumed.acknowledged, resumed.before), (60, vec![at(30)]));
    writer.close(at(70), "done").unwrap();
    let session = holds(&path, 1..=60);
    assert_eq!(session.baseline().unwrap(), Some(baseline()));
    let refusal = SessionWriter::resume(&path).unwrap_err();
    assert!(
        matches!(&refusal, LogbookError::Closed { reason, .. } if reason == "done"),
        "{refusal:?}"
    );
    assert!(logbook::interrupted(place.path()).unwrap().is_empty());
}

#[test]
fn a_session_resumes_without_frames_but_not_without_its_last() {
    let dir = tempfile::tempdir().unwrap();
    drop(begun(dir.path(), "empty", 0));
    let path = dir.path().join("empty.tactus");
    let (mut writer, resumed) = SessionWriter::resume(&path).unwrap();
    assert_eq!((resumed.acknowledged, resumed.last), (0, None));
    assert_eq!(writer.append(&frame(1), None).unwrap(), 1);
    drop(writer);

    drop(begun(dir.path(), "holed", 9));
    let path = dir.path().join("holed.tactus");
    let change = |sql: &str| {
        rusqlite::Connection::open(&path)
            .unwrap()
            .execute(sql, [])
            .unwrap()
    };
    change("DELETE FROM frame WHERE sequence = 5");
    let refusal = SessionWriter::resume(&path).unwrap_err().to_string();
    assert!(refusal.contains("frame 5"), "{refusal}");
    change("DELETE FROM frame WHERE sequence < 5");
    let refusal = SessionWriter::resume(&path).unwrap_err().to_string();
    assert!(refusal.contains("frame 1"), "{refusal}");
    change("UPDATE frame SET skew_us = skew_us + 1 WHERE sequence = 9");
    let refusal = SessionWriter::resume(&path).unwrap_err().to_string();
    assert!(refusal.contains("frame 1"), "{refusal}");
    // The readable frames are kept: a new part continues after them.
    let (mut next, resumed) = SessionWriter::after(&path, at(50), "damaged").unwrap();
    assert_eq!(resumed.acknowledged, 9);
    assert_eq!(next.append(&frame(10), None).unwrap(), 10);
    assert_eq!(next.header().continues.as_deref(), Some("holed"));
}

#[test]
fn a_session_rolls_over_without_a_gap() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = begun(dir.path(), "m1", 20);
    assert!(writer.bytes() > 8192);
    let path = |id: &str| dir.path().join(format!("{id}.tactus"));
    for (part, last) in [("m1", 20), ("m1_p2", 40), ("m1_p3", 60)] {
        assert_eq!(writer.header().id, part);
        assert_eq!(writer.roll(at(last as i64)).unwrap(), path(part));
        for number in last + 1..=last + 20 {
            assert_eq!(writer.append(&frame(number), None).unwrap(), number);
        }
    }
    assert_eq!(writer.path(), path("m1_p4"));
    writer.close(at(80), "count reached").unwrap();

    let first = holds(path("m1"), 1..=20);
    assert_eq!(first.closed().unwrap().reason, "continued in m1_p2");
    let third = holds(path("m1_p3"), 41..=60);
    assert_eq!(third.header().continues.as_deref(), Some("m1_p2"));
    assert_eq!(third.header().first_sequence, 41);
    assert_eq!(
        (third.len().unwrap(), third.last_sequence().unwrap()),
        (20, 60)
    );
    assert_eq!(third.last().unwrap().unwrap().frame, frame(60));
    assert_eq!(third.baseline().unwrap(), Some(baseline()));
    assert_eq!(third.header().note, "kept over parts");
    let events = third.events().unwrap();
    assert_eq!(events[0].kind, CONTINUED);
    assert!(
        events[0].text.contains("m1_p2 after frame 40"),
        "{}",
        events[0].text
    );
    let refusal = third.frame(1).unwrap_err().to_string();
    assert!(refusal.contains("counted from 41"), "{refusal}");

    // A prefix that matches several parts of one session finds the first of them.
    assert_eq!(logbook::find(dir.path(), "m").unwrap(), path("m1"));
    assert_eq!(logbook::find(dir.path(), "m1_p").unwrap(), path("m1_p2"));
    assert_eq!(logbook::find(dir.path(), "m1_p3").unwrap(), path("m1_p3"));
    drop(begun(dir.path(), "m2", 1));
    assert!(matches!(
        logbook::find(dir.path(), "m"),
        Err(LogbookError::Ambiguous { .. })
    ));
}

#[test]
fn a_crash_between_the_two_steps_of_rolling_over_is_understood() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = begun(dir.path(), "m1", 5);
    let before = copy_of_files(dir.path());
    writer.roll(at(6)).unwrap();
    for entry in std::fs::read_dir(dir.path()).unwrap() {
        let name = entry.unwrap().file_name();
        if name.to_string_lossy().contains("_p2") {
            std::fs::copy(dir.path().join(&name), before.path().join(&name)).unwrap();
        }
    }
    // Both parts are open now: the newer one is the session.
    let found = logbook::interrupted(before.path()).unwrap();
    let ids: Vec<&str> = found.iter().map(|session| session.id.as_str()).collect();
    assert_eq!(ids, ["m1_p2"]);
    let refusal = SessionWriter::resume(before.path().join("m1.tactus")).unwrap_err();
    assert!(
        matches!(&refusal, LogbookError::Continued { by, .. } if by == "m1_p2"),
        "{refusal:?}"
    );
    let (mut writer, resumed) = SessionWriter::resume(&found[0].path).unwrap();
    assert_eq!(resumed.acknowledged, 5);
    assert_eq!(writer.append(&frame(6), None).unwrap(), 6);
    let earlier = holds(before.path().join("m1.tactus"), 1..=5);
    assert_eq!(earlier.closed().unwrap().reason, "continued in m1_p2");
}

#[test]
fn a_part_that_was_not_completed_is_skipped_and_kept() {
    let dir = tempfile::tempdir().unwrap();
    drop(begun(dir.path(), "m1", 5));
    std::fs::write(dir.path().join("m1_p2.tactus"), "").unwrap();
    let path = dir.path().join("m1.tactus");
    let (mut writer, _) = SessionWriter::resume(&path).unwrap();
    assert_eq!(writer.roll(at(6)).unwrap(), path);
    assert_eq!(writer.header().id, "m1_p3");
    drop(writer);
    let found = logbook::interrupted(dir.path()).unwrap();
    assert_eq!(found[0].id, "m1_p3");
}

#[test]
fn a_disk_too_full_to_roll_over_leaves_the_session_where_it_was() {
    let dir = tempfile::tempdir().unwrap();
    let storage = Storage {
        page_limit: Some(3),
        ..Storage::default()
    };
    drop(begun(dir.path(), "m1", 3));
    let path = dir.path().join("m1.tactus");
    // Three pages are too few for the header of a new part; the present part is already larger.
    let (mut writer, _) = SessionWriter::resume_with(&path, storage).unwrap();
    let refusal = writer.roll(at(4)).unwrap_err();
    assert!(refusal.is_full() && !refusal.is_broken(), "{refusal:?}");
    assert!(!dir.path().join("m1_p2.tactus").exists());
    assert_eq!(writer.header().id, "m1");
    assert_eq!(writer.append(&frame(4), None).unwrap(), 4);
    drop(writer);
    assert_eq!(holds(&path, 1..=4).closed(), None);
}

#[test]
fn a_successor_goes_on_behind_what_was_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = begun(dir.path(), "m1", 7);
    let left = writer.successor(at(8), "fsync failed").unwrap();
    assert_eq!(left, dir.path().join("m1.tactus"));
    assert_eq!(writer.append(&frame(8), None).unwrap(), 8);
    let next = holds(dir.path().join("m1_p2.tactus"), 8..=8);
    assert_eq!(next.baseline().unwrap(), Some(baseline()));
    let event = &next.events().unwrap()[0];
    assert!(
        event.text.ends_with("after frame 7: fsync failed"),
        "{}",
        event.text
    );
    assert_eq!(holds(&left, 1..=7).closed(), None);
    assert!(
        left.with_extension("tactus-wal").exists(),
        "its journal is not merged"
    );
}

/// A frame taken at a second of its process, with this wall time.
fn frame_at(number: u64, monotonic: u64, second: i64) -> Frame {
    Frame {
        monotonic: Duration::from_secs(monotonic),
        wall: at(second),
        ..frame(number)
    }
}

#[test]
fn time_run_counts_no_setting_of_the_wall_clock() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("m1")).unwrap();
    let first = writer.path().to_owned();
    let run = || logbook::time_run(&first).unwrap().as_secs();
    assert_eq!(run(), 0);
    // the process started 100 s before the session; its clock is set back by an hour, and in the next part forward
    writer.append(&frame_at(1, 101, 1), None).unwrap();
    writer.append(&frame_at(2, 110, 10), None).unwrap();
    writer.append(&frame_at(3, 120, 20 - 3600), None).unwrap();
    assert_eq!(run(), 20);
    writer.roll(at(25 - 3600)).unwrap();
    writer.append(&frame_at(4, 130, 30 + 86_400), None).unwrap();
    assert_eq!(run(), 30);
    let second = writer.path().to_owned();
    drop(writer);
    // another process, whose monotonic clock has passed that of the one before
    let (mut writer, _) = SessionWriter::resume(&second).unwrap();
    let event = |writer: &mut SessionWriter, second| {
        writer.event(at(second), RESUMED, "power cut").unwrap();
    };
    event(&mut writer, 220 + 86_400);
    writer
        .append(&frame_at(5, 150, 230 + 86_400), None)
        .unwrap();
    assert_eq!(run(), 230);
    drop(writer);
    // a third one, which has run for 7 s: its wall clock is behind
    let (mut writer, _) = SessionWriter::resume(&second).unwrap();
    event(&mut writer, 80 + 82_800);
    writer.append(&frame_at(6, 7, 85 + 82_800), None).unwrap();
    assert_eq!(run(), 237);
    drop(writer);
    // the three frames of a deleted part count with the mean period of the others: 207 s in two periods
    std::fs::remove_file(&first).unwrap();
    let rest = logbook::time_run(&second).unwrap().as_secs_f64();
    assert_eq!(rest, 207.0 + 3.0 * 103.5);
}

#[test]
fn wall_times_are_read_backwards_without_readings() {
    let dir = tempfile::tempdir().unwrap();
    let frames = 2500;
    let mut writer = SessionWriter::create(dir.path(), &header("m1")).unwrap();
    let all: Vec<Frame> = (1..=frames).map(frame).collect();
    for frames in all.chunks(32) {
        writer
            .append_all(frames.iter().map(|frame| (frame, None)))
            .unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(at(frames as i64), "done").unwrap();
    let file = rusqlite::Connection::open(&path).unwrap();
    file.execute("UPDATE frame SET readings = NULL", [])
        .unwrap();
    drop(file);
    let session = SessionReader::open(&path).unwrap();
    assert!(session.frame(7).is_err());
    for (first, last) in [(1, u64::MAX), (3, 2400), (7, 7), (9, 8)] {
        let times: Vec<_> = session
            .wall_times_back(first, last)
            .map(|time| time.unwrap())
            .collect();
        let expected = (first..=last.min(frames)).rev();
        let expected: Vec<_> = expected.map(|number| (number, at(number as i64))).collect();
        assert!(
            times == expected,
            "{first} to {last}: {} times",
            times.len()
        );
    }
}
