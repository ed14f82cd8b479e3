//! What a session file stores, and what it refuses.

use std::time::Duration;

use chrono::{DateTime, Utc};
use logbook::codec::EncodeError;
use logbook::{
    About, InstrumentRecord, LogbookError, MapRecord, SessionHeader, SessionReader, SessionWriter,
};
use survey::{Amps, Baseline, Electrode, Frame, Protocol, Reading, Settings, Volts};

pub(crate) fn at(seconds: i64) -> DateTime<Utc> {
    DateTime::from_timestamp(1_700_000_000 + seconds, 123_456_000).unwrap()
}

pub(crate) fn protocol() -> Protocol {
    Protocol::sheffield(8).unwrap()
}

pub(crate) fn settings() -> Settings {
    Settings {
        precautions: survey::Precautions::default(),
        protocol_hash: protocol().hash(),
        current: Amps(0.1 + 0.2),
        range: Volts(1.0),
        nplc: 0.02,
        settle: Duration::from_micros(1500),
        wiring: "34924A pairs in slot 1".into(),
    }
}

/// Readings on steps of 0.1 uV that differ a little from frame to frame, with every kind of gap.
pub(crate) fn frame(number: u64) -> Frame {
    let readings = (0..protocol().len() as u64)
        .map(|k| match (k + number) % 37 {
            5 => Reading::Overload,
            7 => Reading::NotMeasured,
            noise => {
                let counts = 7919 * k * k % 3_000_000 + noise;
                Reading::Ok(Volts(format!("{counts}e-7").parse().unwrap()))
            }
        })
        .collect();
    Frame {
        extra: Vec::new(),
        sequence: 0,
        readings,
        monotonic: Duration::from_millis(1000 * number),
        wall: at(number as i64),
        duration: Duration::from_micros(987_654),
        settings: settings(),
        compliance: if number.is_multiple_of(3) {
            vec![Electrode(0), Electrode(7)]
        } else {
            Vec::new()
        },
        simulated: true,
    }
}

pub(crate) fn header(id: &str) -> SessionHeader {
    SessionHeader {
        instruments: vec![InstrumentRecord {
            role: "source".into(),
            identity: "KEITHLEY INSTRUMENTS INC.,MODEL 6221,1234567,A01".into(),
            address: "simulated".into(),
        }],
        modules: vec!["slot 1: 34924A".into()],
        config_toml: "[rig]\nkind = \"simulated\"\n".into(),
        config_hash: "c".repeat(64),
        model_hash: Some("d".repeat(64)),
        geometry_hash: Some("e".repeat(64)),
        build: "0.1.0 (abcdef)".into(),
        seed: Some(u64::MAX),
        simulated: true,
        note: "a note with 'quotes'".into(),
        about: About {
            sheet: "no 7".into(),
            ink: "batch 12".into(),
            ..About::default()
        },
        asked: "{\"every\":2.0}".into(),
        ..SessionHeader::new(id, at(0), protocol())
    }
}

/// The record as read back: only the first 8 digits of a SHA-256 are stored, 16 if there is no sum.
pub(crate) fn kept_record(number: u64) -> MapRecord {
    let mut record = map_record(number);
    if number != 5 {
        record
            .hash
            .truncate(if record.sum.is_some() { 8 } else { 16 });
    }
    assert!(record.is_of(&map_record(number).hash));
    record
}

pub(crate) fn map_record(number: u64) -> MapRecord {
    MapRecord {
        hash: match number {
            // A hash in another format is stored unchanged.
            5 => "'".repeat(32),
            _ => format!("{:064x}", u128::from(number) << 120),
        },
        method: if number < 3 {
            "one-step".into()
        } else {
            "rbf".into()
        },
        // With a hash in another format no sum is stored.
        sum: (number != 3 && number != 5).then_some(-1.5e-30 * number as f32),
        model_hash: (number >= 3).then(|| "d".repeat(64)),
        build: "0.1.0".into(),
        cpu: "avx2 fma".into(),
    }
}

pub(crate) fn baseline() -> Baseline {
    Baseline::from_frames("b1", &(1..5).map(frame).collect::<Vec<_>>()).unwrap()
}

pub(crate) fn assert_is(record: &logbook::FrameRecord, number: u64) {
    let mut expected = frame(number);
    expected.sequence = number;
    assert_eq!(record.frame, expected);
    assert_eq!(
        record.quality,
        survey::Checks::new(&protocol()).of(&expected)
    );
}

#[test]
fn everything_comes_back_as_it_was_written() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("s1")).unwrap();
    writer.baseline(&baseline()).unwrap();
    writer.event(at(1), "started", "began by hand").unwrap();
    for number in 1..=6 {
        let map = map_record(number);
        let map = (number != 2).then_some(&map);
        assert_eq!(writer.append(&frame(number), map).unwrap(), number);
    }
    writer.event(at(7), "compliance", "at electrode 8").unwrap();
    writer.close(at(8), "asked to stop").unwrap();

    let companions: Vec<_> = std::fs::read_dir(dir.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert_eq!(companions, ["s1.tactus"], "a closed session is one file");

    let session = SessionReader::open(dir.path().join("s1.tactus")).unwrap();
    assert_eq!(*session.header(), header("s1"));
    assert_eq!(session.baseline().unwrap(), Some(baseline()));
    assert_eq!(session.len().unwrap(), 6);
    for (record, number) in session.frames().zip(1..) {
        let record = record.unwrap();
        assert_is(&record, number);
        assert_eq!(record.map, (number != 2).then(|| kept_record(number)));
    }
    assert_is(&session.frame(4).unwrap(), 4);
    assert_is(&session.last().unwrap().unwrap(), 6);
    assert_eq!(session.frames_from(5).count(), 2);
    assert_eq!(session.frames_between(2, 4).count(), 3);
    let events = session.events().unwrap();
    assert_eq!(events.len(), 2);
    assert_eq!(
        (events[1].at, events[1].text.as_str()),
        (at(7), "at electrode 8")
    );
    let closed = session.closed().unwrap();
    assert_eq!(
        (closed.at, closed.reason.as_str()),
        (at(8), "asked to stop")
    );
    assert!(matches!(
        session.frame(7),
        Err(LogbookError::NoSuchFrame {
            sequence: 7,
            frames: 6,
            first: 1,
            ..
        })
    ));
    assert!(matches!(
        session.frame(0),
        Err(LogbookError::NoSuchFrame { .. })
    ));
}

#[test]
fn a_map_made_after_its_frame_is_found_with_it() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("s1")).unwrap();
    writer.append(&frame(1), None).unwrap();
    writer.append(&frame(2), Some(&map_record(1))).unwrap();
    writer.late_map(1, &map_record(3)).unwrap();
    for sequence in [0, 3] {
        let refusal = writer.late_map(sequence, &map_record(3)).unwrap_err();
        assert!(
            matches!(refusal, LogbookError::NoSuchFrame { .. }),
            "{refusal:?}"
        );
    }
    writer.late_map(1, &map_record(4)).unwrap_err();
    writer.close(at(8), "done").unwrap();
    let session = SessionReader::open(dir.path().join("s1.tactus")).unwrap();
    let maps: Vec<_> = session.frames().map(|record| record.unwrap().map).collect();
    assert_eq!(maps, [Some(kept_record(3)), Some(kept_record(1))]);
}

#[test]
fn any_bits_survive_whatever_a_frame_is_a_difference_to() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("bits")).unwrap();
    let odd = |number: u64| {
        let mut odd = frame(number);
        odd.compliance.clear();
        for (k, reading) in odd.readings.iter_mut().enumerate() {
            let value = f64::from_bits((k as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ number);
            if value.is_finite() && k % 3 == 0 {
                *reading = Reading::Ok(Volts(value));
            }
        }
        odd
    };
    // Enough that the writer considers a new reference more than once.
    for number in 1..=600 {
        writer.append(&odd(number), None).unwrap();
    }
    drop(writer);
    let session = SessionReader::open(dir.path().join("bits.tactus")).unwrap();
    let bits = |frame: &Frame| -> Vec<Option<u64>> {
        frame
            .readings
            .iter()
            .map(|r| r.volts().map(|v| v.0.to_bits()))
            .collect()
    };
    for (record, number) in session.frames().zip(1..) {
        assert_eq!(
            bits(&record.unwrap().frame),
            bits(&odd(number)),
            "frame {number}"
        );
    }
    for number in [1, 256, 257, 258, 599] {
        assert_eq!(
            bits(&session.frame(number).unwrap().frame),
            bits(&odd(number))
        );
    }
}

#[test]
fn nonsense_is_refused_before_it_is_written() {
    let dir = tempfile::tempdir().unwrap();
    for id in ["", "../up", "A", "a b", &"x".repeat(101)] {
        let refusal = SessionWriter::create(dir.path(), &header(id)).unwrap_err();
        assert!(matches!(refusal, LogbookError::BadId { .. }), "{refusal:?}");
    }
    let mut writer = SessionWriter::create(dir.path(), &header("once")).unwrap();
    assert!(matches!(
        SessionWriter::create(dir.path(), &header("once")),
        Err(LogbookError::Exists { .. })
    ));
    let mut short = frame(1);
    short.readings.pop();
    assert!(matches!(
        writer.append(&short, None),
        Err(LogbookError::WrongLength { has: 39, wants: 40 })
    ));
    let mut infinite = frame(1);
    infinite.readings[11] = Reading::Ok(Volts(f64::INFINITY));
    assert!(matches!(
        writer.append(&infinite, None),
        Err(LogbookError::Readings(EncodeError::NotFinite(11)))
    ));
    let mut early = frame(1);
    early.wall = DateTime::<Utc>::MIN_UTC;
    assert!(matches!(
        writer.append(&early, None),
        Err(LogbookError::TimeOutOfRange { .. })
    ));
    assert_eq!(writer.append(&frame(1), None).unwrap(), 1);
}

#[test]
fn a_reader_beside_a_writer_reads_what_was_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("live")).unwrap();
    writer.append(&frame(1), None).unwrap();
    let session = SessionReader::open(writer.path()).unwrap();
    let mut frames = session.frames();
    assert_is(&frames.next().unwrap().unwrap(), 1);
    writer.append(&frame(2), None).unwrap();
    assert_is(&frames.next().unwrap().unwrap(), 2);
    assert!(frames.next().is_none());
    writer.append(&frame(3), None).unwrap();
    assert_eq!(session.len().unwrap(), 3);
    writer.close(at(4), "done").unwrap();
    assert_is(&session.frame(3).unwrap(), 3);
    let again = SessionReader::open(dir.path().join("live.tactus")).unwrap();
    assert!(again.closed().is_some());
}

/// Without these locks another process would consider the session unused and remove its journal.
#[test]
fn a_reader_in_the_same_process_leaves_the_writer_its_locks() {
    use std::os::unix::fs::MetadataExt;
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("s1")).unwrap();
    writer.append(&frame(1), None).unwrap();
    let inode = format!(":{} ", std::fs::metadata(writer.path()).unwrap().ino());
    let held = || {
        let locks = std::fs::read_to_string("/proc/locks").unwrap_or_default();
        locks.lines().filter(|lock| lock.contains(&inode)).count()
    };
    let before = held();
    if before == 0 {
        return needs::lacking("LOCKS", "/proc/locks shows no lock of this process");
    }
    drop(SessionReader::open(writer.path()).unwrap());
    logbook::list(dir.path()).unwrap();
    assert_eq!(held(), before);
    writer.append(&frame(2), None).unwrap();
}
