//! Verification, repair and pruning of records.

mod parts;
mod receipts;

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::example_frames::taken::{at, taken};
use logbook::{
    ExportMarker, RESUMED, Retention, SessionHeader, SessionKind, SessionReader, SessionWriter,
    prune, repair, verify,
};
use survey::{Baseline, Frame, Protocol, Reading, Volts};

/// Bytes of a page of a session's file.
const PAGE: usize = 512;

fn protocol() -> Protocol {
    Protocol::sheffield(16).unwrap()
}

/// A frame of raw voltages, of which about nine fill a page, taken at a second.
fn frame(number: u64, second: i64) -> Frame {
    let readings = (0..protocol().len() as u64)
        .map(|k| {
            let bits = (number * 512 + k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            Reading::Ok(Volts(bits as f64 / u64::MAX as f64))
        })
        .collect();
    taken(&protocol(), number, second, readings)
}

fn baseline(id: &str) -> Baseline {
    let frames: Vec<Frame> = (1..4).map(|number| frame(number, 0)).collect();
    Baseline::from_frames(id, &frames).unwrap()
}

fn begun(dir: &Path, header: &SessionHeader, seconds: impl Iterator<Item = i64>) -> SessionWriter {
    let mut writer = SessionWriter::create(dir, header).unwrap();
    writer.baseline(&baseline("b1")).unwrap();
    for (number, second) in (1..).zip(seconds) {
        writer.append(&frame(number, second), None).unwrap();
    }
    writer
}

fn header(id: &str) -> SessionHeader {
    SessionHeader::new(id, at(0), protocol())
}

fn kinds(path: &Path) -> Vec<&'static str> {
    let found = verify(path, |_| {}).unwrap();
    found.findings.iter().map(|finding| finding.kind).collect()
}

fn change(path: &Path, sql: &str) {
    rusqlite::Connection::open(path)
        .unwrap()
        .execute(sql, [])
        .unwrap();
}

#[test]
fn every_kind_of_damage_is_a_finding_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let cases = [
        (
            "UPDATE frame SET skew_us = skew_us + 1 WHERE sequence = 4",
            "damaged",
        ),
        ("DELETE FROM frame WHERE sequence = 4", "missing"),
        ("UPDATE stretch SET period_us = period_us + 1", "damaged"),
        ("UPDATE settings SET current_a = 2e-3", "baseline"),
        ("UPDATE baseline SET frames = 99", "baseline"),
        ("UPDATE event SET text = 'otherwise'", "event"),
        ("UPDATE session SET note = 'otherwise'", "header"),
    ];
    for (index, (sql, kind)) in cases.into_iter().enumerate() {
        let mut writer = begun(dir.path(), &header(&format!("m{index}")), 1..=9);
        writer.event(at(3), "note", "as it was").unwrap();
        let path = writer.path().to_owned();
        writer.close(at(10), "done").unwrap();
        assert_eq!(kinds(&path), Vec::<&str>::new());
        change(&path, sql);
        assert!(kinds(&path).contains(&kind), "{sql}: {:?}", kinds(&path));
    }
}

#[test]
fn a_gap_needs_an_event_that_explains_it() {
    let dir = tempfile::tempdir().unwrap();
    let scheduled = SessionHeader {
        asked: "{\"every_s\":2.0}".into(),
        ..header("m1")
    };
    // One slot is missing after frame 5: 4 s instead of 2 s.
    let seconds = (1..=10_i64).map(|number| 2 * number + if number > 5 { 2 } else { 0 });
    let mut writer = begun(dir.path(), &scheduled, seconds.clone());
    let path = writer.path().to_owned();
    let found = verify(&path, |_| {}).unwrap();
    assert_eq!(kinds(&path), ["gap"]);
    assert_eq!((found.gaps[0].after, found.gaps[0].seconds), (5, 4.0));
    writer
        .event(at(12), "frame-failed", "a late reply")
        .unwrap();
    let found = verify(&path, |_| {}).unwrap();
    assert!(found.findings.is_empty(), "{:?}", found.findings);
    let explained = found.gaps[0].explained.as_deref().unwrap();
    assert_eq!(explained, "frame-failed: a late reply");
    // Without a schedule, such a pause is not a gap.
    drop(begun(dir.path(), &header("m2"), seconds));
    assert_eq!(kinds(&dir.path().join("m2.tactus")), Vec::<&str>::new());
    // But more than five times the usual interval is one.
    drop(begun(dir.path(), &header("m3"), (1..=9).chain(20..30)));
    assert_eq!(kinds(&dir.path().join("m3.tactus")), ["gap"]);
}

#[test]
fn a_restart_and_a_roll_over_leave_no_gap_without_a_word() {
    let dir = tempfile::tempdir().unwrap();
    drop(begun(dir.path(), &header("m1"), 1..=9));
    let path = dir.path().join("m1.tactus");
    let (mut writer, _) = SessionWriter::resume(&path).unwrap();
    // A new process an hour later: its monotonic clock starts again.
    let later = |number: u64, second: i64| {
        let mut frame = frame(number, second);
        frame.wall = at(3600 + second);
        frame
    };
    writer.append(&later(10, 1), None).unwrap();
    let found = verify(&path, |_| {}).unwrap();
    assert_eq!((found.gaps[0].after, found.gaps[0].seconds), (9, 3592.0));
    assert_eq!(kinds(&path), ["gap"]);
    writer.event(at(3600), RESUMED, "power cut").unwrap();
    assert_eq!(kinds(&path), Vec::<&str>::new());
    writer.roll(at(3602)).unwrap();
    for number in 11..=14 {
        writer
            .append(&later(number, number as i64 - 9), None)
            .unwrap();
    }
    writer.close(at(3700), "done").unwrap();
    let found = verify(dir.path().join("m1_p2.tactus"), |_| {}).unwrap();
    assert_eq!(found.parts, ["m1", "m1_p2"]);
    assert_eq!((found.frames, found.findings.len()), (14, 0));
    std::fs::remove_file(&path).unwrap();
    assert_eq!(kinds(&dir.path().join("m1_p2.tactus")), ["chain"]);
}

/// Numbers of the leaf pages of the table of frames, counted from 0, in the order of the rows.
fn leaves(path: &Path) -> Vec<usize> {
    rusqlite::Connection::open(path)
        .unwrap()
        .prepare("SELECT pageno - 1 FROM dbstat WHERE name = 'frame' AND pagetype = 'leaf' ORDER BY path")
        .unwrap()
        .query_map([], |row| row.get::<_, u32>(0))
        .unwrap()
        .map(|page| page.unwrap() as usize)
        .collect()
}

#[test]
fn a_repair_keeps_whole_parts_and_names_what_it_cut() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = begun(dir.path(), &header("m1"), 1..=200);
    writer.event(at(7), "note", "kept").unwrap();
    let path = writer.path().to_owned();
    writer.close(at(201), "done").unwrap();
    let whole = std::fs::read(&path).unwrap();
    let leaves = leaves(&path);
    assert!(leaves.len() > 10, "{leaves:?}");
    let middle = leaves[leaves.len() / 2];
    for (name, damage) in [("zeros", 0_u8), ("ones", 0xff), ("other", 0x55)] {
        let damaged = dir.path().join("m1.tactus");
        let mut bytes = whole.clone();
        bytes[middle * PAGE..(middle + 1) * PAGE].fill(damage);
        std::fs::write(&damaged, &bytes).unwrap();
        assert!(kinds(&damaged).contains(&"damaged"), "{name}");
        let out = dir.path().join(format!("{name}.tactus"));
        let repaired = repair(&damaged, Some(&out), at(300), |_| {}).unwrap();
        assert_eq!(std::fs::read(&damaged).unwrap(), bytes, "it is not touched");
        assert_eq!(repaired.cut.len(), 1, "{name}: {repaired:?}");
        let cut = &repaired.cut[0];
        let lost = cut.last - cut.first + 1;
        assert!(
            (1..20).contains(&lost) && repaired.frames == 200 - lost,
            "{repaired:?}"
        );
        let session = SessionReader::open(&out).unwrap();
        for record in session.frames() {
            let kept = record.unwrap().frame;
            assert_eq!(kept, frame(kept.sequence, kept.sequence as i64));
            assert!(!(cut.first..=cut.last).contains(&kept.sequence));
        }
        assert_eq!(session.baseline().unwrap(), Some(baseline("b1")));
        assert_eq!(session.events().unwrap()[0].text, "kept");
        // The repaired file states what was lost, so its only finding can be the gap in time.
        let found = kinds(&out);
        assert!(
            !found.contains(&"missing") && !found.contains(&"damaged"),
            "{found:?}"
        );
    }
}

/// A closed session of this many frames: path and content of its file.
fn closed(folder: &Path, frames: i64) -> (PathBuf, Vec<u8>) {
    let writer = begun(folder, &header("m1"), 1..=frames);
    let path = writer.path().to_owned();
    writer.close(at(201), "done").unwrap();
    let bytes = std::fs::read(&path).unwrap();
    (path, bytes)
}

#[test]
fn a_file_without_its_end_is_refused_and_repaired() {
    let dir = tempfile::tempdir().unwrap();
    let (path, whole) = closed(dir.path(), 200);
    for (there, least) in [(whole.len() - PAGE, 190), (whole.len() * 2 / 3, 80)] {
        std::fs::write(&path, &whole[..there]).unwrap();
        let out = dir.path().join(format!("{least}.tactus"));
        let repaired = repair(&path, Some(&out), at(300), |_| {}).unwrap();
        assert!(
            repaired.frames >= least && repaired.baseline,
            "{repaired:?}"
        );
        let session = SessionReader::open(&out).unwrap();
        for (record, number) in session.frames().zip(1..) {
            assert_eq!(record.unwrap().frame, frame(number, number as i64));
        }
    }
    std::fs::write(&path, &whole[..2 * PAGE]).unwrap();
    let refused = repair(&path, None, at(300), |_| {})
        .err()
        .unwrap()
        .to_string();
    assert!(refused.contains("take the file from a copy"), "{refused}");
    let there = whole.len() - PAGE;
    std::fs::write(&path, &whole[..there]).unwrap();
    let refused = SessionReader::open(&path).err().unwrap().to_string();
    let words = format!("{there} of its {} bytes are there", whole.len());
    assert!(refused.contains(&words), "{refused}");
}

#[test]
fn damage_to_the_last_page_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let (path, mut bytes) = closed(dir.path(), 100);
    let last = leaves(&path).pop().unwrap() * PAGE;
    bytes[last..last + PAGE].fill(0);
    std::fs::write(&path, &bytes).unwrap();
    let repaired = repair(&path, None, at(300), |_| {}).unwrap();
    assert!(
        repaired.frames > 80 && repaired.frames < 100,
        "{repaired:?}"
    );
    assert!(
        repaired
            .lost
            .iter()
            .any(|lost| lost.contains("nothing can be read")),
        "{repaired:?}"
    );
}

/// Two baselines and two measurements, closed, of five frames each; one session an hour.
fn shelf(dir: &Path) -> Vec<PathBuf> {
    let hour = |hour: i64| 3600 * hour;
    let mut paths = Vec::new();
    for (id, kind, begins) in [
        ("b1", SessionKind::Baseline, 0),
        ("m1", SessionKind::Measurement, 1),
        ("b2", SessionKind::Baseline, 2),
        ("m2", SessionKind::Measurement, 3),
    ] {
        let header = SessionHeader {
            kind,
            started: at(hour(begins)),
            ..header(id)
        };
        let mut writer = SessionWriter::create(dir, &header).unwrap();
        // m2 was measured against b2, m1 against b1.
        let of = id.replace('m', "b");
        writer.baseline(&baseline(&of)).unwrap();
        for number in 1..=5 {
            writer
                .append(&frame(number, hour(begins) + number as i64), None)
                .unwrap();
        }
        paths.push(writer.path().to_owned());
        writer.close(at(hour(begins) + 10), "done").unwrap();
    }
    paths
}

fn ids(pruned: &logbook::Pruned) -> (Vec<&str>, Vec<&str>) {
    (
        pruned
            .removed
            .iter()
            .map(|removed| removed.id.as_str())
            .collect(),
        pruned
            .spared
            .iter()
            .map(|spared| spared.id.as_str())
            .collect(),
    )
}

#[test]
fn retention_by_age_and_size_never_takes_what_is_needed() {
    let dir = tempfile::tempdir().unwrap();
    let paths = shelf(dir.path());
    let running = SessionWriter::create(
        dir.path(),
        &SessionHeader {
            started: at(-1_000_000),
            ..header("m0")
        },
    )
    .unwrap();
    std::fs::write(dir.path().join("m1-failed-1.transcript.jsonl"), "{}").unwrap();
    let old = |hours: u64| Retention {
        older_than: Some(Duration::from_secs(3600 * hours)),
        ..Retention::default()
    };
    let now = at(3600 * 5);
    // Everything is older than an hour: the newest baseline and the open session stay.
    let would = prune(dir.path(), &old(1), now, true).unwrap();
    assert_eq!(ids(&would), (vec!["b1", "m1", "m2"], vec!["m0", "b2"]));
    // b1 and m1 are older than three hours: m1 goes too, so b1 is not needed.
    let would = prune(dir.path(), &old(3), now, true).unwrap();
    assert_eq!(ids(&would), (vec!["b1", "m1"], vec!["m0"]));
    // Only b1 is older than four hours, but m1, which stays, needs it.
    let would = prune(dir.path(), &old(4), now, true).unwrap();
    assert_eq!(ids(&would), (vec![], vec!["m0", "b1"]));
    assert!(
        paths.iter().all(|path| path.exists()),
        "a dry run removes nothing"
    );

    let all = logbook::folder_bytes(dir.path()).unwrap();
    let size = std::fs::metadata(&paths[1]).unwrap().len();
    let small = Retention {
        keep_bytes: Some(all - size),
        ..Retention::default()
    };
    let pruned = prune(dir.path(), &small, now, false).unwrap();
    assert_eq!(ids(&pruned).0, ["m1"]);
    assert_eq!(
        std::fs::read_dir(dir.path()).unwrap().count(),
        7,
        "its transcript went with it"
    );
    assert_eq!(logbook::folder_bytes(dir.path()).unwrap(), pruned.left);
    drop(running);
}

#[test]
fn a_file_named_like_a_session_and_more_is_another_one() {
    let dir = tempfile::tempdir().unwrap();
    let paths = shelf(dir.path());
    // a user's copy of a session, a companion file of the copy, and notes
    let copy = dir.path().join("m1.old.tactus");
    let beside = dir.path().join("m1.old.tactus-wal");
    let notes = dir.path().join("m1_notes.txt");
    for path in [&copy, &beside, &notes] {
        std::fs::write(path, "not a session").unwrap();
    }
    let sizes = |paths: &[&PathBuf]| -> u64 {
        let size = |path: &&PathBuf| std::fs::metadata(path).unwrap().len();
        paths.iter().map(size).sum()
    };
    let mut own: Vec<&PathBuf> = paths.iter().collect();
    own.extend([&copy, &beside]);
    assert_eq!(logbook::folder_bytes(dir.path()).unwrap(), sizes(&own));
    let old = Retention {
        older_than: Some(Duration::from_secs(60)),
        ..Retention::default()
    };
    let pruned = prune(dir.path(), &old, at(3600 * 5), false).unwrap();
    let (removed, spared) = ids(&pruned);
    assert!(removed.contains(&"m1") && spared.contains(&"m1.old"));
    assert!(copy.exists() && beside.exists() && notes.exists());
}

#[test]
fn only_what_was_exported_to_its_last_frame_goes() {
    let dir = tempfile::tempdir().unwrap();
    let paths = shelf(dir.path());
    let retention = Retention {
        exported_only: true,
        older_than: Some(Duration::from_secs(60)),
        ..Retention::default()
    };
    let now = at(3600 * 5);
    let mark = |path: &Path, last: u64| {
        let exported = ExportMarker {
            at: now,
            last,
            format: "csv".into(),
            to: "/elsewhere".into(),
        };
        logbook::mark_exported(path, &exported).unwrap();
    };
    mark(&paths[1], 5);
    mark(&paths[3], 4);
    let pruned = prune(
        dir.path(),
        &retention,
        now + std::time::Duration::from_secs(86_400),
        false,
    )
    .unwrap();
    assert_eq!(ids(&pruned).0, ["m1"], "{pruned:?}");
    assert!(!paths[1].exists() && paths[3].exists());
}

#[test]
fn a_ring_prunes_earlier_parts_of_a_running_session() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = begun(dir.path(), &header("m1"), 1..=9);
    for part in 1..=3 {
        writer.roll(at(10 * part)).unwrap();
        for number in 9 * part + 1..=9 * part + 9 {
            writer.append(&frame(number as u64, number), None).unwrap();
        }
    }
    let nothing = Retention {
        keep_bytes: Some(0),
        ..Retention::default()
    };
    let pruned = prune(dir.path(), &nothing, at(50), false).unwrap();
    assert!(pruned.removed.is_empty(), "{pruned:?}");
    let ring = Retention {
        ring: true,
        ..nothing
    };
    let pruned = prune(dir.path(), &ring, at(50), false).unwrap();
    assert_eq!(ids(&pruned), (vec!["m1", "m1_p2", "m1_p3"], vec!["m1_p4"]));
    assert_eq!(writer.append(&frame(37, 37), None).unwrap(), 37);
    let found = verify(writer.path(), |_| {}).unwrap();
    assert!(found.findings.is_empty(), "{:?}", found.findings);
}

#[test]
fn a_damaged_newest_baseline_spares_all_baselines() {
    let dir = tempfile::tempdir().unwrap();
    let paths = shelf(dir.path());
    change(&paths[2], "UPDATE baseline SET frames = 99");
    let old = Retention {
        older_than: Some(Duration::from_secs(60)),
        ..Retention::default()
    };
    let pruned = prune(dir.path(), &old, at(3600 * 5), false).unwrap();
    assert_eq!(ids(&pruned), (vec!["m1", "m2"], vec!["b1", "b2"]));
    assert!(paths[0].exists() && paths[2].exists());
}

#[test]
fn next_session_is_pruned_for_one_that_cannot_be_removed() {
    let dir = tempfile::tempdir().unwrap();
    for id in ["m1", "m2", "m3"] {
        let writer = begun(dir.path(), &header(id), 1..=9);
        writer.close(at(10), "done").unwrap();
    }
    let file = |name: &str| dir.path().join(name);
    // a folder in place of a file of the first session, which can therefore not be removed
    std::fs::create_dir(file("m1-failed-1.jsonl")).unwrap();
    let retention = Retention {
        keep_bytes: Some(logbook::folder_bytes(dir.path()).unwrap() - 1),
        ..Retention::default()
    };
    let mut removed = Vec::new();
    let pruned = logbook::prune_each(dir.path(), &retention, at(60), false, |one| {
        removed.push(one.id.clone());
    });
    let refused = pruned.unwrap_err().to_string();
    assert!(refused.contains("m1-failed-1.jsonl"), "{refused}");
    assert_eq!(removed, ["m2"]);
    assert!(file("m1.tactus").exists() && file("m3.tactus").exists());
}

#[test]
fn sessions_are_removed_before_a_note_without_space() {
    let dir = tempfile::tempdir().unwrap();
    let paths = shelf(dir.path());
    std::os::unix::fs::symlink("/dev/full", dir.path().join("pruned.jsonl")).unwrap();
    let old = Retention {
        older_than: Some(Duration::from_secs(60)),
        ..Retention::default()
    };
    let refused = prune(dir.path(), &old, at(3600 * 5), false).unwrap_err();
    assert!(refused.is_full(), "{refused}");
    assert!(!paths[0].exists(), "the oldest made space");
}
