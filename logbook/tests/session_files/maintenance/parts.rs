//! Quantities and states of a session in parts: they belong to all parts.

use std::path::Path;

use crate::example_frames::taken::{at, taken};
use logbook::{
    ArchiveReceipt, Retention, SessionHeader, SessionWriter, StateKind, append_quantities,
    archived, keep_state, kept_state, mark_archived, prune, quantity_lines, sha256_of, verify,
};
use survey::{Protocol, Reading};

/// The running session `m1` in parts with a frame each; the parts before the last one are closed.
fn in_parts(dir: &Path, parts: u64) -> SessionWriter {
    let protocol = Protocol::sheffield(8).unwrap();
    let header = SessionHeader::new("m1", at(0), protocol.clone());
    let mut writer = SessionWriter::create(dir, &header).unwrap();
    for number in 1..=parts {
        if number > 1 {
            writer.roll(at(number as i64)).unwrap();
        }
        let readings = vec![Reading::NotMeasured; protocol.len()];
        let frame = taken(&protocol, number, number as i64, readings);
        writer.append(&frame, None).unwrap();
    }
    writer
}

fn removed(pruned: &logbook::Pruned) -> Vec<&str> {
    let removed = pruned.removed.iter();
    removed.map(|removed| removed.id.as_str()).collect()
}

#[test]
fn quantities_stay_as_long_as_a_part_of_their_session() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let writer = in_parts(dir, 3);
    let states = [StateKind::Tracking, StateKind::Course];
    for kind in states {
        keep_state(dir, "m1", kind, "{}").unwrap();
    }
    append_quantities(dir, "m1", "{\"minute\":1}").unwrap();
    let ring = Retention {
        keep_bytes: Some(0),
        ring: true,
        ..Retention::default()
    };
    let before = logbook::folder_bytes(dir).unwrap();
    let pruned = prune(dir, &ring, at(60), false).unwrap();
    assert_eq!(removed(&pruned), ["m1", "m1_p2"]);
    let freed: u64 = pruned.removed.iter().map(|removed| removed.bytes).sum();
    assert_eq!(logbook::folder_bytes(dir).unwrap(), before - freed);
    assert_eq!(pruned.left, before - freed);
    // the archive identifies lines by their numbers
    append_quantities(dir, "m1", "{\"minute\":2}").unwrap();
    let lines = quantity_lines(dir, "m1").unwrap().unwrap().lines;
    let numbers: Vec<u64> = lines.iter().map(|line| line.number).collect();
    assert_eq!(numbers, [1, 2]);
    for kind in states {
        assert_eq!(kept_state(dir, "m1", kind).unwrap().as_deref(), Some("{}"));
    }
    writer.close(at(10), "done").unwrap();
    let pruned = prune(dir, &ring, at(60), false).unwrap();
    assert_eq!(removed(&pruned), ["m1_p3"]);
    let left = std::fs::read_dir(dir).unwrap();
    let left: Vec<_> = left.map(|file| file.unwrap().file_name()).collect();
    assert_eq!(left, ["pruned.jsonl"]);
}

#[test]
fn damaged_line_hides_no_other_pruned_part() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let writer = in_parts(dir, 3);
    let ring = Retention {
        keep_bytes: Some(0),
        ring: true,
        ..Retention::default()
    };
    prune(dir, &ring, at(60), false).unwrap();
    let list = dir.join("pruned.jsonl");
    let whole = std::fs::read(&list).unwrap();
    std::fs::write(&list, [b"{\"id\":\"m\xff\"}\n", &whole[..]].concat()).unwrap();
    let found = verify(writer.path(), |_| {}).unwrap();
    assert!(found.findings.is_empty(), "{:?}", found.findings);
}

#[test]
fn first_part_there_has_the_receipt_of_quantities() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    in_parts(dir, 2).close(at(10), "done").unwrap();
    append_quantities(dir, "m1", "{}").unwrap();
    let path = |part: &str| dir.join(format!("{part}.tactus"));
    let mark = |part: &str, quantity_lines: u64| {
        let (sha256, bytes) = sha256_of(std::fs::File::open(path(part)).unwrap()).unwrap();
        let receipt = ArchiveReceipt {
            at: at(20),
            sha256,
            bytes,
            stored_as: "berlin/bed3/m1".into(),
            quantity_lines,
        };
        mark_archived(path(part), &receipt).unwrap();
    };
    mark("m1", 0);
    mark("m1_p2", 0);
    assert!(archived(path("m1")).is_none() && archived(path("m1_p2")).is_some());
    mark("m1", 1);
    assert!(archived(path("m1")).is_some());
    let old = Retention {
        older_than: Some(std::time::Duration::from_secs(58)),
        archived_only: true,
        ..Retention::default()
    };
    // the first part only
    let pruned = prune(dir, &old, at(60), false).unwrap();
    assert_eq!(removed(&pruned), ["m1"]);
    assert!(archived(path("m1_p2")).is_none());
    mark("m1_p2", 1);
    let pruned = prune(dir, &old, at(90), false).unwrap();
    assert_eq!(removed(&pruned), ["m1_p2"]);
    assert!(!dir.join("m1.quantities").exists());
}
