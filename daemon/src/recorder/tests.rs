use std::path::Path;
use std::sync::Mutex;
use std::sync::mpsc as sync;

use eit::{ReconstructError, Reconstructor};
use logbook::{Event, SessionHeader, SessionReader};
use survey::{Baseline, Protocol, Reading, Volts};

use super::*;
use crate::live::Facts;
use crate::mapper::Means;
use crate::model::Model;
use crate::prepare::{Prepared, prepare};

const CONFIG: &str = "[rig]\nkind = \"simulated\"\n[geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\n\
                      electrodes = 16\n[survey]\nelectrodes = 16\n[record]\ndirectory = \"state\"\n[bus]\n\
                      peer_path = \"peer\"\n";

/// What the method does with the next frame.
enum Do {
    Map,
    Panic,
    /// Not before this is heard.
    MapAfter(sync::Receiver<()>),
}

/// A method that does as it is told.
struct Told {
    method: std::sync::Arc<dyn Reconstructor>,
    told: Mutex<sync::Receiver<Do>>,
}

impl Reconstructor for Told {
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
        let told = self.told.lock().unwrap().recv().unwrap();
        match told {
            Do::Map => {}
            Do::Panic => panic!("a method that fails"),
            Do::MapAfter(heard) => heard.recv().unwrap(),
        }
        Ok(Map {
            mesh_hash: self.mesh().hash().to_owned(),
            values: vec![-frame[0].volts().unwrap().0; self.mesh().region_areas().len()],
            unit: survey::MapUnit::RelativeConductance,
            method: self.method().to_owned(),
            masked: 0,
        })
    }
}

struct Scene {
    _folder: tempfile::TempDir,
    prepared: Prepared,
    live: Arc<Live>,
    orders: mpsc::Sender<Order>,
    said: Arc<Mutex<Vec<&'static str>>>,
}

impl Scene {
    /// A recorder whose method does as told, and what it is told by.
    fn new() -> (Self, Recorder, mpsc::Receiver<Order>, sync::Sender<Do>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, CONFIG).unwrap();
        let prepared = prepare(&path).unwrap_or_else(|problems| panic!("{problems:?}"));
        let setup = &prepared.setup;
        let header = SessionHeader::new("m1", DateTime::UNIX_EPOCH, setup.protocol.clone());
        let mut writer = SessionWriter::create(&setup.record_directory, &header).unwrap();
        let baseline = Baseline::from_frames("b1", &[frame(&prepared, 0)]).unwrap();
        writer.baseline(&baseline).unwrap();
        let (tell, told) = sync::channel();
        let model = Model {
            reconstructor: Arc::new(Told {
                method: Arc::clone(&setup.model.reconstructor),
                told: Mutex::new(told),
            }),
            ..setup.model.clone()
        };
        let mesh = &setup.geometry.mesh;
        let means = Means {
            baseline,
            model,
            centroids: mesh.region_centroids(),
            areas: mesh.region_areas(),
            build: "test".to_owned(),
        };
        let (orders, queue) = mpsc::channel(QUEUE);
        let facts = Facts {
            id: "m1".to_owned(),
            kind: logbook::SessionKind::Measurement,
            simulated: true,
            baseline_id: "b1".to_owned(),
            method: "told".to_owned(),
            path: writer.path().to_owned(),
        };
        let live = Arc::new(Live::new(facts, false));
        let said = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&said);
        let recorder = Recorder {
            live: Arc::clone(&live),
            writer,
            clock: SystemClock::new(),
            checks: Checks::new(&setup.protocol),
            task: Task::maps(Mapper::start(means, orders.downgrade()).unwrap()),
            pulse: Arc::default(),
            tell: Box::new(move |_, kind, _| heard.lock().unwrap().push(kind)),
        };
        let scene = Self {
            _folder: folder,
            prepared,
            live,
            orders,
            said,
        };
        (scene, recorder, queue, tell)
    }

    fn send(&self, order: Order) {
        self.orders.try_send(order).unwrap();
    }

    fn frame(&self, number: u64) {
        self.send(Order::Frame(Box::new(frame(&self.prepared, number))));
    }

    fn close(&self) {
        self.send(Order::Close {
            at: DateTime::UNIX_EPOCH,
            reason: "done".to_owned(),
        });
    }

    /// Which frames have maps, and the words of the events.
    fn recorded(&self) -> (Vec<bool>, Vec<String>) {
        let path: &Path = &self.live.facts.path;
        let session = SessionReader::open(path).unwrap();
        let maps = session
            .frames()
            .map(|record| record.unwrap().map.is_some())
            .collect();
        let word = |event: Event| event.kind;
        (
            maps,
            session.events().unwrap().into_iter().map(word).collect(),
        )
    }
}

fn frame(prepared: &Prepared, number: u64) -> Frame {
    let setup = &prepared.setup;
    let readings = (0..setup.protocol.len() as u64).map(|k| {
        Reading::Ok(Volts(
            (1_000_000 + 7919 * k % 500_000 + number * k % 7) as f64 / 1e7,
        ))
    });
    let crate::prepare::FramesFrom::Rig(plan) = &prepared.frames else {
        panic!("it is a rig");
    };
    Frame {
        extra: Vec::new(),
        sequence: 0,
        readings: readings.collect(),
        monotonic: Duration::from_secs(number),
        wall: DateTime::UNIX_EPOCH,
        duration: Duration::ZERO,
        settings: plan.settings(),
        compliance: Vec::new(),
        simulated: true,
    }
}

#[test]
fn a_method_that_panics_costs_maps_and_no_frame() {
    crate::guard::install();
    let heard = crate::guard::listen();
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
    assert_eq!(*scene.said.lock().unwrap(), ["method-suspended"]);
    assert_eq!(scene.live.durable(), 3);
    let error = scene.live.progress().last_error;
    assert!(error.contains("a method that fails"), "{error}");
    assert!(!scene.live.has_failed() && !heard.has_changed().unwrap());
}

#[test]
fn a_map_that_is_late_comes_after_its_frame_and_the_next_frames_go_without() {
    let (scene, recorder, queue, tell) = Scene::new();
    let (go, gate) = sync::channel();
    tell.send(Do::MapAfter(gate)).unwrap();
    // so many wait that nobody waits for a map
    let many = HURRY as u64 + 2;
    for number in 1..=many {
        scene.frame(number);
    }
    let mut durable = scene.live.follow_durable();
    let recording = std::thread::spawn(move || recorder.run(queue));
    let all = durable.wait_for(|durable| *durable == many);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .build()
        .unwrap();
    runtime.block_on(all).unwrap();
    assert!(scene.live.latest_map().is_none());
    go.send(()).unwrap();
    scene.close();
    recording.join().unwrap().unwrap();
    let late = scene.live.latest_map().unwrap();
    assert_eq!(late.frame.sequence, 1);
    let (maps, events) = scene.recorded();
    assert_eq!(maps.iter().filter(|map| **map).count(), 1);
    assert!(maps[0] && maps.len() as u64 == many);
    // said of the first, the second, the fourth, the eighth
    assert!(
        events.iter().all(|kind| kind == "maps-missed") && events.len() == 4,
        "{events:?}"
    );
}
