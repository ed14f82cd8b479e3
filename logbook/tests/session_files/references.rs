//! Frames stored as differences from means of earlier frames, and frames written in one transaction.

use std::time::Duration;

use chrono::DateTime;
use logbook::{LogbookError, SessionHeader, SessionReader, SessionWriter};
use survey::{Amps, Baseline, Frame, Protocol, Reading, Settings, Volts};

/// Readings on steps of 0.1 uV with about 2 uV of noise; `load` moves them by millivolts.
fn frame(number: u64, load: u64) -> Frame {
    let protocol = Protocol::sheffield(26).unwrap();
    let readings = (0..protocol.len() as u64)
        .map(|k| {
            let mut noise = (number * 598 + k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            noise ^= noise >> 29;
            noise = noise.wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let spread: u64 = (0..8).map(|part| noise >> (8 * part) & 15).sum();
            let counts = 7919 * k * k % 3_000_000 + load * (k * 131 % 40_000) + spread;
            Reading::Ok(Volts(format!("{counts}e-7").parse().unwrap()))
        })
        .collect();
    Frame {
        extra: Vec::new(),
        sequence: 0,
        readings,
        monotonic: Duration::from_secs(number),
        wall: DateTime::UNIX_EPOCH + Duration::from_secs(number),
        duration: Duration::from_millis(900),
        settings: Settings {
            precautions: survey::Precautions::default(),
            protocol_hash: protocol.hash(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: 1.0,
            settle: Duration::ZERO,
            wiring: "w".into(),
        },
        compliance: Vec::new(),
        simulated: true,
    }
}

fn header(id: &str) -> SessionHeader {
    SessionHeader::new(id, DateTime::UNIX_EPOCH, Protocol::sheffield(26).unwrap())
}

fn count(path: &std::path::Path, what: &str) -> i64 {
    rusqlite::Connection::open(path)
        .unwrap()
        .query_row(&format!("SELECT {what}"), [], |row| row.get(0))
        .unwrap()
}

#[test]
fn a_steady_load_costs_nothing_once_its_mean_is_stored() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("load")).unwrap();
    let unloaded: Vec<Frame> = (0..16).map(|number| frame(number, 0)).collect();
    writer
        .baseline(&Baseline::from_frames("b", &unloaded).unwrap())
        .unwrap();
    for number in 16..80 {
        let load = u64::from(number >= 48);
        writer.append(&frame(number, load), None).unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(DateTime::UNIX_EPOCH, "done").unwrap();

    assert_eq!(count(&path, "count(*) FROM reference"), 1);
    let mean = |frames: &str| {
        count(
            &path,
            &format!(
                "CAST(avg(length(readings)) * 1000 AS INTEGER) FROM frame WHERE sequence {frames}"
            ),
        )
    };
    let (before, at_first, later) = (mean("<= 32"), mean("BETWEEN 33 AND 47"), mean("> 48"));
    assert!(at_first > before * 5 / 4, "{before} {at_first}");
    assert!(later < before * 102 / 100, "{before} {later}");

    let session = SessionReader::open(&path).unwrap();
    for (record, number) in session.frames().zip(16..) {
        let wanted = frame(number, u64::from(number >= 48));
        assert_eq!(record.unwrap().frame.readings, wanted.readings);
    }
    // Frames read out of order, among them the one that stored the reference.
    for sequence in [64, 33, 48, 1] {
        let number = sequence + 15;
        let wanted = frame(number, u64::from(number >= 48));
        assert_eq!(
            session.frame(sequence).unwrap().frame.readings,
            wanted.readings
        );
    }
}

#[test]
fn a_damaged_reference_is_named_by_the_frames_that_need_it() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("worn")).unwrap();
    for number in 1..=20 {
        writer.append(&frame(number, 1), None).unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(DateTime::UNIX_EPOCH, "done").unwrap();
    assert_eq!(count(&path, "count(*) FROM reference"), 1);
    rusqlite::Connection::open(&path)
        .unwrap()
        .execute("UPDATE reference SET against_baseline = 1", [])
        .unwrap();
    let session = SessionReader::open(&path).unwrap();
    assert!(session.frame(15).is_ok());
    let refusal = session.frame(16).unwrap_err();
    assert!(
        matches!(&refusal, LogbookError::Damaged { place, .. } if place.contains("reference 1")),
        "{refusal:?}"
    );
}

#[test]
fn frames_written_together_are_all_there_or_none() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("group")).unwrap();
    let frames: Vec<Frame> = (1..=40).map(|number| frame(number, 0)).collect();
    let together = |frames: &'static [Frame]| frames.iter().map(|frame| (frame, None));
    let frames: &'static [Frame] = Box::leak(frames.into_boxed_slice());
    assert_eq!(writer.append_all(together(&frames[..30])).unwrap(), 30);

    let mut torn = frames[30..].to_vec();
    torn[9].readings.pop();
    let refusal = writer.append_all(torn.iter().map(|frame| (frame, None)));
    assert!(matches!(refusal, Err(LogbookError::WrongLength { .. })));
    assert_eq!(writer.acknowledged(), 30);
    // The writer discards its statistics of the refused frames.
    assert_eq!(writer.append_all(together(&frames[30..])).unwrap(), 40);
    let path = writer.path().to_owned();
    drop(writer);
    let session = SessionReader::open(&path).unwrap();
    assert_eq!(session.len().unwrap(), 40);
    for (record, frame) in session.frames().zip(frames) {
        assert_eq!(record.unwrap().frame.readings, frame.readings);
    }
}
