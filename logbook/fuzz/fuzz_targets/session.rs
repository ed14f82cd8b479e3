//! A session's file, closed or left by a killed writer with its journal, with damage chosen by the fuzzer: bytes
//! overwritten, pieces copied to other places, zeros, a truncated end; sometimes only the fuzzer's bytes. Reader and
//! `verify` neither panic nor loop for ever, and content that passes its checksum is what was written.

#![no_main]

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

use chrono::{DateTime, Utc};
use libfuzzer_sys::fuzz_target;
use logbook::{Event, MapRecord, SessionHeader, SessionReader, SessionWriter};
use survey::{Amps, Baseline, Electrode, Frame, Protocol, Reading, Settings, Volts};

const FRAMES: u64 = 12;

struct Written {
    folder: PathBuf,
    header: SessionHeader,
    baseline: Baseline,
    frames: Vec<Frame>,
    events: Vec<Event>,
    /// The file of a closed session.
    closed: Vec<u8>,
    /// The file of a killed writer and its journal.
    killed: [Vec<u8>; 2],
}

static WRITTEN: OnceLock<Written> = OnceLock::new();

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, bytes)) = bytes.split_first() else {
        return;
    };
    let written = WRITTEN.get_or_init(write);
    let path = written.folder.join("fuzzed.tactus");
    let journal = written.folder.join("fuzzed.tactus-wal");
    let _ = std::fs::remove_file(&journal);
    let _ = std::fs::remove_file(written.folder.join("fuzzed.tactus-shm"));
    let forged = match kind % 8 {
        0 => {
            put(&path, bytes);
            true
        }
        1..5 => {
            let (damaged, forged) = damage(&written.closed, bytes);
            put(&path, &damaged);
            forged
        }
        5 => {
            let (damaged, forged) = damage(&written.killed[0], bytes);
            put(&path, &damaged);
            put(&journal, &written.killed[1]);
            forged
        }
        _ => {
            let (damaged, forged) = damage(&written.killed[1], bytes);
            put(&path, &written.killed[0]);
            put(&journal, &damaged);
            forged
        }
    };
    read(&path, written, forged);
    let _ = logbook::verify(&path, |_| {});
});

fn read(path: &Path, written: &Written, forged: bool) {
    let Ok(session) = SessionReader::open(path) else {
        return;
    };
    let _ = session.summary();
    let _ = session.len();
    let _ = session.last();
    let _ = session.frame(3);
    let baseline = session.baseline();
    let events = session.events();
    let frames: Vec<_> = session.frames().take(10_000).collect();
    assert!(frames.len() < 10_000, "frames without an end");
    if forged {
        return;
    }
    assert_eq!(session.header(), &written.header);
    if let Ok(Some(baseline)) = baseline {
        assert_eq!(baseline, written.baseline);
    }
    for event in events.into_iter().flatten() {
        assert!(written.events.contains(&event), "{event:?}");
    }
    for record in frames.into_iter().flatten() {
        let place = record.frame.sequence as usize - 1;
        assert_eq!(Some(&record.frame), written.frames.get(place));
    }
}

/// Returns the damaged bytes, and whether the fuzzer chose so many bytes that a checksum may match by construction:
/// checksums detect damage, not forgery.
fn damage(bytes: &[u8], mut orders: &[u8]) -> (Vec<u8>, bool) {
    let mut damaged = bytes.to_vec();
    let (mut chosen, mut behind) = (0, 0);
    while let Some((&[order, low, high, length], rest)) = orders.split_first_chunk() {
        orders = rest;
        // At the given place, or after the previous order: some numbers are longer than one order.
        let at = match order % 8 {
            4 => behind,
            _ => place(bytes, low, high),
        };
        let end = (at + usize::from(length)).min(bytes.len());
        match order % 8 {
            0..5 => {
                let (new, rest) = orders.split_at(
                    (end - at)
                        .min(1 + usize::from(order) / 64)
                        .min(orders.len()),
                );
                orders = rest;
                damaged[at..at + new.len()].copy_from_slice(new);
                chosen += new.len();
                behind = at + new.len();
            }
            5 => damaged[at..end].fill(0),
            6 => {
                // A whole sector or page from another place, or a few bytes.
                let size = [usize::from(length), 512, 4096, 16_384][usize::from(order >> 3) % 4];
                let from = usize::from(order >> 5) * bytes.len() / 8 / size.max(1) * size;
                let to = if size < 512 { at } else { at / size * size };
                let size = size.min(bytes.len() - from).min(bytes.len() - to);
                let piece = bytes[from..from + size].to_vec();
                damaged[to..to + size].copy_from_slice(&piece);
            }
            _ => {
                damaged.truncate(at);
                break;
            }
        }
    }
    // A frame's checksum has 4 bytes.
    (damaged, chosen >= 4)
}

/// A place with a nonzero byte: most bytes of a small file are zeros.
fn place(bytes: &[u8], low: u8, high: u8) -> usize {
    let wanted = usize::from(u16::from_le_bytes([low, high])) * bytes.len() / 65_536;
    let later = bytes[wanted..].iter().position(|byte| *byte != 0);
    wanted + later.unwrap_or(0)
}

fn put(path: &Path, bytes: &[u8]) {
    std::fs::write(path, bytes).expect("a temporary file");
}

fn at(seconds: u64) -> DateTime<Utc> {
    DateTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000 + seconds)
}

fn write() -> Written {
    let memory = Path::new("/dev/shm");
    let base = if memory.is_dir() {
        memory.to_owned()
    } else {
        std::env::temp_dir()
    };
    let folder = tempfile::Builder::new()
        .prefix("fuzz")
        .tempdir_in(base)
        .expect("a temporary folder")
        .keep();
    let protocol = Protocol::sheffield(8).expect("8 electrodes");
    let header = SessionHeader {
        asked: "{\"every_s\":2.0}".into(),
        ..SessionHeader::new("fuzzed", at(0), protocol.clone())
    };
    let frames: Vec<Frame> = (1..=FRAMES)
        .map(|number| frame(&protocol, number))
        .collect();
    let baseline = Baseline::from_frames("unloaded", &frames[..4]).expect("frames alike");
    let mut events = Vec::new();
    let made = folder.join("made");
    std::fs::create_dir_all(&made).expect("a temporary folder");
    let mut writer = SessionWriter::create(&made, &header).expect("a session");
    writer.baseline(&baseline).expect("a baseline");
    for (frame, number) in frames.iter().zip(1..) {
        let map = MapRecord {
            hash: "0123456789abcdef".repeat(4),
            sum: Some(0.123),
            method: "one-step".into(),
            model_hash: None,
            build: "fuzzed".into(),
            cpu: String::new(),
        };
        writer
            .append(frame, (number % 3 != 0).then_some(&map))
            .expect("a frame");
        if number % 3 == 0 {
            writer.late_map(number, &map).expect("a late map");
            let event = Event {
                at: at(number),
                kind: "pressed".into(),
                text: format!("weight {number}"),
            };
            writer
                .event(event.at, &event.kind, &event.text)
                .expect("an event");
            events.push(event);
        }
    }
    let path = writer.path().to_owned();
    let get = |path: &Path| std::fs::read(path).unwrap_or_default();
    let killed = [get(&path), get(&made.join("fuzzed.tactus-wal"))];
    writer.close(at(60), "done").expect("closed");
    let closed = get(&path);
    std::fs::remove_dir_all(&made).expect("a temporary folder");

    // Without damage all content must be readable; otherwise the other checks would be meaningless.
    let written = Written {
        folder,
        header,
        baseline,
        frames,
        events,
        closed,
        killed,
    };
    let path = written.folder.join("fuzzed.tactus");
    put(&path, &written.closed);
    let session = SessionReader::open(&path).expect("the session");
    assert_eq!(session.frames().flatten().count() as u64, FRAMES);
    assert_eq!(session.events().expect("events"), written.events);
    assert_eq!(
        session.baseline().expect("a baseline").as_ref(),
        Some(&written.baseline)
    );
    read(&path, &written, false);
    written
}

/// Readings in steps of 0.1 uV with every kind of flag, and one that has more than nine digits.
fn frame(protocol: &Protocol, number: u64) -> Frame {
    let readings = (0..protocol.len() as u64).map(|k| match (k + number) % 37 {
        5 => Reading::Overload,
        7 => Reading::NotMeasured,
        8 => Reading::Ok(Volts(1.0 / (3 + k) as f64)),
        noise => Reading::Ok(Volts((7919 * k * k % 3_000_000 + noise) as f64 / 1e7)),
    });
    Frame {
        extra: Vec::new(),
        sequence: number,
        readings: readings.collect(),
        monotonic: Duration::from_millis(2000 * number),
        wall: at(2 * number),
        duration: Duration::from_micros(987_654),
        settings: Settings {
            precautions: survey::Precautions::default(),
            protocol_hash: protocol.hash(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: if number > 6 { 0.02 } else { 1.0 },
            settle: Duration::from_micros(1500),
            wiring: "pairs in slot 1".into(),
        },
        compliance: if number.is_multiple_of(3) {
            vec![Electrode(0)]
        } else {
            Vec::new()
        },
        simulated: true,
    }
}
