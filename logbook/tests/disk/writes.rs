//! Bytes written to disk per frame, counted below SQLite: a frame a second for months wears a disk out.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use crate::example_frames::noisy::{Digits, Rig, at};
use crate::vfs::{self, Operation};
use logbook::{MapRecord, SessionHeader, SessionWriter};
use survey::Baseline;

const FRAMES: u64 = 2500;
/// Frames with real syncs, which take milliseconds each; enough for at least one merge of the journal.
const FEWER: u64 = 1000;
/// The smallest unit that a file system writes, bytes.
const BLOCK: usize = 4096;

/// Records `frames` frames, `group` of them per sync; calls `begun` before the first and returns its value.
fn record<T>(dir: &Path, digits: Digits, frames: u64, group: u64, begun: impl FnOnce() -> T) -> T {
    let mut rig = Rig::new(digits, 1);
    let header = SessionHeader::new("m1", at(0), rig.protocol().clone());
    let unloaded: Vec<_> = (0..16).map(|number| rig.frame(number)).collect();
    let mut writer = SessionWriter::create(dir, &header).unwrap();
    writer
        .baseline(&Baseline::from_frames("b", &unloaded).unwrap())
        .unwrap();
    let before = begun();
    let map = MapRecord {
        hash: "0123456789abcdef".repeat(4),
        sum: Some(0.123),
        method: "one-step".into(),
        model_hash: None,
        build: "0.1.0".into(),
        cpu: "avx2".into(),
    };
    for group in (1..=frames).collect::<Vec<_>>().chunks(group as usize) {
        let frames: Vec<_> = group.iter().map(|number| rig.frame(*number)).collect();
        writer
            .append_all(frames.iter().map(|frame| (frame, Some(&map))))
            .unwrap();
    }
    writer.close(at(frames as i64), "done").unwrap();
    before
}

/// Bytes that SQLite writes per frame, and bytes of the blocks changed between two syncs. Both include merges of
/// the journal and the close.
fn a_frame_writes(digits: Digits, frames: u64, group: u64) -> (f64, f64) {
    vfs::record();
    let dir = tempfile::tempdir().unwrap();
    let before = record(dir.path(), digits, frames, group, || {
        vfs::steps(dir.path()).len()
    });
    let (mut bytes, mut blocks, mut syncs) = (0, 0, 0_u64);
    let mut changed = BTreeSet::new();
    for step in vfs::steps(dir.path()).split_off(before) {
        match step.operation {
            Operation::Write {
                offset,
                bytes: written,
            } => {
                bytes += written.len();
                let last = (offset + written.len()).saturating_sub(1) / BLOCK;
                changed.extend((offset / BLOCK..=last).map(|block| (step.file.clone(), block)));
            }
            Operation::Sync => {
                syncs += 1;
                let others = changed.len();
                changed.retain(|(file, _)| *file != step.file);
                blocks += others - changed.len();
            }
            _ => {}
        }
    }
    assert!(
        syncs >= frames / group,
        "a frame is acknowledged when it is on disk"
    );
    let each = |bytes: usize| bytes as f64 / frames as f64;
    (each(bytes), each((blocks + changed.len()) * BLOCK))
}

/// Bytes that this process has written to disks, as counted by the kernel: whole dirty pages.
fn written_by_this_process() -> Option<u64> {
    let counted = std::fs::read_to_string("/proc/self/io").ok()?;
    let line = counted
        .lines()
        .find_map(|line| line.strip_prefix("write_bytes: "))?;
    line.parse().ok()
}

/// Set in the run that has a process of its own, so that the kernel does not count writes of other tests.
const ALONE: &str = "TACTUS_TEST_ALONE";

#[test]
fn the_kernel_counts_what_the_file_layer_counts() {
    if std::env::var_os(ALONE).is_none() {
        let test = "writes::the_kernel_counts_what_the_file_layer_counts";
        let alone = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", test, "--nocapture"])
            .env(ALONE, "1")
            .output()
            .unwrap();
        let printed = String::from_utf8_lossy(&alone.stdout);
        println!("{printed}{}", String::from_utf8_lossy(&alone.stderr));
        assert!(alone.status.success() && printed.contains("1 passed"));
        return;
    }
    // with SQLite's own file layer first: the recording one does not sync
    let kinds = [Digits::Tenths, Digits::Nine];
    let counted = kinds.map(|digits| {
        let dir = tempfile::tempdir().unwrap();
        let before = record(dir.path(), digits, FEWER, 1, written_by_this_process);
        let written = written_by_this_process().zip(before);
        written.map_or(0.0, |(after, before)| {
            (after - before) as f64 / FEWER as f64
        })
    });
    if counted == [0.0; 2] {
        let why = "temporary files are on no disk here, or the kernel does not count";
        return needs::lacking("DISK", why);
    }
    for (digits, counted) in kinds.into_iter().zip(counted) {
        let (_, in_blocks) = a_frame_writes(digits, FEWER, 1);
        println!(
            "{digits:?}: {counted:.0} bytes a frame by the kernel, {in_blocks:.0} in whole blocks"
        );
        assert!(
            (0.9..1.1).contains(&(counted / in_blocks)),
            "{counted:.0}, {in_blocks:.0}"
        );
    }
}

#[test]
fn a_frame_of_half_a_kilobyte_writes_less_than_7_kb() {
    let (bytes, in_blocks) = a_frame_writes(Digits::Tenths, FRAMES, 1);
    println!("{bytes:.0} bytes a frame, {in_blocks:.0} in whole blocks");
    assert!(
        bytes < 3_000.0 && in_blocks < 7_000.0,
        "{bytes:.0}, {in_blocks:.0}"
    );
}

#[test]
fn a_frame_of_nine_live_digits_writes_less_than_9_kb() {
    let (bytes, in_blocks) = a_frame_writes(Digits::Nine, FRAMES, 1);
    println!("{bytes:.0} bytes a frame, {in_blocks:.0} in whole blocks");
    assert!(
        bytes < 5_000.0 && in_blocks < 9_000.0,
        "{bytes:.0}, {in_blocks:.0}"
    );
}

/// Two frames per sync, as with `record.group_ms = 2000` and a frame a second.
#[test]
fn two_frames_of_nine_live_digits_a_sync_write_less_than_7_kb() {
    let (bytes, in_blocks) = a_frame_writes(Digits::Nine, FRAMES, 2);
    println!("{bytes:.0} bytes a frame, {in_blocks:.0} in whole blocks");
    assert!(
        bytes < 4_500.0 && in_blocks < 7_000.0,
        "{bytes:.0}, {in_blocks:.0}"
    );
}
