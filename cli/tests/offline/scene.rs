//! A simulated tank, sessions recorded on it, and functions that run the program.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use std::time::Duration;

use chrono::{DateTime, Utc};
use eit::{
    DiscTank, Forward, Hyper, HyperRule, Mesh, OneStep, OneStepOptions, Prior, Reconstructor,
};
use logbook::{MapRecord, SessionHeader, SessionKind, SessionWriter};
use serde_json::Value;
use survey::{Amps, Baseline, Electrode, Frame, Map, Protocol, Reading, Settings, Volts};

const CURRENT: f64 = 1e-3;
/// Position of the simulated load, mm from the tank's centre.
pub const PRESSED: [f64; 2] = [60.0, 35.0];

pub fn tactus(folder: &Path, words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tactus"))
        .args(words)
        .current_dir(folder)
        .env_remove("TACTUS_BUS")
        .env("TACTUS_STATE", folder)
        .output()
        .expect("the program was built beside this test")
}

pub fn done(folder: &Path, words: &[&str]) -> String {
    let output = tactus(folder, words);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{words:?}: {message}");
    String::from_utf8(output.stdout).expect("text")
}

pub fn refused(folder: &Path, words: &[&str], code: i32) -> String {
    let output = tactus(folder, words);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{words:?}: {message}");
    message
}

pub fn lines(text: &str) -> Vec<Value> {
    text.lines()
        .map(|line| serde_json::from_str(line).expect("one object a line"))
        .collect()
}

fn at(second: i64) -> DateTime<Utc> {
    DateTime::from_timestamp(1_800_000_000 + second, 0).expect("a time in range")
}

/// Voltages of a tank on a finer mesh than that of the reconstruction, with or without the load.
fn voltages(
    tank: &Arc<Mesh>,
    forward: &Forward,
    protocol: &Protocol,
    pressed: bool,
) -> Vec<Reading> {
    let sigma: Vec<f64> = (0..tank.triangles().len())
        .map(|triangle| {
            let [x, y] = tank.centroid(triangle);
            let near = (x * 1e3 - PRESSED[0]).hypot(y * 1e3 - PRESSED[1]) < 15.0;
            if pressed && near { 0.5e-3 } else { 1e-3 }
        })
        .collect();
    forward
        .readings(&sigma, protocol)
        .expect("a sound tank")
        .iter()
        .map(|ohms| Reading::Ok(Volts(ohms * CURRENT)))
        .collect()
}

/// A measurement of three frames, the second with an overload, on a simulated tank; recorded without a daemon.
pub fn session(folder: &Path) -> PathBuf {
    record(
        folder,
        SessionHeader::new("m20270115_1", at(0), protocol()),
        None,
        |_, record, _| record,
        Course::default(),
    )
}

/// [`session`] with frames at 1, 2 1/3 and 3 2/3 s.
pub fn session_at_thirds_of_a_second(folder: &Path) {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        thirds: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session`] with the id `bare` and without a baseline.
pub fn session_without_baseline(folder: &Path) {
    let header = SessionHeader::new("bare", at(0), protocol());
    let course = Course {
        bare: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session`] without a reading in any frame.
pub fn session_without_readings(folder: &Path) {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        unread: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session`] without a load in any frame, and without a reading in the last one if `unread_end`.
pub fn session_without_load(folder: &Path, unread_end: bool) {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        unpressed: true,
        unread_end,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session`] with alarms that become active half a second after the second and the third frame.
pub fn session_with_alarms(folder: &Path) -> PathBuf {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        alarms: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course)
}

/// [`session`] with an alarm that cannot be judged from its second frame on.
pub fn session_with_alarm_not_judged(folder: &Path) {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        not_judged: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session`] with two more frames, the last one ten minutes after the fourth.
pub fn session_paused(folder: &Path) -> PathBuf {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        paused: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course)
}

/// A baseline session without frames.
pub fn baseline_session(folder: &Path) {
    let header = SessionHeader {
        kind: SessionKind::Baseline,
        ..SessionHeader::new("b20270115_1", at(-60), protocol())
    };
    let writer = SessionWriter::create(folder, &header).expect("a folder to write in");
    writer.close(at(-50), "count reached").expect("closed");
}

/// [`session`] with a new part after each frame: `m1`, `m1_p2`, `m1_p3`, `m1_p4`.
pub fn session_in_parts(folder: &Path) {
    let header = SessionHeader::new("m1", at(0), protocol());
    let course = Course {
        rolled: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session_in_parts`] with the alarms of [`session_with_alarms`].
pub fn session_in_parts_with_alarms(folder: &Path) {
    let header = SessionHeader::new("m1", at(0), protocol());
    let course = Course {
        rolled: true,
        alarms: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session`] of whose frames the last ones are damaged, `frames` of them.
pub fn session_with_damaged_end(folder: &Path, frames: i64) {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        compliance_end: frames,
        ..Course::default()
    };
    let path = record(folder, header, None, |_, record, _| record, course);
    let remark = b"\"compliance\":[5]";
    let mut bytes = std::fs::read(&path).expect("it was written");
    let places: Vec<usize> = bytes
        .windows(remark.len())
        .enumerate()
        .filter_map(|(place, found)| (found == remark).then_some(place))
        .collect();
    assert!(!places.is_empty(), "the last frames have the remark");
    for place in places {
        bytes[place + 1] ^= 0x01;
    }
    std::fs::write(&path, bytes).expect("it can be written");
}

/// [`session`] without a reading in the last frame.
pub fn session_with_unread_end(folder: &Path) {
    let header = SessionHeader::new("m20270115_1", at(0), protocol());
    let course = Course {
        unread_end: true,
        ..Course::default()
    };
    record(folder, header, None, |_, record, _| record, course);
}

/// [`session`] as recorded by a daemon that reconstructs on a disc tank for 3 uV of noise, with a stored
/// `configuration`.
pub fn session_of(folder: &Path, id: &str, configuration: &str) -> PathBuf {
    session_with(folder, id, configuration, |_, record, _| record)
}

/// [`session_of`] with changes to the recorded maps, by frame time in seconds.
pub fn session_with(
    folder: &Path,
    id: &str,
    configuration: &str,
    kept: impl Fn(&Map, MapRecord, i64) -> MapRecord,
) -> PathBuf {
    let tank = DiscTank::default();
    let mesh = Arc::new(tank.mesh().expect("a sound tank"));
    let header = header_of(id, configuration, &mesh);
    let options = OneStepOptions {
        prior: Prior::noser(false, None),
        hyper: Hyper::Frame {
            rule: HyperRule::Evidence,
            volts: Some(3.0 * 1e-6),
            current: 1000.0 * 1e-6,
        },
        ..OneStepOptions::default()
    };
    let sigma = vec![tank.conductance(); mesh.triangles().len()];
    let reconstructor = OneStep::new(mesh, &tank.contact_ohm_m(), &sigma, &protocol(), options)
        .expect("a sound method");
    record(
        folder,
        header,
        Some(&reconstructor),
        kept,
        Course::default(),
    )
}

/// [`session_of`] without maps, pressed in its first two frames only.
pub fn session_released(folder: &Path, id: &str, configuration: &str) {
    let mesh = DiscTank::default().mesh().expect("a sound tank");
    let course = Course {
        released: true,
        ..Course::default()
    };
    let header = header_of(id, configuration, &mesh);
    record(folder, header, None, |_, record, _| record, course);
}

/// A calibration file of the tank for maps of a method, as `--json` prints it: 100 kPa for a complete loss of
/// conductance.
pub fn calibration(method: &Value) -> String {
    let mesh = DiscTank::default().mesh().expect("a sound tank");
    format!(
        "kind = \"{}\"\nmesh = \"{}\"\nmethod = {method}\nloss = [0.0, 1.0]\nkpa = [0.0, 100.0]\n\
         frame = [0.0, 0.0, 0.1, 0.1]\ngain = [0.0, 0.0, 0.0, 0.0, 0.0]\npresses = 6\nrms = 0.01\n",
        eit::CALIBRATION_KIND,
        mesh.hash(),
    )
}

/// The header that a daemon writes which reconstructs on a disc tank.
fn header_of(id: &str, configuration: &str, mesh: &Mesh) -> SessionHeader {
    SessionHeader {
        config_toml: format!("{configuration}[geometry]\npreset = \"disc-tank\"\n"),
        geometry_hash: Some(mesh.hash().to_owned()),
        ..SessionHeader::new(id, at(0), protocol())
    }
}

fn protocol() -> Protocol {
    Protocol::sheffield(16).expect("sixteen electrodes")
}

/// Variations of a session.
#[derive(Debug, Clone, Copy, Default)]
struct Course {
    /// Whether a new part starts after each frame.
    rolled: bool,
    /// Whether the second frame is delayed by a third of a second, and the third by two thirds.
    thirds: bool,
    /// Whether there is no baseline.
    bare: bool,
    /// Whether there are two more frames, the last one ten minutes after the fourth, with an event that explains it.
    paused: bool,
    /// Whether an alarm becomes active with the second frame and another one with the third.
    alarms: bool,
    /// Whether an alarm cannot be judged from the second frame on.
    not_judged: bool,
    /// Whether only the first two frames have the load.
    released: bool,
    /// Whether no frame has a load.
    unpressed: bool,
    /// Whether all readings are missing in all frames.
    unread: bool,
    /// Whether all readings are missing in the last frame.
    unread_end: bool,
    /// In how many of the last frames the source is in compliance.
    compliance_end: i64,
}

fn record(
    folder: &Path,
    header: SessionHeader,
    reconstructor: Option<&OneStep>,
    kept: impl Fn(&Map, MapRecord, i64) -> MapRecord,
    course: Course,
) -> PathBuf {
    let protocol = protocol();
    let preset = DiscTank {
        fineness: 1.3,
        seeding: 3,
        ..DiscTank::default()
    };
    let tank = Arc::new(preset.mesh().expect("a sound tank"));
    let forward = Forward::new(Arc::clone(&tank), &preset.contact_ohm_m()).expect("a sound tank");
    let settings = Settings {
        precautions: survey::Precautions::default(),
        protocol_hash: protocol.hash(),
        current: Amps(CURRENT),
        range: Volts(1.0),
        nplc: 1.0,
        settle: Duration::from_millis(1),
        wiring: "test".into(),
    };
    let frame = |second: i64, readings: Vec<Reading>| Frame {
        extra: Vec::new(),
        sequence: 0,
        readings,
        monotonic: Duration::from_secs(second as u64),
        wall: at(second)
            + Duration::from_micros(if course.thirds { 333_333 } else { 0 }) * (second as u32 - 1),
        duration: Duration::from_millis(500),
        settings: settings.clone(),
        compliance: Vec::new(),
        simulated: true,
    };
    let unloaded = voltages(&tank, &forward, &protocol, false);
    let loaded = voltages(&tank, &forward, &protocol, true);
    let mut gap = loaded.clone();
    gap[7] = Reading::Overload;
    let header = SessionHeader {
        kind: SessionKind::Measurement,
        simulated: true,
        note: "three frames".into(),
        ..header
    };
    let mut writer = SessionWriter::create(folder, &header).expect("a folder to write in");
    let baseline = Baseline {
        id: "b20270115_1".into(),
        deviation: vec![Some(2e-6); unloaded.len()],
        readings: unloaded.clone(),
        frames: 10,
        wall: at(-60),
        settings: settings.clone(),
        simulated: true,
    };
    if !course.bare {
        writer.baseline(&baseline).expect("written");
    }
    let mut frames = match course.released {
        true => vec![
            (1, loaded.clone()),
            (2, loaded.clone()),
            (3, unloaded.clone()),
        ],
        false => vec![(1, unloaded.clone()), (2, gap), (3, loaded.clone())],
    };
    if course.paused {
        frames.extend([(4, loaded.clone()), (604, loaded)]);
    }
    if course.unpressed {
        for (_, readings) in &mut frames {
            readings.clone_from(&unloaded);
        }
    }
    if course.unread {
        for (_, readings) in &mut frames {
            readings.fill(Reading::NotMeasured);
        }
    }
    if course.unread_end
        && let Some((_, readings)) = frames.last_mut()
    {
        readings.fill(Reading::NotMeasured);
    }
    let end = frames.last().map_or(0, |(second, _)| second + 1);
    for (second, readings) in frames {
        let compliance = match second + course.compliance_end >= end {
            true => vec![Electrode(5)],
            false => Vec::new(),
        };
        let map = reconstructor.map(|reconstructor| {
            let map = reconstructor
                .reconstruct(&unloaded, &readings)
                .expect("a map");
            let build = format!("tactusd {}", env!("CARGO_PKG_VERSION"));
            let record = MapRecord::new(&map, None, build, eit::cpu_features());
            kept(&map, record, second)
        });
        writer
            .append(
                &Frame {
                    compliance,
                    ..frame(second, readings)
                },
                map.as_ref(),
            )
            .expect("written");
        if course.alarms && second > 1 {
            let behind = at(second) + Duration::from_millis(500);
            let text = format!("pressed: load of frame {second} <is> above 3 & stays");
            writer
                .event(behind, "alarm-active", &text)
                .expect("written");
        }
        if course.not_judged && second == 2 {
            let text = "pressed cannot be judged: the load is not known";
            writer.event(at(2), "alarm-invalid", text).expect("written");
        }
        if course.paused && second == 4 {
            let text = "no frames while the disk was slow";
            writer.event(at(5), "paused", text).expect("written");
        }
        if course.rolled {
            writer.roll(at(second)).expect("another part");
        }
    }
    let path = writer.path().to_owned();
    writer.close(at(end), "count reached").expect("closed");
    path
}
