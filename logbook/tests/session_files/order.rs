//! Frames whose damaged sequence numbers put their rows out of order.

use std::path::{Path, PathBuf};

use crate::example_frames::taken::at;
use crate::example_frames::written::written;
use logbook::{LogbookError, SessionReader, SessionWriter, repair, verify};

/// The reader fetches 64 frames at a time: the last one needs a second query by its number.
const FRAMES: u64 = 65;

fn change(path: &Path, sql: &str) {
    rusqlite::Connection::open(path)
        .unwrap()
        .execute(sql, [])
        .unwrap();
}

/// The last frame's number is negative, and its row is before all others.
fn in_front(path: &Path) {
    change(path, "UPDATE frame SET sequence = -5 WHERE sequence = 65");
}

/// A flipped bit made the number negative, and the row is still in its place: after all others.
fn behind(path: &Path) {
    // first a positive number of nine bytes, which occurs nowhere else in the file
    let sql = "UPDATE frame SET sequence = 0x4000000000000000 WHERE sequence = 65";
    change(path, sql);
    let number = [0xa0, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x00];
    let mut bytes = std::fs::read(path).unwrap();
    let places: Vec<usize> = (0..bytes.len())
        .filter(|place| bytes[*place..].starts_with(&number))
        .collect();
    let [place] = places[..] else {
        panic!("{places:?}");
    };
    bytes[place] ^= 0x40;
    std::fs::write(path, &bytes).unwrap();
}

#[test]
fn negative_number_of_the_last_frame_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let writer = written(dir.path(), "m1", 16, FRAMES);
    let path = writer.path().to_owned();
    writer.close(at(100), "done").unwrap();
    let whole = std::fs::read(&path).unwrap();
    assert!(verify(&path, |_| {}).unwrap().findings.is_empty());
    for (name, number) in [("in_front", "-5"), ("behind", "-4611686018427387904")] {
        std::fs::write(&path, &whole).unwrap();
        match name {
            "in_front" => in_front(&path),
            _ => behind(&path),
        }
        let found = verify(&path, |_| {}).unwrap();
        let text = format!(
            "1 of 65 rows of frames cannot be read in order; frame numbers out of order: {number}"
        );
        let with = |kind: &str, text: &str| {
            let mut findings = found.findings.iter();
            findings.any(|finding| finding.kind == kind && finding.text == text)
        };
        assert!(with("damaged", &text), "{name}: {:?}", found.findings);
        let last = "its last frame was 65 when it was closed, and is 64 now";
        assert!(with("missing", last), "{name}: {:?}", found.findings);
        assert_eq!(found.frames, 64, "{name}");

        // the other frames are intact
        let session = SessionReader::open(&path).unwrap();
        assert_eq!(session.len().unwrap(), 64, "{name}");
        assert_eq!(session.summary().unwrap().last, Some(at(64)), "{name}");
        let last = session.last().unwrap().unwrap();
        assert_eq!(last.frame.sequence, 64, "{name}");
        let out: PathBuf = dir.path().join(format!("{name}.tactus"));
        let repaired = repair(&path, Some(&out), at(300), |_| {}).unwrap();
        assert_eq!(repaired.frames, 64, "{name}");
        assert_eq!(repaired.lost, [text], "{name}");
    }
}

#[test]
fn nothing_is_appended_after_a_negative_frame_number() {
    let dir = tempfile::tempdir().unwrap();
    let path = written(dir.path(), "m1", 16, FRAMES).path().to_owned();
    behind(&path);
    let refused = SessionWriter::resume(&path).map(|_| ()).unwrap_err();
    assert!(
        matches!(refused, LogbookError::Damaged { .. }),
        "{refused:?}"
    );
    let (writer, resumed) = SessionWriter::after(&path, at(200), "damage").unwrap();
    assert_eq!((resumed.acknowledged, writer.acknowledged()), (64, 64));
}
