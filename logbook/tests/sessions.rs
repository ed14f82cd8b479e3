//! What a session file keeps, and what it refuses.

use std::path::Path;
use std::time::Duration;

use chrono::{DateTime, Utc};
use logbook::{
    About, InstrumentRecord, LogbookError, MapRecord, SessionHeader, SessionKind, SessionReader,
    SessionWriter, Storage,
};
use survey::{Amps, Baseline, Electrode, Frame, Protocol, Reading, Settings, Volts};

fn at(seconds: i64) -> DateTime<Utc> {
    DateTime::from_timestamp(1_700_000_000 + seconds, 123_456_000).unwrap()
}

fn protocol() -> Protocol {
    Protocol::sheffield(8).unwrap()
}

fn settings() -> Settings {
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
fn frame(number: u64) -> Frame {
    let readings = (0..protocol().len() as u64)
        .map(|k| match (k + number) % 37 {
            5 => Reading::Overload,
            6 => Reading::Timeout,
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

fn header(id: &str) -> SessionHeader {
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

/// As it comes back: of a SHA-256 the first 8 digits, 16 where there is no sum.
fn kept_record(number: u64) -> MapRecord {
    let mut record = map_record(number);
    if number != 5 {
        record
            .hash
            .truncate(if record.sum.is_some() { 8 } else { 16 });
    }
    assert!(record.is_of(&map_record(number).hash));
    record
}

fn map_record(number: u64) -> MapRecord {
    MapRecord {
        hash: match number {
            // Whatever else a hash may be one day, it comes back.
            5 => "'".repeat(32),
            _ => format!("{:064x}", u128::from(number) << 120),
        },
        method: if number < 3 {
            "one-step".into()
        } else {
            "rbf".into()
        },
        // Beside what is no SHA-256 none is kept.
        sum: (number != 3 && number != 5).then_some(-1.5e-30 * number as f32),
        model_hash: (number >= 3).then(|| "d".repeat(64)),
        build: "0.1.0".into(),
        cpu: "avx2 fma".into(),
    }
}

fn baseline() -> Baseline {
    Baseline::from_frames("b1", &(1..5).map(frame).collect::<Vec<_>>()).unwrap()
}

fn assert_is(record: &logbook::Record, number: u64) {
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
    // Enough for references to be weighed more than once.
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
fn a_writer_that_vanishes_leaves_every_acknowledged_frame_and_an_unclosed_session() {
    let dir = tempfile::tempdir().unwrap();
    let copy = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("cut")).unwrap();
    for number in 1..=5 {
        writer.append(&frame(number), None).unwrap();
    }
    // What lies on the disk at this moment, without any of the writer's parting acts.
    for entry in std::fs::read_dir(dir.path()).unwrap() {
        let entry = entry.unwrap();
        std::fs::copy(entry.path(), copy.path().join(entry.file_name())).unwrap();
    }
    for place in [copy.path(), dir.path()] {
        let session = SessionReader::open(place.join("cut.tactus")).unwrap();
        assert_eq!(session.closed(), None);
        assert_eq!(session.len().unwrap(), 5);
        assert_is(&session.frame(5).unwrap(), 5);
    }
    drop(writer);
    let session = SessionReader::open(dir.path().join("cut.tactus")).unwrap();
    assert_eq!((session.closed(), session.len().unwrap()), (None, 5));
}

#[test]
fn a_torn_journal_costs_at_most_the_frame_that_was_not_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    let copy = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("torn")).unwrap();
    for number in 1..=4 {
        writer.append(&frame(number), None).unwrap();
    }
    let journal = |place: &Path| place.join("torn.tactus-wal");
    let acknowledged = std::fs::metadata(journal(dir.path())).unwrap().len();
    writer.append(&frame(5), None).unwrap();
    std::fs::copy(writer.path(), copy.path().join("torn.tactus")).unwrap();
    let whole = std::fs::read(journal(dir.path())).unwrap();
    std::fs::write(journal(copy.path()), &whole[..acknowledged as usize + 300]).unwrap();
    let session = SessionReader::open(copy.path().join("torn.tactus")).unwrap();
    assert_eq!(session.len().unwrap(), 4);
    assert_is(&session.frame(4).unwrap(), 4);
}

#[test]
fn a_full_disk_is_said_and_the_frames_before_are_whole() {
    let dir = tempfile::tempdir().unwrap();
    let storage = Storage {
        page_limit: Some(960),
        ..Storage::default()
    };
    let mut writer = SessionWriter::create_with(dir.path(), &header("full"), storage).unwrap();
    let mut kept = 0;
    let refusal = loop {
        match writer.append(&frame(kept + 1), None) {
            Ok(sequence) => kept = sequence,
            Err(refusal) => break refusal,
        }
        assert!(kept < 10_000, "the limit does not hold");
    };
    assert!(refusal.is_disk(), "{refusal}");
    assert!(refusal.to_string().contains("full.tactus"), "{refusal}");
    assert!(kept > 10);
    assert_eq!(writer.acknowledged(), kept);
    drop(writer);
    let session = SessionReader::open(dir.path().join("full.tactus")).unwrap();
    assert_eq!(session.len().unwrap(), kept);
    for (record, number) in session.frames().zip(1..) {
        assert_is(&record.unwrap(), number);
    }
}

#[test]
fn a_disk_too_full_for_a_header_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let storage = Storage {
        page_limit: Some(3),
        ..Storage::default()
    };
    let refusal = SessionWriter::create_with(dir.path(), &header("none"), storage).unwrap_err();
    assert!(refusal.is_disk(), "{refusal:?}");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    SessionWriter::create(dir.path(), &header("none")).unwrap();
}

#[test]
fn a_flipped_bit_is_an_error_in_its_place_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("flip")).unwrap();
    writer.baseline(&baseline()).unwrap();
    for number in 1..=9 {
        writer.append(&frame(number), None).unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(at(10), "done").unwrap();
    let connection = rusqlite::Connection::open(&path).unwrap();
    for (column, sequence) in [("skew_us", 4), ("duration_us", 6)] {
        let change =
            format!("UPDATE frame SET {column} = {column} + 1 WHERE sequence = {sequence}");
        connection.execute(&change, []).unwrap();
    }
    let blob: Vec<u8> = connection
        .query_row("SELECT readings FROM frame WHERE sequence = 8", [], |row| {
            row.get(0)
        })
        .unwrap();
    let mut bent = blob;
    let last = bent.len() - 3;
    bent[last] ^= 1;
    connection
        .execute("UPDATE frame SET readings = ?1 WHERE sequence = 8", [bent])
        .unwrap();
    drop(connection);
    let session = SessionReader::open(&path).unwrap();
    let outcomes: Vec<bool> = session.frames().map(|record| record.is_ok()).collect();
    assert_eq!(
        outcomes,
        [true, true, true, false, true, false, true, false, true]
    );
    let refusal = session.frame(8).unwrap_err().to_string();
    assert!(
        refusal.contains("frame 8") && refusal.contains("flip.tactus"),
        "{refusal}"
    );
}

#[test]
fn a_damaged_number_of_a_frame_neither_stops_the_reader_nor_keeps_it_for_ever() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SessionWriter::create(dir.path(), &header("number")).unwrap();
    for number in 1..=5 {
        writer.append(&frame(number), None).unwrap();
    }
    let path = writer.path().to_owned();
    writer.close(at(10), "done").unwrap();
    let change = |text: &str| {
        let connection = rusqlite::Connection::open(&path).unwrap();
        connection.execute_batch(text).unwrap();
    };
    let read = || {
        let session = SessionReader::open(&path).unwrap();
        let outcomes: Vec<bool> = session
            .frames()
            .take(50)
            .map(|record| record.is_ok())
            .collect();
        (outcomes, session.len().unwrap())
    };
    change("UPDATE frame SET sequence = 9223372036854775807 WHERE sequence = 5");
    assert_eq!(
        read(),
        (vec![true, true, true, true, false], i64::MAX as u64)
    );
    assert_eq!(logbook::verify(&path, |_| {}).unwrap().frames, 4);
    // Negative ones were never written; here they are all there are.
    change("UPDATE frame SET sequence = -sequence");
    assert_eq!(read(), (Vec::new(), 0));
}

#[test]
fn strangers_and_newer_files_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(format!("{name}.tactus"));
    std::fs::write(path("text"), "dear diary, ".repeat(500)).unwrap();
    std::fs::write(path("empty"), "").unwrap();
    rusqlite::Connection::open(path("other"))
        .unwrap()
        .execute_batch("CREATE TABLE t (x)")
        .unwrap();
    for stranger in ["text", "empty", "other"] {
        let refusal = SessionReader::open(path(stranger)).unwrap_err();
        assert!(
            matches!(refusal, LogbookError::NotASession { .. }),
            "{stranger}: {refusal:?}"
        );
    }
    let writer = SessionWriter::create(dir.path(), &header("newer")).unwrap();
    writer.close(at(1), "done").unwrap();
    rusqlite::Connection::open(path("newer"))
        .unwrap()
        .pragma_update(None, "user_version", 99)
        .unwrap();
    let refusal = SessionReader::open(path("newer")).unwrap_err();
    assert!(
        matches!(refusal, LogbookError::OtherSchema { has: 99, .. }),
        "{refusal:?}"
    );
    assert!(matches!(
        SessionReader::open(path("absent")),
        Err(LogbookError::Io { .. })
    ));
    let listing = logbook::list(dir.path()).unwrap();
    assert_eq!((listing.sessions.len(), listing.unreadable.len()), (0, 4));
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
        Err(LogbookError::NotFinite { reading: 11 })
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
fn sessions_are_listed_and_found_by_the_beginning_of_their_id() {
    let dir = tempfile::tempdir().unwrap();
    assert!(
        logbook::list(dir.path().join("absent"))
            .unwrap()
            .sessions
            .is_empty()
    );
    for (second, id, kind) in [
        (5, "20250105_a", SessionKind::Measurement),
        (1, "20250101_b", SessionKind::Baseline),
        (3, "20250103_b", SessionKind::Baseline),
    ] {
        let mut header = header(id);
        header.started = at(second);
        header.kind = kind;
        let mut writer = SessionWriter::create(dir.path(), &header).unwrap();
        writer.append(&frame(1), None).unwrap();
        if id == "20250101_b" {
            writer.baseline(&baseline()).unwrap();
        }
        writer.close(at(second + 1), "done").unwrap();
    }
    let running = SessionWriter::create(dir.path(), &header("20250107_a")).unwrap();
    let listing = logbook::list(dir.path()).unwrap();
    let ids: Vec<&str> = listing
        .sessions
        .iter()
        .map(|session| session.id.as_str())
        .collect();
    assert_eq!(
        ids,
        ["20250107_a", "20250101_b", "20250103_b", "20250105_a"]
    );
    assert_eq!(
        (listing.sessions[3].frames, listing.sessions[3].last),
        (1, Some(at(1)))
    );
    assert!(listing.sessions[0].closed.is_none());
    let found = |asked: &str| logbook::find(dir.path(), asked);
    assert!(found("20250105").unwrap().ends_with("20250105_a.tactus"));
    assert!(matches!(
        found("nothing"),
        Err(LogbookError::NoSuchSession { .. })
    ));
    let refusal = found("2025010").unwrap_err();
    assert!(
        matches!(&refusal, LogbookError::Ambiguous { .. }),
        "{refusal:?}"
    );
    assert!(refusal.to_string().contains("20250103_b"), "{refusal}");
    assert_eq!(logbook::baselines(dir.path()).unwrap().len(), 2);
    // The later one was closed before it had a baseline.
    let now = at(1_000_000_000);
    let latest = |now| logbook::latest_baseline(dir.path(), now).unwrap().unwrap();
    let (summary, kept) = latest(now);
    assert_eq!((summary.id.as_str(), kept), ("20250101_b", baseline()));
    // One that was recorded while the clock was ahead is the last one only where there is no other.
    let ahead = SessionHeader {
        kind: SessionKind::Baseline,
        started: now + std::time::Duration::from_secs(30_000 * 86_400),
        ..header("20990101_b")
    };
    let mut writer = SessionWriter::create(dir.path(), &ahead).unwrap();
    writer.baseline(&baseline()).unwrap();
    writer.close(ahead.started, "done").unwrap();
    assert_eq!(latest(now).0.id, "20250101_b");
    assert_eq!(latest(ahead.started).0.id, "20990101_b");
    std::fs::remove_file(dir.path().join("20250101_b.tactus")).unwrap();
    assert_eq!(latest(now).0.id, "20990101_b");
    drop(running);
}

#[test]
fn a_reader_beside_a_writer_sees_what_was_acknowledged_and_does_not_hold_it_back() {
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

/// The locks that keep another process from taking a session for unused, and its journal away.
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
        eprintln!("skipped: /proc/locks does not tell here");
        return;
    }
    drop(SessionReader::open(writer.path()).unwrap());
    logbook::list(dir.path()).unwrap();
    assert_eq!(held(), before);
    writer.append(&frame(2), None).unwrap();
}

/// A folder with three closed sessions, and an index that knows all that does not change any more.
fn indexed() -> (tempfile::TempDir, logbook::Index) {
    let dir = tempfile::tempdir().unwrap();
    for id in ["a", "b", "c"] {
        let mut writer = SessionWriter::create(dir.path(), &header(id)).unwrap();
        writer.append(&frame(1), None).unwrap();
        writer.close(at(2), "done").unwrap();
    }
    let mut index = logbook::Index::load(dir.path());
    assert_eq!(index.unknown().unwrap(), 3);
    // what was written within the last tick of the clock may change again and look the same
    while index.unknown().unwrap() > 0 {
        index.refresh().unwrap();
    }
    index.save().unwrap();
    (dir, index)
}

#[test]
fn an_index_opens_only_what_has_changed() {
    let (dir, mut index) = indexed();
    let file = |id: &str| dir.path().join(format!("{id}.tactus"));
    let kept = |index: &logbook::Index| index.sessions().into_iter().cloned().collect::<Vec<_>>();
    assert_eq!(kept(&index).len(), 3);
    // another process finds it
    let again = logbook::Index::load(dir.path());
    assert_eq!((again.unknown().unwrap(), kept(&again)), (0, kept(&index)));

    // a session that is written is read each time
    let mut writer = SessionWriter::create(dir.path(), &header("d")).unwrap();
    for frames in 1..=3 {
        writer.append(&frame(frames), None).unwrap();
        index.refresh().unwrap();
        let open = index.sessions().into_iter().find(|open| open.id == "d");
        let open = open.unwrap();
        assert_eq!((open.frames, &open.closed), (frames, &None));
    }
    assert_eq!(index.interrupted()[0].id, "d");
    index.save().unwrap();
    writer.close(at(9), "done").unwrap();
    // one that has been replaced, one that has gone, one that was damaged, and a pipe, which is not waited for
    std::fs::copy(file("a"), file("b")).unwrap();
    std::fs::remove_file(file("a")).unwrap();
    std::fs::write(file("c"), "SQLite format 3, but no more").unwrap();
    let made = std::process::Command::new("mkfifo")
        .arg(file("pipe"))
        .status();
    assert!(made.unwrap().success());
    for index in [&mut index, &mut logbook::Index::load(dir.path())] {
        index.refresh().unwrap();
        let ids: Vec<&str> = index
            .sessions()
            .iter()
            .map(|kept| kept.id.as_str())
            .collect();
        assert_eq!(ids, ["a", "d"]);
        assert!(index.interrupted().is_empty());
        let unreadable = index.unreadable();
        assert_eq!(unreadable.len(), 2);
        assert!(unreadable[1].why.to_string().contains("it is a FIFO"));
    }
}

#[test]
fn a_damaged_index_costs_a_reading_and_nothing_else() {
    let (dir, _) = indexed();
    let whole = logbook::list(dir.path()).unwrap().sessions;
    let path = dir.path().join("sessions-1.index");
    let bytes = std::fs::read(&path).unwrap();
    let seen = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        logbook::list(dir.path()).unwrap().sessions
    };
    for place in (0..bytes.len()).step_by(7) {
        let mut damaged = bytes.clone();
        damaged[place] ^= 1 << (place % 8);
        assert_eq!(seen(&damaged), whole, "a bit of byte {place}");
    }
    for length in (0..bytes.len()).step_by(31) {
        assert_eq!(seen(&bytes[..length]), whole, "{length} bytes");
    }
    // what is kept behind a torn line is kept in a line of its own
    std::fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
    let mut index = logbook::Index::load(dir.path());
    assert_eq!(index.unknown().unwrap(), 1);
    index.refresh().unwrap();
    index.save().unwrap();
    assert_eq!(logbook::Index::load(dir.path()).unknown().unwrap(), 0);
}
