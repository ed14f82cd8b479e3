//! Bytes on disk per frame, including the rest of the file.

use std::path::Path;

use crate::example_frames::noisy::{Digits, Rig, at};
use logbook::{MapRecord, SessionHeader, SessionReader, SessionWriter};
use survey::Baseline;

/// Enough frames that nearly all pages are full, as in a session of a day.
const FRAMES: u64 = 4092;
/// Frames of a session of a day, one a second: they share the fixed size of a file.
const DAY: u64 = 86_400;

fn recorded(dir: &Path, digits: Digits, frames: u64, together: usize) -> u64 {
    let mut rig = Rig::new(digits, 1);
    let header = SessionHeader {
        config_toml: "# as long as a configuration is\n".repeat(100),
        ..SessionHeader::new(
            format!("of_{frames}_{together}"),
            at(0),
            rig.protocol().clone(),
        )
    };
    let unloaded: Vec<_> = (0..16).map(|number| rig.frame(number)).collect();
    let taken: Vec<_> = (1..=frames).map(|number| rig.frame(number)).collect();
    let map = MapRecord {
        hash: "0123456789abcdef".repeat(4),
        sum: Some(0.123),
        method: "one-step".into(),
        model_hash: None,
        build: "0.1.0".into(),
        cpu: "avx2".into(),
    };
    let mut writer = SessionWriter::create(dir, &header).unwrap();
    writer
        .baseline(&Baseline::from_frames("b", &unloaded).unwrap())
        .unwrap();
    for group in taken.chunks(together) {
        let group = group.iter().map(|frame| (frame, Some(&map)));
        writer.append_all(group).unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(at(DAY as i64), "done").unwrap();
    let session = SessionReader::open(&path).unwrap();
    for (kept, frame) in session.frames().zip(&taken) {
        assert_eq!(kept.unwrap().frame, *frame, "to the last bit");
    }
    std::fs::metadata(&path).unwrap().len()
}

/// Bytes per frame, with `together` frames per sync.
fn a_frame_of_a_day_takes(digits: Digits, together: usize) -> f64 {
    let dir = tempfile::tempdir().unwrap();
    let [empty, full] = [0, FRAMES].map(|frames| recorded(dir.path(), digits, frames, together));
    let bytes = (full - empty) as f64 / FRAMES as f64 + empty as f64 / DAY as f64;
    println!("{digits:?}, {together} with one sync: {bytes:.1} bytes a frame");
    bytes
}

#[test]
fn a_frame_in_steps_of_a_tenth_of_a_microvolt_takes_600_bytes() {
    println!("entropy of the noise: 476 bytes");
    let bytes = a_frame_of_a_day_takes(Digits::Tenths, 1);
    assert!(bytes <= 600.0, "{bytes:.1}");
}

#[test]
fn a_frame_that_shares_a_sync_with_others_takes_540_bytes() {
    println!("entropy of the noise: 476 bytes");
    for together in [32, 64] {
        let bytes = a_frame_of_a_day_takes(Digits::Tenths, together);
        assert!(bytes <= 540.0, "{together}: {bytes:.1}");
    }
}

#[test]
fn a_frame_of_nine_live_digits_takes_1800_bytes() {
    println!("entropy of the noise: 1428 bytes");
    let bytes = a_frame_of_a_day_takes(Digits::Nine, 1);
    assert!(bytes <= 1800.0, "{bytes:.1}");
    let bytes = a_frame_of_a_day_takes(Digits::Nine, 32);
    assert!(bytes <= 1700.0, "{bytes:.1}");
}
