//! Measures the frames per second with one sync for each frame, and the bytes per frame:
//! `cargo run --release -p tactus-logbook --example append_rate`. A frame has 598 readings with means in a range of
//! 4,700 : 1 and noise of 2 uV rms. The argument is a folder on the disk to be measured, by default the temporary
//! folder. The rate depends on the sync time of that disk.

use std::time::Instant;

use chrono::DateTime;
use logbook::{MapRecord, SessionHeader, SessionReader, SessionWriter, codec};
use noisy::{Digits, NOISE, Rig};
use survey::Baseline;

#[path = "../tests/example_frames/noisy.rs"]
mod noisy;

const FRAMES: u64 = 16_384;
const GROUP: usize = 64;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let temporary = tempfile::tempdir()?;
    let dir = std::env::args_os()
        .nth(1)
        .map_or(temporary.path().to_owned(), Into::into);
    for (index, (name, digits)) in [
        ("steps of 0.1 uV", Digits::Tenths),
        ("nine live digits", Digits::Nine),
    ]
    .into_iter()
    .enumerate()
    {
        let mut rig = Rig::new(digits, 1);
        let protocol = rig.protocol().clone();
        let unloaded: Vec<_> = (0..16).map(|number| rig.frame(number)).collect();
        let baseline = Baseline::from_frames("b", &unloaded)?;
        let frames: Vec<_> = (1..=FRAMES).map(|number| rig.frame(number)).collect();
        let map = MapRecord {
            hash: "0123456789abcdef".repeat(4),
            sum: Some(0.123),
            method: "one-step".into(),
            model_hash: None,
            build: "0.1.0".into(),
            cpu: "avx2".into(),
        };

        let header = SessionHeader::new(
            format!("append_rate_{index}"),
            DateTime::UNIX_EPOCH,
            protocol.clone(),
        );
        let mut writer = SessionWriter::create(&dir, &header)?;
        writer.baseline(&baseline)?;
        let mut took = Vec::with_capacity(frames.len());
        let began = Instant::now();
        for frame in &frames {
            let before = Instant::now();
            writer.append(frame, Some(&map))?;
            took.push(before.elapsed());
        }
        let all = began.elapsed();
        let path = writer.path().to_owned();
        writer.close(DateTime::UNIX_EPOCH, "done")?;
        took.sort();

        let together = SessionHeader::new(
            format!("append_rate_together_{index}"),
            DateTime::UNIX_EPOCH,
            protocol.clone(),
        );
        let mut writer = SessionWriter::create(&dir, &together)?;
        writer.baseline(&baseline)?;
        let began = Instant::now();
        for group in frames.chunks(GROUP) {
            writer.append_all(group.iter().map(|frame| (frame, Some(&map))))?;
        }
        let grouped = began.elapsed();
        std::fs::remove_file(writer.path())?;
        drop(writer);

        let bytes = |reference: &codec::Reference| -> usize {
            let blobs = frames
                .iter()
                .map(|frame| codec::encode(&[&frame.readings], reference));
            blobs
                .map(|blob| blob.map_or(0, |blob| blob.len()))
                .sum::<usize>()
                / frames.len()
        };
        let began = Instant::now();
        let alone = bytes(&codec::Reference::NONE);
        let packing = began.elapsed() / FRAMES as u32;
        let session = SessionReader::open(&path)?;
        let began = Instant::now();
        let same = session.frames().zip(&frames).all(|(record, frame)| {
            record.is_ok_and(|record| record.frame.readings == frame.readings)
        });
        let reading = began.elapsed() / FRAMES as u32;
        println!(
            "{name}: {:.0} frames/s with a sync each (median {:?}, 99 % {:?}, worst {:?})",
            FRAMES as f64 / all.as_secs_f64(),
            took[took.len() / 2],
            took[took.len() * 99 / 100],
            took[took.len() - 1],
        );
        println!(
            "  {:.0} frames/s with a sync for {GROUP} frames: the last {GROUP} are what a power cut may cost",
            FRAMES as f64 / grouped.as_secs_f64(),
        );
        // Entropy of the frame's noise alone: log2(sqrt(2 pi e) sd / step) for each reading.
        let entropy: f64 = frames[0]
            .readings
            .iter()
            .filter_map(|reading| reading.volts())
            .map(|volts| {
                let step = match digits {
                    Digits::Tenths => 1e-7,
                    Digits::Nine => 10_f64.powi(volts.0.abs().log10().floor() as i32 - 8),
                };
                (4.1327 * NOISE / step).log2()
            })
            .sum();
        println!("  entropy of the noise: {:.0} bytes a frame", entropy / 8.0);
        println!(
            "  readings: {} bytes a frame against the baseline, {alone} alone, {} raw; file: {} bytes a frame",
            bytes(&codec::Reference::new(&baseline.readings)),
            8 * protocol.len(),
            std::fs::metadata(&path)?.len() / FRAMES,
        );
        println!(
            "  packing {packing:?} a frame, reading {reading:?} a frame, every bit the same: {same}"
        );
        std::fs::remove_file(&path)?;
        if !same {
            return Err("a frame was read back with other bits".into());
        }
    }
    Ok(())
}
