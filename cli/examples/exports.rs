//! Measures exports of a long session of the simulated preset sheet, one frame a second with a gap of one hour. Build
//! the program with `cargo build --release -p tactus-cli`, then call
//! `cargo run --release -p tactus-cli --example exports -- FRAMES FOLDER FORMAT...`. FOLDER keeps the session, which is
//! made only if it does not exist. Prints time and peak memory of each export.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};
use eit::{Forward, PaperSheet};
use logbook::{SessionHeader, SessionKind, SessionWriter};
use survey::{Amps, Baseline, Frame, Protocol, Reading, Settings, Volts};

const CURRENT: f64 = 1e-3;
const GROUP: u64 = 512;
const ID: &str = "m20270115_1";

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut words = std::env::args().skip(1);
    let frames: u64 = words.next().ok_or("FRAMES is missing")?.parse()?;
    let folder = words.next().ok_or("FOLDER is missing")?;
    let folder = Path::new(&folder);
    std::fs::create_dir_all(folder)?;
    if !folder.join(format!("{ID}.tactus")).exists() {
        record(folder, frames)?;
    }
    for format in words {
        export(folder, &format)?;
    }
    Ok(())
}

fn export(folder: &Path, format: &str) -> Result<(), Box<dyn std::error::Error>> {
    let program = std::env::current_exe()?;
    let program = program
        .ancestors()
        .nth(2)
        .ok_or("no folder")?
        .join("tactus");
    let began = Instant::now();
    let out = format!("out.{format}");
    let mut child = Command::new(program)
        .args(["export", ID, "--force", "--format", format, "--out", &out])
        .env("TACTUS_STATE", ".")
        .current_dir(folder)
        .spawn()?;
    let mut peak_kb = 0;
    let status = loop {
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id()))?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let number = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
        peak_kb = peak_kb.max(number.unwrap_or(0));
        if let Some(status) = child.try_wait()? {
            break status;
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    let bytes = std::fs::metadata(folder.join(&out)).map_or(0, |file| file.len());
    println!(
        "{format}: {status}, {:.1} s, {:.0} MB of memory, {:.1} MB",
        began.elapsed().as_secs_f64(),
        peak_kb as f64 / 1024.0,
        bytes as f64 / 1e6
    );
    Ok(())
}

/// Records the session: three loads that come and go.
fn record(folder: &Path, frames: u64) -> Result<(), Box<dyn std::error::Error>> {
    let sheet = PaperSheet::default();
    let mesh = Arc::new(sheet.mesh()?);
    let protocol = Protocol::sheffield(sheet.electrodes())?;
    let forward = Forward::new(Arc::clone(&mesh), &sheet.contact_ohm_m())?;
    let volts = |press: Option<[f64; 2]>| -> Result<Vec<f64>, Box<dyn std::error::Error>> {
        let unloaded = sheet.conductance();
        let sigma: Vec<f64> = (0..mesh.triangles().len())
            .map(|triangle| {
                let [x, y] = mesh.centroid(triangle);
                let near = |[a, b]: [f64; 2]| (x - a).hypot(y - b) < 0.018;
                if press.is_some_and(near) {
                    0.5 * unloaded
                } else {
                    unloaded
                }
            })
            .collect();
        let ohms = forward.readings(&sigma, &protocol)?;
        Ok(ohms.into_iter().map(|ohms| ohms * CURRENT).collect())
    };
    let unloaded = volts(None)?;
    let pressed = [
        volts(Some([0.06, 0.07]))?,
        volts(Some([0.15, 0.16]))?,
        volts(Some([0.11, 0.11]))?,
    ];
    let begin = DateTime::from_timestamp(1_800_000_000, 0).ok_or("a time")?;
    let at = |second: u64| -> DateTime<Utc> {
        // an hour without frames after a third of the session
        let gap = if second > frames / 3 { 3600 } else { 0 };
        begin + Duration::from_secs(second + gap)
    };
    let settings = Settings {
        precautions: survey::Precautions::default(),
        protocol_hash: protocol.hash(),
        current: Amps(CURRENT),
        range: Volts(1.0),
        nplc: 1.0,
        settle: Duration::from_millis(1),
        wiring: "test".into(),
    };
    let header = SessionHeader {
        kind: SessionKind::Measurement,
        simulated: true,
        note: "a long session".into(),
        config_toml: "[geometry]\npreset = \"paper-sheet\"\n".into(),
        geometry_hash: Some(mesh.hash().to_owned()),
        ..SessionHeader::new(ID, begin, protocol)
    };
    let mut state = 1_u64;
    let mut noise = || {
        let mut sum = 0.0;
        for _ in 0..4 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum += (state >> 40) as f64 / (1_u64 << 24) as f64 - 0.5;
        }
        2e-6 * sum
    };
    let mut readings = |second: u64| -> Vec<Reading> {
        let turn = second as f64 / 3000.0;
        let share = |which: usize| (turn + which as f64 * 2.1).sin().max(0.0);
        (0..unloaded.len())
            .map(|index| {
                let change: f64 = (0..3)
                    .map(|which| share(which) * (pressed[which][index] - unloaded[index]))
                    .sum();
                // rounded as the voltmeter prints them
                let volts = unloaded[index] + change + noise();
                Reading::Ok(Volts((volts * 1e7).round() / 1e7))
            })
            .collect()
    };
    let mut writer = SessionWriter::create(folder, &header)?;
    writer.baseline(&Baseline {
        id: "b20270115_1".into(),
        deviation: vec![Some(1.2e-6); unloaded.len()],
        readings: unloaded
            .iter()
            .map(|volts| Reading::Ok(Volts(*volts)))
            .collect(),
        frames: 10,
        wall: begin - Duration::from_secs(60),
        settings: settings.clone(),
        simulated: true,
    })?;
    for from in (1..=frames).step_by(GROUP as usize) {
        let group: Vec<Frame> = (from..(from + GROUP).min(frames + 1))
            .map(|second| Frame {
                extra: Vec::new(),
                sequence: 0,
                readings: readings(second),
                monotonic: Duration::from_micros(
                    (at(second) - begin).num_microseconds().unwrap_or(0) as u64,
                ),
                wall: at(second),
                duration: Duration::from_millis(800),
                settings: settings.clone(),
                compliance: Vec::new(),
                simulated: true,
            })
            .collect();
        writer.append_all(group.iter().map(|frame| (frame, None)))?;
    }
    writer.event(at(frames / 3), "paused", "the disk was slow")?;
    println!("{} frames, {} bytes", writer.acknowledged(), writer.bytes());
    writer.close(at(frames + 1), "count reached")?;
    Ok(())
}
