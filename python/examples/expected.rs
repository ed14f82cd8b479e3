//! Writes the values that the tests of the Python package compare with: arrays of the Rust engine as raw doubles, a
//! case folder, and a session. Matrices are written column by column. Call: `expected FOLDER`.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use chrono::DateTime;
use eit::{DiscTank, Existing, Forward, PaperSheet, Parameters, Preset};
use imaging::recorded::{Fitted, Unloaded};
use imaging::tracking::Tracking;
use imaging::{Geometry, HyperChoice, Method, PriorName, ReconstructionSettings};
use logbook::{SessionHeader, SessionWriter};
use survey::{Amps, Baseline, Frame, Protocol, Reading, Settings, Volts};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("name the folder")?;
    let folder = Path::new(&folder);
    let tank = DiscTank {
        fineness: 0.5,
        ..DiscTank::default()
    };
    let geometry = Geometry::from_preset(&Preset::DiscTank(tank))?;
    let protocol = Protocol::sheffield(16)?;
    geometry
        .case_of(protocol.clone(), vec![1e-3; protocol.len()])
        .write(&folder.join("case"), Existing::Refuse)?;

    let save = |name: &str, values: &[f64]| save(folder, name, values);
    // the forward model with a different conductance in each triangle
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)?;
    let sigma: Vec<f64> = (0..geometry.sigma0.len())
        .map(|t| 1e-3 * (1.0 + 0.3 * (t as f64).sin()))
        .collect();
    save("sigma", &sigma)?;
    save("readings", forward.readings(&sigma, &protocol)?.as_slice())?;
    save("jacobian", forward.jacobian(&sigma, &protocol)?.as_slice())?;
    let relative = Parameters::region().logarithmic();
    save(
        "relative",
        forward
            .sensitivity(&sigma, &protocol, &relative)?
            .as_slice(),
    )?;
    save("transfer", forward.transfer_impedance(&sigma)?.as_slice())?;

    // three frames without a load and two with one; each reading has a repeatable error
    let pressed: Vec<f64> = (0..sigma.len())
        .map(|t| {
            let [x, y] = geometry.mesh.centroid(t);
            if (x - 0.05).hypot(y) < 0.03 {
                0.6e-3
            } else {
                1e-3
            }
        })
        .collect();
    let before = forward.readings(&geometry.sigma0, &protocol)?;
    let after = forward.readings(&pressed, &protocol)?;
    let frame = |number: usize, ohms: &[f64]| -> Vec<Reading> {
        let volts = |(reading, ohms): (usize, &f64)| {
            1e-3 * ohms + 1e-6 * ((7 * reading + 31 * number) as f64).sin()
        };
        ohms.iter()
            .enumerate()
            .map(volts)
            .map(|volts| Reading::Ok(Volts(volts)))
            .collect()
    };
    let unloaded: Vec<Vec<Reading>> = (0..3)
        .map(|number| frame(number, before.as_slice()))
        .collect();
    let mut loaded: Vec<Vec<Reading>> = (3..5)
        .map(|number| frame(number, after.as_slice()))
        .collect();
    save("baseline", &numbers(&unloaded))?;
    save("frames", &numbers(&loaded))?;
    loaded[1][5] = Reading::NotMeasured;
    let slices: Vec<&[Reading]> = unloaded.iter().map(Vec::as_slice).collect();
    let mean = Unloaded::mean(&slices);
    let maps = |name: &str, known: bool, noise_v: Option<f64>, settings: ReconstructionSettings| {
        let geometry = Geometry {
            sigma0_known: known,
            from_case: true,
            ..geometry.clone()
        };
        let fitted = Fitted::new(geometry, &protocol, &vec![1e-3; protocol.len()], &mean)?;
        let mut conditions = fitted.conditions(&protocol);
        if noise_v.is_some() {
            (conditions.noise_v, conditions.noise_assumed) = (noise_v, false);
        }
        let model = imaging::build(&settings, &conditions)?;
        let mut values = Vec::new();
        for frame in &loaded {
            values.extend(model.reconstruct(&mean.readings, frame)?.values);
        }
        Ok::<_, Box<dyn Error>>(save(name, &values)?)
    };
    let of = |method| ReconstructionSettings {
        method: Some(method),
        ..Default::default()
    };
    maps("one_step", true, None, of(Method::OneStep))?;
    maps(
        "one_step_noise",
        true,
        Some(3e-6),
        ReconstructionSettings {
            prior: Some(PriorName::Gaussian),
            length_mm: Some(20.0),
            choose: Some(HyperChoice::Noise),
            ..of(Method::OneStep)
        },
    )?;
    maps(
        "one_step_fitted",
        false,
        None,
        ReconstructionSettings {
            prior: Some(PriorName::Laplace),
            choose: Some(HyperChoice::LCurve),
            loss_only: Some(true),
            ..of(Method::OneStep)
        },
    )?;
    maps(
        "one_step_figure",
        true,
        None,
        ReconstructionSettings {
            noise_figure: Some(1.5),
            ..of(Method::OneStep)
        },
    )?;
    maps(
        "tv",
        true,
        None,
        ReconstructionSettings {
            gap: Some(1e-2),
            ..of(Method::Tv)
        },
    )?;
    maps("shapes", true, None, of(Method::Best))?;
    followed(
        folder,
        &geometry,
        &protocol,
        &mean,
        &[&unloaded[2], &loaded[0]],
    )?;
    network(folder)?;
    save("unloaded", &numbers(&[mean.readings]))?;
    save(
        "noise",
        &[mean.noise.ok_or("the frames of the baseline are equal")?],
    )?;
    session(folder, &protocol, &unloaded, &loaded)
}

fn save(folder: &Path, name: &str, values: &[f64]) -> std::io::Result<()> {
    let bytes: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    std::fs::write(folder.join(format!("{name}.f64")), bytes)
}

/// The tracked baselines of frames at 600 s and 1200 s.
fn followed(
    folder: &Path,
    geometry: &Geometry,
    protocol: &Protocol,
    mean: &Unloaded,
    frames: &[&Vec<Reading>],
) -> Result<(), Box<dyn Error>> {
    let geometry = Geometry {
        sigma0_known: true,
        from_case: true,
        ..geometry.clone()
    };
    let fitted = Fitted::new(geometry, protocol, &vec![1e-3; protocol.len()], mean)?;
    let conditions = fitted.conditions(protocol);
    let noise_v = conditions.noise_v.ok_or("the noise is not known")?;
    let mut tracking = Tracking::new(&conditions, &mean.readings, noise_v, 0.0)?;
    let mut baselines = Vec::new();
    let mut known = String::new();
    for (number, frame) in frames.iter().enumerate() {
        let frame = tracking.follow(frame, 600.0 * (1.0 + number as f64))?;
        baselines.push(frame.baseline);
        known.push_str(&serde_json::to_string(&frame.tracked)?);
        known.push('\n');
    }
    save(folder, "tracked", &numbers(&baselines))?;
    std::fs::write(folder.join("tracked.jsonl"), known)?;
    Ok(())
}

/// The map of the shipped network for readings of the paper's sheet with a uniform conductance, each changed by a few
/// parts in a thousand.
fn network(folder: &Path) -> Result<(), Box<dyn Error>> {
    let geometry = Geometry::from_preset(&Preset::PaperSheet(PaperSheet::default()))?;
    let protocol = Protocol::sheffield(26)?;
    let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m)?;
    let ohms = forward.readings(&geometry.sigma0, &protocol)?;
    let volts = |change: f64| -> Vec<Reading> {
        let each = ohms.iter().enumerate();
        each.map(|(reading, ohms)| {
            Reading::Ok(Volts(1e-3 * ohms * (1.0 + change * (reading as f64).sin())))
        })
        .collect()
    };
    let (baseline, frame) = (volts(0.0), volts(1e-3));
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../models/rbf-paper.safetensors");
    let model = imaging::load(&file, false, &protocol, Some(&geometry))?;
    let map = model.reconstruct(&baseline, &frame)?;
    save(folder, "network", &map.values)?;
    save(folder, "network_readings", &numbers(&[baseline, frame]))?;
    Ok(())
}

/// Writes a session of three frames, two events and a baseline; the third frame has missing readings.
fn session(
    folder: &Path,
    protocol: &Protocol,
    unloaded: &[Vec<Reading>],
    loaded: &[Vec<Reading>],
) -> Result<(), Box<dyn Error>> {
    let settings = Settings {
        protocol_hash: protocol.hash(),
        current: Amps(1e-3),
        range: Volts(1.0),
        nplc: 1.0,
        settle: Duration::ZERO,
        wiring: "test".to_owned(),
        precautions: Default::default(),
    };
    let frame = |number: u64, readings: &[Reading]| Frame {
        sequence: 0,
        readings: readings.to_vec(),
        extra: Vec::new(),
        monotonic: Duration::from_millis(1500 * number),
        wall: DateTime::UNIX_EPOCH
            + Duration::from_micros(1_700_000_000_000_000 + 1_500_000 * number),
        duration: Duration::from_millis(900),
        settings: settings.clone(),
        compliance: Vec::new(),
        simulated: true,
    };
    let empty: Vec<Frame> = unloaded.iter().map(|readings| frame(0, readings)).collect();
    let at = DateTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000);
    let header = SessionHeader {
        simulated: true,
        note: "three frames".to_owned(),
        ..SessionHeader::new("tank", at, protocol.clone())
    };
    let mut writer = SessionWriter::create(folder, &header)?;
    writer.baseline(&Baseline::from_frames("empty", &empty)?)?;
    writer.event(at, "started", "for the tests")?;
    writer.append(&frame(0, &loaded[0]), None)?;
    // the second part of the session
    writer.roll(at)?;
    writer.append(&frame(1, &loaded[0]), None)?;
    let mut last = loaded[1].clone();
    (last[0], last[1]) = (Reading::Overload, Reading::NotMeasured);
    writer.append(&frame(2, &last), None)?;
    writer.close(at, "asked to stop")?;
    Ok(())
}

fn numbers(frames: &[Vec<Reading>]) -> Vec<f64> {
    let volts = |reading: &Reading| reading.volts().map_or(f64::NAN, |volts| volts.0);
    frames.iter().flatten().map(volts).collect()
}
