mod events;
mod parts;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc as sync;

use eit::{ReconstructError, Reconstructor};
use logbook::{SessionHeader, SessionReader, SessionWriter};
use rig::SystemClock;
use survey::{Baseline, Map, Protocol, Reading, Volts};

use crate::events::event::BusEvent;
use crate::events::event_log::EventLog;
use crate::preparation::{Prepared, prepare};
use crate::recording::logbook_sink::DiskPolicy;
use crate::recording::reconstruction_worker::ReconstructionContext;
use crate::recording::recorder::*;
use crate::recording::session_status::Facts;
use config::{FullName, RecordSection};
use imaging::Model;

const CONFIG: &str = "[rig]\nkind = \"simulated\"\n[geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\n\
                      electrodes = 16\n[survey]\nelectrodes = 16\n[record]\ndirectory = \"state\"\n[bus]\n\
                      peer_path = \"peer\"\n";

const AMPLE_SPACE: u64 = 100_000_000_000;
const MEGABYTE: u64 = 1_000_000;

/// The action of the method for the next frame.
enum Do {
    Map,
    Panic,
    /// Returns the map only after this is received.
    MapAfter(sync::Receiver<()>),
}

/// A method controlled by the test.
struct Reported {
    method: std::sync::Arc<dyn Reconstructor>,
    reported: Mutex<sync::Receiver<Do>>,
}

impl Reconstructor for Reported {
    fn method(&self) -> &str {
        self.method.method()
    }
    fn protocol(&self) -> &Protocol {
        self.method.protocol()
    }
    fn mesh(&self) -> &std::sync::Arc<eit::Mesh> {
        self.method.mesh()
    }
    fn reconstruct(
        &self,
        _baseline: &[Reading],
        frame: &[Reading],
    ) -> Result<Map, ReconstructError> {
        let reported = self.reported.lock().unwrap().recv().unwrap();
        match reported {
            Do::Map => {}
            Do::Panic => panic!("a method that fails"),
            Do::MapAfter(received) => received.recv().unwrap(),
        }
        Ok(Map::relative(
            self.mesh().hash(),
            vec![-frame[0].volts().unwrap().0; self.mesh().region_areas().len()],
            self.method(),
        ))
    }
}

struct Scene {
    _folder: tempfile::TempDir,
    prepared: Prepared,
    status: Arc<SessionStatus>,
    orders: mpsc::Sender<RecorderMessage>,
    reported: Mutex<mpsc::Receiver<BusEvent>>,
    /// Free bytes on the disk as the recorder sees it.
    free: Arc<AtomicU64>,
}

/// A recorder with a method controlled by the test, and the channels for both.
type Begun = (
    Scene,
    Recorder,
    mpsc::Receiver<RecorderMessage>,
    sync::Sender<Do>,
);

impl Scene {
    fn new() -> Begun {
        Self::with(RecordSection::default())
    }

    fn ring() -> Begun {
        Self::with(RecordSection {
            when_full: FullName::Ring,
            ..RecordSection::default()
        })
    }

    fn daily() -> Begun {
        Self::with(RecordSection {
            roll_daily: true,
            ..RecordSection::default()
        })
    }

    fn with(section: RecordSection) -> Begun {
        let free = Arc::new(AtomicU64::new(AMPLE_SPACE));
        let left = Arc::clone(&free);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, CONFIG).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let setup = &prepared.setup;
        let header = SessionHeader::new("m1", DateTime::UNIX_EPOCH, setup.protocol.clone());
        let mut writer = SessionWriter::create(&setup.record_directory, &header).unwrap();
        let baseline = Baseline::from_frames("b1", &[frame(&prepared, 0)]).unwrap();
        writer.baseline(&baseline).unwrap();
        let (tell, reported) = sync::channel();
        let model = Model::new(Arc::new(Reported {
            method: Arc::clone(&setup.model.reconstructor),
            reported: Mutex::new(reported),
        }));
        let mesh = &setup.geometry.mesh;
        let facts = Facts {
            id: "m1".to_owned(),
            kind: logbook::SessionKind::Measurement,
            simulated: true,
            baseline_id: "b1".to_owned(),
            method: "one-step".to_owned(),
            every: Duration::ZERO,
        };
        let counters = Arc::new(crate::monitoring::Counters::new(SystemClock::new()));
        let status = Arc::new(SessionStatus::new(
            facts,
            writer.path().to_owned(),
            false,
            counters,
        ));
        let context = ReconstructionContext {
            status: Arc::clone(&status),
            tracking: None,
            quantities: None,
            reading_noise: None,
            baseline,
            model,
            centroids: mesh.region_centroids(),
            areas: mesh.region_areas(),
        };
        let (orders, queue) = mpsc::channel(QUEUE);
        let events = EventLog::new(setup.record_directory.clone());
        let reported_events = Mutex::new(events.subscribe());
        let task = Task::maps(
            ReconstructionWorker::start(context, orders.downgrade()).unwrap(),
            setup.config.model.clone(),
        );
        let logbook = LogbookSink {
            status: Arc::clone(&status),
            writer,
            clock: SystemClock::new(),
            events,
            heartbeats: Arc::default(),
            disk: DiskPolicy::new(section, Box::new(move |_| Ok(left.load(Ordering::SeqCst)))),
            before: None,
            began: None,
            is_recording: false,
        };
        let recorder = Recorder::new(logbook, Checks::new(&setup.protocol), task, false);
        let scene = Self {
            _folder: folder,
            prepared,
            status,
            orders,
            reported: reported_events,
            free,
        };
        (scene, recorder, queue, tell)
    }

    fn send(&self, order: RecorderMessage) {
        self.orders.try_send(order).unwrap();
    }

    /// Creates a closed session, which may be deleted to free space; returns its file.
    fn closed_session(&self, id: &str) -> PathBuf {
        let setup = &self.prepared.setup;
        let header = SessionHeader::new(id, DateTime::UNIX_EPOCH, setup.protocol.clone());
        let old = SessionWriter::create(&setup.record_directory, &header).unwrap();
        let path = old.path().to_owned();
        old.close(DateTime::UNIX_EPOCH, "done").unwrap();
        path
    }

    fn frame(&self, number: u64) {
        self.send(RecorderMessage::Frame(Box::new(frame(
            &self.prepared,
            number,
        ))));
    }

    fn close(&self) {
        self.send(RecorderMessage::Close {
            at: DateTime::UNIX_EPOCH,
            reason: "done".to_owned(),
        });
    }

    /// Kinds of the events that were reported since the last call.
    fn reported(&self) -> Vec<&'static str> {
        let mut reported = self.reported.lock().unwrap();
        std::iter::from_fn(|| reported.try_recv().ok())
            .filter_map(|event| match event {
                BusEvent::Happened(event) => Some(event.kind.as_str()),
                _ => None,
            })
            .collect()
    }

    /// Which frames have maps, and the kinds of the recorded events.
    fn recorded(&self) -> (Vec<bool>, Vec<String>) {
        let session = SessionReader::open(self.status.path()).unwrap();
        let maps = session
            .frames()
            .map(|record| record.unwrap().map.is_some())
            .collect();
        let word = |event: logbook::Event| event.kind;
        (
            maps,
            session.events().unwrap().into_iter().map(word).collect(),
        )
    }
}

/// Waits for an action of another thread; the test runner limits the time.
fn until<T: 'static>(mut follow: tokio::sync::watch::Receiver<T>, is: impl FnMut(&T) -> bool) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .build()
        .unwrap();
    runtime.block_on(follow.wait_for(is)).unwrap();
}

/// A frame. From number 100 on, its wall time is on another day; its monotonic time is not.
fn frame(prepared: &Prepared, number: u64) -> Frame {
    let setup = &prepared.setup;
    let readings = (0..setup.protocol.len() as u64).map(|k| {
        Reading::Ok(Volts(
            (1_000_000 + 7919 * k % 500_000 + number * k % 7) as f64 / 1e7,
        ))
    });
    let crate::preparation::FramesFrom::Rig(plan) = &prepared.frames else {
        panic!("it is a rig");
    };
    Frame {
        extra: Vec::new(),
        sequence: 0,
        readings: readings.collect(),
        monotonic: Duration::from_secs(number),
        wall: DateTime::UNIX_EPOCH + Duration::from_secs(number + 86_400 * (number / 100)),
        duration: Duration::ZERO,
        settings: plan.settings(),
        compliance: Vec::new(),
        simulated: true,
    }
}

#[test]
fn a_method_that_panics_costs_maps_and_no_frame() {
    crate::panics::hook::install();
    let received = crate::panics::hook::listen();
    let (scene, recorder, queue, tell) = Scene::new();
    tell.send(Do::Map).unwrap();
    tell.send(Do::Panic).unwrap();
    let recording = std::thread::spawn(move || recorder.run(queue));
    for number in 1..=3 {
        scene.frame(number);
    }
    scene.close();
    recording.join().unwrap().unwrap();
    let (maps, events) = scene.recorded();
    assert_eq!(maps, [true, false, false]);
    assert_eq!(events, ["method-suspended"]);
    assert_eq!(scene.reported(), ["method-suspended"]);
    assert_eq!(scene.status.durable(), 3);
    let error = scene.status.progress().last_error;
    assert!(error.contains("a method that fails"), "{error}");
    // the panic hook is global, so panics of other tests may be recorded too
    let place = received.borrow().clone();
    assert!(
        !scene.status.has_failed() && !place.contains("recorder"),
        "{place}"
    );
}

#[test]
fn late_map_follows_its_frame_and_later_frames_have_none() {
    let (scene, recorder, queue, tell) = Scene::new();
    let (go, gate) = sync::channel();
    tell.send(Do::MapAfter(gate)).unwrap();
    // so many frames are queued that the recorder waits for maps only briefly
    let many = BUSY_QUEUE as u64 + 2;
    for number in 1..=many {
        scene.frame(number);
    }
    let recording = std::thread::spawn(move || recorder.run(queue));
    until(scene.status.follow_durable(), |durable| *durable == many);
    assert!(scene.status.latest_map().is_none());
    go.send(()).unwrap();
    scene.close();
    recording.join().unwrap().unwrap();
    let late = scene.status.latest_map().unwrap();
    assert_eq!(late.frame.sequence, 1);
    let (maps, events) = scene.recorded();
    assert_eq!(maps.iter().filter(|map| **map).count(), 1);
    assert!(maps[0] && maps.len() as u64 == many);
    // reported for the first, second, fourth and eighth frame without a map
    assert!(
        events.iter().all(|kind| kind == "maps-missed") && events.len() == 4,
        "{events:?}"
    );
}

#[test]
fn late_map_is_of_its_frame_among_frames_written_together() {
    let (scene, recorder, queue, tell) = Scene::new();
    let (go, gate) = sync::channel();
    tell.send(Do::MapAfter(gate)).unwrap();
    let many = BUSY_QUEUE as u64 + 2;
    for number in 1..=many {
        scene.frame(number);
        tell.send(Do::Map).unwrap();
    }
    // the event about the missing map of the second frame waits for this lock, and the third frame waits for the event
    let lock = rusqlite::Connection::open(scene.status.path()).unwrap();
    lock.execute_batch("BEGIN IMMEDIATE").unwrap();
    let recording = std::thread::spawn(move || recorder.run(queue));
    until(scene.status.held(), |held| *held);
    go.send(()).unwrap();
    // all frames were taken from the queue: the next message in it announces the map of the first frame
    while scene.orders.capacity() == QUEUE {
        std::thread::yield_now();
    }
    lock.execute_batch("ROLLBACK").unwrap();
    until(scene.status.follow_durable(), |durable| *durable == many);
    scene.close();
    recording.join().unwrap().unwrap();
    let (maps, _) = scene.recorded();
    let missing: Vec<usize> = (1..)
        .zip(&maps)
        .filter_map(|(number, map)| (!map).then_some(number))
        .collect();
    assert_eq!(missing, [2]);
}

#[test]
fn full_disk_is_announced_and_waited_for_without_loss() {
    let (scene, recorder, queue, tell) = Scene::new();
    for _ in 0..3 {
        tell.send(Do::Map).unwrap();
    }
    let recording = std::thread::spawn(move || recorder.run(queue));
    scene.frame(1);
    until(scene.status.follow_durable(), |durable| *durable == 1);
    scene.free.store(1000 * MEGABYTE, Ordering::SeqCst);
    scene.frame(2);
    until(scene.status.follow_durable(), |durable| *durable == 2);
    assert_eq!(scene.reported(), ["disk-low"]);
    // below the reserve: acquisition is held, the current frame waits
    scene.free.store(100 * MEGABYTE, Ordering::SeqCst);
    scene.frame(3);
    until(scene.status.held(), |held| *held);
    let error = scene.status.progress().last_error;
    assert!(error.contains("100 MB are left"), "{error}");
    assert_eq!(scene.status.durable(), 2);
    scene.free.store(AMPLE_SPACE, Ordering::SeqCst);
    until(scene.status.follow_durable(), |durable| *durable == 3);
    until(scene.status.held(), |held| !held);
    scene.close();
    recording.join().unwrap().unwrap();
    let (maps, events) = scene.recorded();
    assert_eq!(maps, [true; 3]);
    assert_eq!(events, ["disk-low", "disk-room"]);
    assert_eq!(scene.reported(), ["disk-full", "disk-room"]);
}

#[test]
fn stopping_a_session_on_a_full_disk_does_not_wait() {
    let (scene, recorder, queue, tell) = Scene::new();
    tell.send(Do::Map).unwrap();
    tell.send(Do::Map).unwrap();
    let recording = std::thread::spawn(move || recorder.run(queue));
    scene.frame(1);
    until(scene.status.follow_durable(), |durable| *durable == 1);
    scene.free.store(0, Ordering::SeqCst);
    scene.frame(2);
    until(scene.status.held(), |held| *held);
    scene.status.stop("asked to");
    // the queue ends when all senders are dropped
    let Scene { status, orders, .. } = scene;
    drop(orders);
    // the reserved space is for the end of a session: it holds the current frame and the closing row
    recording.join().unwrap().unwrap();
    assert_eq!((status.durable(), status.dropped()), (2, 0));
    assert!(status.is_closed());
}

#[test]
fn new_day_begins_a_part_and_a_set_clock_is_reported() {
    let (scene, recorder, queue, tell) = Scene::daily();
    for _ in 0..4 {
        tell.send(Do::Map).unwrap();
    }
    let first = scene.status.path();
    let recording = std::thread::spawn(move || recorder.run(queue));
    for (count, number) in [98, 99, 100, 101].into_iter().enumerate() {
        scene.frame(number);
        until(scene.status.follow_durable(), |durable| {
            *durable == count as u64 + 1
        });
    }
    scene.close();
    recording.join().unwrap().unwrap();
    let sequences = |path: &std::path::Path| -> Vec<u64> {
        let session = SessionReader::open(path).unwrap();
        assert!(session.closed().is_some());
        session
            .frames()
            .map(|record| record.unwrap().frame.sequence)
            .collect()
    };
    assert_eq!(scene.reported(), ["clock-moved"]);
    assert_eq!(sequences(&first), [1, 2]);
    assert_eq!(sequences(&scene.status.path()), [3, 4]);
}

#[test]
fn a_ring_deletes_closed_sessions_and_waits_when_none_is_left() {
    let (scene, recorder, queue, tell) = Scene::ring();
    tell.send(Do::Map).unwrap();
    let path = scene.closed_session("m0");
    scene.free.store(0, Ordering::SeqCst);
    scene.frame(1);
    let recording = std::thread::spawn(move || recorder.run(queue));
    until(scene.status.held(), |held| *held);
    assert!(!path.exists() && scene.status.path().exists());
    scene.free.store(AMPLE_SPACE, Ordering::SeqCst);
    scene.close();
    recording.join().unwrap().unwrap();
    let (maps, events) = scene.recorded();
    assert_eq!(maps, [true]);
    assert_eq!(events, ["disk-low", "session-deleted", "disk-room"]);
}

#[test]
fn a_ring_that_can_delete_nothing_waits_for_space() {
    let (scene, recorder, queue, tell) = Scene::ring();
    tell.send(Do::Map).unwrap();
    let path = scene.closed_session("m0");
    // a folder in place of the log of deletions, which can therefore not be written
    let folder = &scene.prepared.setup.record_directory;
    std::fs::create_dir(folder.join("pruned.jsonl")).unwrap();
    scene.free.store(0, Ordering::SeqCst);
    scene.frame(1);
    let recording = std::thread::spawn(move || recorder.run(queue));
    until(scene.status.held(), |held| *held);
    let error = scene.status.progress().last_error;
    assert!(
        error.contains("the oldest sessions could not be deleted"),
        "{error}"
    );
    assert!(path.exists());
    scene.free.store(AMPLE_SPACE, Ordering::SeqCst);
    scene.close();
    recording.join().unwrap().unwrap();
    let (maps, events) = scene.recorded();
    assert_eq!(maps, [true]);
    assert_eq!(events, ["disk-low", "disk-room"]);
    assert_eq!(scene.reported(), ["disk-low", "disk-full", "disk-room"]);
}

/// Records a frame on a full disk. A folder in place of a file of the session `stays` prevents its removal, so that only
/// `goes` is deleted, and acquisition waits.
fn one_of_two_is_deleted((scene, recorder, queue, tell): Begun, goes: &Path, stays: &Path) {
    tell.send(Do::Map).unwrap();
    let id = stays.file_stem().unwrap().display();
    std::fs::create_dir(stays.with_file_name(format!("{id}-failed-1.jsonl"))).unwrap();
    scene.free.store(0, Ordering::SeqCst);
    scene.frame(1);
    let recording = std::thread::spawn(move || recorder.run(queue));
    until(scene.status.held(), |held| *held);
    assert!(!goes.exists() && stays.exists());
    // the removal is tried again and again, and listed once
    let list = stays.with_file_name("pruned.jsonl");
    assert_eq!(std::fs::read_to_string(list).unwrap().lines().count(), 2);
    scene.free.store(AMPLE_SPACE, Ordering::SeqCst);
    scene.close();
    recording.join().unwrap().unwrap();
    let (_, events) = scene.recorded();
    let expected = [
        "disk-low",
        "session-deleted",
        "session-not-deleted",
        "disk-room",
    ];
    assert_eq!(events, expected);
}

#[test]
fn deletions_of_a_ring_before_a_failure_are_recorded() {
    let begun = Scene::ring();
    let [first, second] = ["m00", "m01"].map(|id| begun.0.closed_session(id));
    one_of_two_is_deleted(begun, &first, &second);
}

#[test]
fn a_ring_deletes_the_next_session_if_the_oldest_stays() {
    let begun = Scene::ring();
    let [oldest, next] = ["m00", "m01"].map(|id| {
        let path = begun.0.closed_session(id);
        // each one alone is more than is deleted at a time; no space is allocated
        let large = std::fs::File::create(path.with_file_name(format!("{id}-failed-2.jsonl")));
        large.unwrap().set_len(10_000 * MEGABYTE).unwrap();
        path
    });
    one_of_two_is_deleted(begun, &next, &oldest);
}
