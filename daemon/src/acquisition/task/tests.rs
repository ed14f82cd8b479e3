//! Tests of heartbeats while the recorder accepts no frame, of the longest time of a frame, of missed frames, and of
//! damaged frames of a recording.

use chrono::{DateTime, Utc};
use imaging::recorded::IndexedFrames;
use logbook::SessionKind;
use survey::{Amps, Protocol};

use super::*;
use crate::acquisition::playback::Playing;
use crate::instruments::address::InstrumentAddress;
use crate::monitoring::Counters;
use crate::preparation::{FramesFrom, prepare};
use crate::recording::session_status::Facts;

const WALL: DateTime<Utc> = DateTime::UNIX_EPOCH;

/// The status of a session without frames; with `step` each frame must be granted.
fn status_of(folder: &std::path::Path, step: bool, counters: &Arc<Counters>) -> Arc<SessionStatus> {
    let facts = Facts {
        id: "m1".to_owned(),
        kind: SessionKind::Measurement,
        simulated: true,
        baseline_id: String::new(),
        method: String::new(),
        every: Duration::ZERO,
    };
    let (path, counters) = (folder.join("m1"), Arc::clone(counters));
    Arc::new(SessionStatus::new(facts, path, step, counters))
}

fn as_fast_as_possible(frames: IndexedFrames) -> Recording {
    let playing = Playing {
        frames_per_s: None,
        speed: 0.0,
    };
    Recording::new(frames, playing)
}

/// A session that plays a table of frames as fast as possible to this recorder.
fn acquisition(folder: &std::path::Path, recorder: mpsc::Sender<RecorderMessage>) -> Acquisition {
    let clock = SystemClock::new();
    Acquisition {
        status: status_of(folder, false, &Arc::new(Counters::new(clock))),
        schedule: Schedule::default(),
        speed: None,
        clock,
        recorder,
        pauses: mpsc::channel(1).0,
        transcript: RingTranscript::new(1),
        heartbeats: Arc::default(),
        progress: AcquisitionProgress::default(),
        measuring: Measuring::default(),
        injections: None,
        events: EventLog::new(folder.to_owned()),
        plan: watch::Sender::new(None),
    }
}

#[tokio::test(start_paused = true)]
async fn acquisition_that_waits_for_the_recorder_is_no_hang() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    std::fs::write(&path, "1,1,1,1\n2,2,2,2\n3,3,3,3\n").unwrap();
    let protocol = Protocol::sheffield(4).unwrap();
    let frames = IndexedFrames::table(&path, &protocol, Amps(1.0), false).unwrap();
    let mut source = FrameSource::Recording(Box::new(as_fast_as_possible(frames)));
    // the second frame waits, as at a full disk
    let (recorder, mut queue) = mpsc::channel(1);
    let mut acquisition = acquisition(folder.path(), recorder);
    let heartbeats = Arc::clone(&acquisition.heartbeats);
    let status = Arc::clone(&acquisition.status);
    let mut run = std::pin::pin!(acquisition.run(&mut source));
    let waits = tokio::time::timeout(Duration::from_secs(1), &mut run).await;
    assert!(waits.is_err());
    assert_eq!(status.acquired(), 2);
    let in_a_day = Duration::from_secs(86_400);
    assert_eq!(heartbeats.overdue(in_a_day), None);

    // the frames that wait are not lost
    let recorded = async {
        for _ in 0..3 {
            queue.recv().await.unwrap();
        }
    };
    let (ended, ()) = tokio::join!(run, recorded);
    assert!(matches!(ended, AcquisitionEnd::Done(_)));
}

#[tokio::test(start_paused = true)]
async fn an_event_that_waits_for_the_recorder_is_no_hang() {
    let folder = tempfile::tempdir().unwrap();
    let (recorder, _queue) = mpsc::channel(1);
    let event = Event::new(WALL, EventKind::Zero, "before", None);
    recorder.try_send(RecorderMessage::Event(event)).unwrap();
    let acquisition = acquisition(folder.path(), recorder);
    acquisition.set_deadline(HEARTBEAT_MARGIN);
    let note = acquisition.note(EventKind::FramesMissed, "2 frames".to_owned());
    let mut note = std::pin::pin!(note);
    let waits = tokio::time::timeout(Duration::from_secs(1), &mut note).await;
    assert!(waits.is_err());
    let in_a_day = Duration::from_secs(86_400);
    assert_eq!(acquisition.heartbeats.overdue(in_a_day), None);
}

#[tokio::test]
async fn a_damaged_frame_of_a_recording_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("frames.csv");
    std::fs::write(&table, "1,1,1,1\n2,2,2,2\n3,3,3,3\n").unwrap();
    let protocol = Protocol::sheffield(4).unwrap();
    let frames = IndexedFrames::table(&table, &protocol, Amps(1.0), false).unwrap();
    let header = logbook::SessionHeader::new("monday", WALL, protocol);
    let mut writer = logbook::SessionWriter::create(folder.path(), &header).unwrap();
    let path = writer.path().to_owned();
    for index in 0..frames.len() {
        let frame = frames.frame(index, WALL).unwrap();
        writer.append(&frame, None).unwrap();
    }
    writer.close(WALL, "end").unwrap();
    let file = rusqlite::Connection::open(&path).unwrap();
    let damage = "UPDATE frame SET checksum = checksum + 1 WHERE sequence = 2";
    file.execute(damage, []).unwrap();
    drop(file);
    let (session, _) = IndexedFrames::session(&path, false).unwrap();
    let mut source = FrameSource::Recording(Box::new(as_fast_as_possible(session)));
    let (recorder, mut queue) = mpsc::channel(8);
    let mut acquisition = acquisition(folder.path(), recorder);
    let counters = Arc::new(Counters::new(acquisition.clock));
    acquisition.status = status_of(folder.path(), false, &counters);
    let ended = acquisition.run(&mut source).await;
    assert!(
        matches!(&ended, AcquisitionEnd::Done(why) if why.contains("1 of its frames cannot be read")),
        "{ended:?}"
    );
    let status = Arc::clone(&acquisition.status);
    assert_eq!((status.acquired(), status.failures()), (2, 1));
    let gap = counters.last_gap().unwrap();
    assert!(gap.text.starts_with("frame 2 of the recording"), "{gap:?}");
    drop(acquisition);
    let mut received = Vec::new();
    while let Some(message) = queue.recv().await {
        received.push(match message {
            RecorderMessage::Frame(frame) => format!("{:?}", frame.readings[0].volts().unwrap()),
            RecorderMessage::Event(event) => event.kind.as_str().to_owned(),
            other => format!("{other:?}"),
        });
    }
    assert_eq!(received, ["Volts(1.0)", "frame-failed", "Volts(3.0)"]);
}

#[tokio::test]
async fn a_recording_that_cannot_be_read_leaves_out_no_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    std::fs::write(&path, "1,1,1,1\n2,2,2,2\n").unwrap();
    let protocol = Protocol::sheffield(4).unwrap();
    let frames = IndexedFrames::table(&path, &protocol, Amps(1.0), false).unwrap();
    let mut recording = as_fast_as_possible(frames);
    let acquisition = acquisition(folder.path(), mpsc::channel(1).0);
    let error = logbook::LogbookError::Io {
        path,
        attempt: "read a frame of",
        source: std::io::Error::other("the disk was removed"),
    };
    let left = acquisition.leave_out(&mut recording, error.into()).await;
    let Err(ended @ AcquisitionEnd::Recording(_)) = left else {
        panic!("it was left out");
    };
    assert!(ended.text().contains("the disk was removed"), "{ended:?}");
    assert_eq!(acquisition.status.failures(), 0);
    assert_eq!(recording.skip(), 1);
}

#[tokio::test]
async fn a_frame_that_nobody_granted_is_not_dropped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("config.toml");
    let config = "[geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = 16\n[record]\n\
                  directory = \"state\"\n";
    std::fs::write(&path, config).unwrap();
    let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
    let FramesFrom::Rig(plan) = &prepared.frames else {
        panic!("it is a rig");
    };
    for step in [false, true] {
        let (recorder, _queue) = mpsc::channel(8);
        let mut acquisition = acquisition(folder.path(), recorder);
        let counters = Arc::new(Counters::new(acquisition.clock));
        acquisition.status = status_of(folder.path(), step, &counters);
        acquisition.status.grant(1);
        // many frames were due since the clock began
        acquisition.schedule.every = Duration::from_nanos(1);
        acquisition.progress.began = Some(Duration::ZERO);
        let mut source = FrameSource::Rig {
            rig: None,
            plan: Arc::clone(plan),
        };
        let ended = acquisition.run(&mut source).await;
        assert!(matches!(ended, AcquisitionEnd::NoRig), "{ended:?}");
        assert_eq!(acquisition.status.dropped() == 0, step);
    }
}

#[test]
fn a_frame_may_take_as_long_as_its_timeouts() {
    let instruments = |timeout| {
        let place = (InstrumentAddress::Simulated, timeout);
        InstrumentAddresses {
            source: place.clone(),
            switch: place.clone(),
            voltmeter: place,
            enable: config::EnableName::Low,
        }
    };
    let seconds = Duration::from_secs;
    let usual = longest_frame(seconds(15), &instruments(seconds(5)));
    assert_eq!(usual, seconds(4 * 15 + 120));
    // the longest timeout that the configuration allows
    let long = longest_frame(seconds(15), &instruments(seconds(600)));
    assert_eq!(long, seconds(4 * 15 + 4 * 3 * 600));
}
