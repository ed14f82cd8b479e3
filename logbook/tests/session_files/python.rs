//! The program in the reference page on session files reads every frame to the last bit. It runs in its own virtual
//! environment; with TACTUS_REQUIRE_PYTHON=1 the test fails if that cannot be created.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::example_frames::noisy::{Digits, Rig, at};
use logbook::{SessionHeader, SessionReader, SessionWriter};
use survey::{Baseline, Reading, Volts};

const PAGE: &str = include_str!("../../../docs/reference/session-files.md");
const PACKAGES: [&str; 2] = ["pcodec==1.1.0", "numpy"];

/// The program of the page.
fn program() -> &'static str {
    let (_, from) = PAGE.split_once("```python\n").expect("a Python block");
    let (program, _) = from.split_once("```").expect("the end of the block");
    program
}

/// Single and grouped frames, steps of 0.1 uV and nine varying digits, invalid and raw readings, and a lasting load, so
/// that a mean of frames becomes the reference.
fn recorded(dir: &Path) -> PathBuf {
    let mut rig = Rig::new(Digits::Nine, 1);
    let header = SessionHeader::new("kept", at(0), rig.protocol().clone());
    let unloaded: Vec<_> = (0..16).map(|number| rig.frame(number)).collect();
    let mut writer = SessionWriter::create(dir, &header).unwrap();
    let mut early = rig.frame(16);
    early.readings[7] = Reading::Ok(Volts(-1.0 / 3.0));
    writer.append(&early, None).unwrap();
    let baseline = Baseline::from_frames("b", &unloaded).unwrap();
    writer.baseline(&baseline).unwrap();
    let mut frames: Vec<_> = (17..97).map(|number| rig.frame(number)).collect();
    for (number, frame) in frames.iter_mut().enumerate() {
        for (k, reading) in frame.readings.iter_mut().enumerate() {
            let Some(Volts(volts)) = reading.volts() else {
                continue;
            };
            let loaded = if number > 20 { volts * 0.9 } else { volts };
            let sent = match number % 2 {
                0 => format!("{:.0}e-7", loaded * 1e7),
                _ => format!("{loaded:.8e}"),
            };
            *reading = Reading::Ok(Volts(sent.parse().unwrap()));
            if (k + number) % 97 == 0 {
                *reading = [Reading::Overload, Reading::NotMeasured][number % 2];
            }
            if (k + number) % 201 == 0 {
                *reading = Reading::Ok(Volts(-loaded / 3.0));
            }
        }
    }
    let (alone, together) = frames.split_at(40);
    for frame in alone {
        writer.append(frame, None).unwrap();
    }
    writer
        .append_all(together.iter().map(|frame| (frame, None)))
        .unwrap();
    let path = writer.path().to_owned();
    writer.close(at(100), "done").unwrap();
    path
}

#[test]
fn the_python_of_the_page_reads_frames_to_the_last_bit() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let Some(python) = needs::python(folder, "pcodec", &PACKAGES) else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let path = recorded(dir.path());
    let session = SessionReader::open(&path).unwrap();
    let connection = rusqlite::Connection::open(&path).unwrap();
    let references: i64 = connection
        .query_row("SELECT max(reference) FROM frame", [], |row| row.get(0))
        .unwrap();
    assert!(references > 0, "a mean of frames became a reference");
    for sequence in [1, 2, 3, 20, 41, 42, 60, 73, 74, 81] {
        let number = sequence.to_string();
        let program = ["-c", program()];
        let printed = needs::run(Command::new(&python).args(program).arg(&path).arg(&number));
        let printed = printed.unwrap();
        let read: Vec<f64> = printed.lines().map(|line| line.parse().unwrap()).collect();
        let kept = session.frame(sequence).unwrap().frame.readings;
        assert_eq!(read.len(), kept.len());
        for (k, (read, kept)) in read.iter().zip(&kept).enumerate() {
            let same = match kept.volts() {
                Some(Volts(volts)) => volts.to_bits() == read.to_bits(),
                None => read.is_nan(),
            };
            assert!(same, "frame {sequence}, reading {k}: {kept:?} {read}");
        }
    }
}
