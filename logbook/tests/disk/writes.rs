//! What a frame costs the disk in writes, counted below SQLite: a frame a second for months wears a disk out.

use std::collections::BTreeSet;

use crate::example_frames::noisy::{Digits, Rig, at};
use crate::vfs::{self, Act};
use logbook::{MapRecord, SessionHeader, SessionWriter};
use survey::Baseline;

const FRAMES: u64 = 2500;
/// What a file system writes at least.
const BLOCK: usize = 4096;

/// Bytes that SQLite hands over for a frame, and bytes of the blocks that are changed between two syncs. Each frame is
/// acknowledged by itself; folding the journal in and closing are counted.
fn a_frame_writes(digits: Digits) -> (f64, f64) {
    vfs::listen();
    let dir = tempfile::tempdir().unwrap();
    let mut rig = Rig::new(digits, 1);
    let header = SessionHeader::new("m1", at(0), rig.protocol().clone());
    let unloaded: Vec<_> = (0..16).map(|number| rig.frame(number)).collect();
    let mut writer = SessionWriter::create(dir.path(), &header).unwrap();
    writer
        .baseline(&Baseline::from_frames("b", &unloaded).unwrap())
        .unwrap();
    let before = vfs::steps(dir.path()).len();
    let map = MapRecord {
        hash: "0123456789abcdef".repeat(4),
        sum: Some(0.123),
        method: "one-step".into(),
        model_hash: None,
        build: "0.1.0".into(),
        cpu: "avx2".into(),
    };
    for number in 1..=FRAMES {
        writer.append(&rig.frame(number), Some(&map)).unwrap();
    }
    writer.close(at(FRAMES as i64), "done").unwrap();
    let (mut bytes, mut blocks, mut syncs) = (0, 0, 0);
    let mut changed = BTreeSet::new();
    for step in vfs::steps(dir.path()).split_off(before) {
        match step.act {
            Act::Write {
                offset,
                bytes: written,
            } => {
                bytes += written.len();
                let last = (offset + written.len()).saturating_sub(1) / BLOCK;
                changed.extend((offset / BLOCK..=last).map(|block| (step.file.clone(), block)));
            }
            Act::Sync => {
                syncs += 1;
                let others = changed.len();
                changed.retain(|(file, _)| *file != step.file);
                blocks += others - changed.len();
            }
            _ => {}
        }
    }
    assert!(
        syncs as u64 >= FRAMES,
        "a frame is acknowledged when it is on disk"
    );
    let each = |bytes: usize| bytes as f64 / FRAMES as f64;
    (each(bytes), each((blocks + changed.len()) * BLOCK))
}

#[test]
fn a_frame_of_half_a_kilobyte_writes_less_than_7_kb() {
    let (bytes, in_blocks) = a_frame_writes(Digits::Tenths);
    println!("{bytes:.0} bytes a frame, {in_blocks:.0} in whole blocks");
    assert!(
        bytes < 3_000.0 && in_blocks < 7_000.0,
        "{bytes:.0}, {in_blocks:.0}"
    );
}

#[test]
fn a_frame_of_nine_live_digits_writes_less_than_9_kb() {
    let (bytes, in_blocks) = a_frame_writes(Digits::Nine);
    println!("{bytes:.0} bytes a frame, {in_blocks:.0} in whole blocks");
    assert!(
        bytes < 5_000.0 && in_blocks < 9_000.0,
        "{bytes:.0}, {in_blocks:.0}"
    );
}
