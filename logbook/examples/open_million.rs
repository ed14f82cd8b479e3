//! Measures how long it takes to open a session of a million frames again:
//! `cargo run --release -p tactus-logbook --example open_million -- [FRAMES] [FOLDER]`. The default folder is a
//! temporary one; another folder selects another disk.

use std::time::Instant;

use logbook::{SessionHeader, SessionReader, SessionWriter};
use noisy::{Digits, Rig, at};
use survey::Baseline;

// This example uses only a part of the module.
#[allow(dead_code)]
#[path = "../tests/example_frames/noisy.rs"]
mod noisy;

/// Number of distinct frames. The record repeats them, because packing a repeated frame takes the same time.
const MADE: u64 = 4096;
const GROUP: usize = 512;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let frames: u64 = words.next().map_or(Ok(1_000_000), |word| word.parse())?;
    let temporary = tempfile::tempdir()?;
    let dir = words.next().map_or(temporary.path().to_owned(), Into::into);
    let mut rig = Rig::new(Digits::Tenths, 1);
    let unloaded: Vec<_> = (0..16).map(|number| rig.frame(number)).collect();
    let made: Vec<_> = (1..=MADE).map(|number| rig.frame(number)).collect();
    let header = SessionHeader::new("of_a_million", at(0), rig.protocol().clone());
    let mut writer = SessionWriter::create(&dir, &header)?;
    writer.baseline(&Baseline::from_frames("b", &unloaded)?)?;
    let began = Instant::now();
    while writer.acknowledged() < frames {
        for group in made.chunks(GROUP) {
            writer.append_all(group.iter().map(|frame| (frame, None)))?;
        }
    }
    let (path, last) = (writer.path().to_owned(), writer.acknowledged());
    println!(
        "{last} frames, {} bytes, written in {:.0} s with a sync for {GROUP}",
        writer.bytes(),
        began.elapsed().as_secs_f64()
    );
    // Imitates a killed process: the journal is not merged into the file.
    std::mem::forget(writer);
    let journal = path.with_extension("tactus-wal");
    println!(
        "journal left behind: {} bytes",
        std::fs::metadata(&journal).map_or(0, |found| found.len())
    );
    for _ in 0..3 {
        let began = Instant::now();
        let session = SessionReader::open(&path)?;
        let found = session.last_sequence()?;
        println!("open and last sequence {found}: {:?}", began.elapsed());
        drop(session);
        let began = Instant::now();
        let (writer, resumed) = SessionWriter::resume(&path)?;
        println!(
            "resume behind {}: {:?}",
            resumed.acknowledged,
            began.elapsed()
        );
        assert_eq!((found, resumed.acknowledged), (last, last));
        std::mem::forget(writer);
    }
    let began = Instant::now();
    let verified = logbook::verify(&path, |_| {})?;
    println!(
        "verify: {:.1} s, {} frames, {} findings",
        began.elapsed().as_secs_f64(),
        verified.frames,
        verified.findings.len()
    );
    assert!(verified.findings.is_empty(), "{:?}", verified.findings);
    std::fs::remove_file(&path)?;
    Ok(())
}
