//! Measures frames a second with a sync each, and bytes a frame: `cargo run --release -p logbook --example append_rate`.
//! 598 readings whose mean spans 4,700 : 1, noise of 2 uV rms. Name a folder to measure another disk than the temporary
//! one. The rate is that of the disk's sync; it says nothing about another disk.

use std::time::{Duration, Instant};

use chrono::DateTime;
use logbook::{MapRecord, SessionHeader, SessionReader, SessionWriter, codec};
use survey::{Amps, Baseline, Frame, Protocol, Reading, Settings, Volts};

const FRAMES: u64 = 4096;
const GROUP: usize = 64;

/// Nearly normal, without a dependency: twelve uniform numbers.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self
                .0
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let temporary = tempfile::tempdir()?;
    let dir = std::env::args_os()
        .nth(1)
        .map_or(temporary.path().to_owned(), Into::into);
    let protocol = Protocol::sheffield(26)?;
    let settings = Settings {
        precautions: survey::Precautions::default(),
        protocol_hash: protocol.hash(),
        current: Amps(1e-3),
        range: Volts(1.0),
        nplc: 1.0,
        settle: Duration::from_millis(2),
        wiring: "pairs".into(),
    };
    for (index, name) in ["steps of 0.1 uV", "nine live digits"]
        .into_iter()
        .enumerate()
    {
        let digits = |volts: f64| match index {
            0 => format!("{:.0}e-7", volts * 1e7),
            _ => format!("{volts:.8e}"),
        };
        let mut noise = Noise(1);
        let mut frame = |number: u64| -> Result<Frame, std::num::ParseFloatError> {
            let readings = (0..protocol.len())
                .map(|k| {
                    let mean = 0.309 * 4700_f64.powf(-((k * 7919 % 598) as f64) / 597.0);
                    let volts = digits(mean + 2e-6 * noise.next()).parse()?;
                    Ok(Reading::Ok(Volts(volts)))
                })
                .collect::<Result<_, _>>()?;
            Ok(Frame {
                extra: Vec::new(),
                sequence: 0,
                readings,
                monotonic: Duration::from_secs(number),
                wall: DateTime::UNIX_EPOCH + Duration::from_secs(number),
                duration: Duration::from_millis(900),
                settings: settings.clone(),
                compliance: Vec::new(),
                simulated: true,
            })
        };
        let unloaded = (0..16).map(&mut frame).collect::<Result<Vec<_>, _>>()?;
        let baseline = Baseline::from_frames("b", &unloaded)?;
        let frames = (1..=FRAMES)
            .map(&mut frame)
            .collect::<Result<Vec<_>, _>>()?;
        let map = MapRecord {
            hash: "0123456789abcdef".repeat(4),
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
                .map(|frame| codec::encode(&frame.readings, reference));
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
        // Of the frame's own noise alone: log2(sqrt(2 pi e) sd / step) a reading.
        let entropy: f64 = frames[0]
            .readings
            .iter()
            .filter_map(|reading| reading.volts())
            .map(|volts| {
                let step = match index {
                    0 => 1e-7,
                    _ => 10_f64.powi(volts.0.abs().log10().floor() as i32 - 8),
                };
                (4.1327 * 2e-6 / step).log2()
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
    }
    Ok(())
}
