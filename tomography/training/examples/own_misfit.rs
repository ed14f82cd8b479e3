//! Counts how often the quality check gives maps of a model file the reasons `own_misfit` and `novelty`: `own_misfit
//! FILE [FRAMES]`.
//!
//! The frames are simulated on the paper's sheet with a finer mesh than the model's, another seed than the training's,
//! and 2 uV of noise on baseline and frame. Evaluated are loads as in training, loads of other kinds, and maps that
//! were changed on purpose.

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

use eit::{
    Case, Forward, ModelCheck, PaperSheet, ReconstructError, Scale, TrainingSettings, model::load,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use survey::{Map, Reading, Volts};
use training::samples::{Samples, Simulation};

const SEED: u64 = 41;
const NOISE_V: f64 = 2e-6;
const CURRENT: f64 = 1e-3;
/// Middle of the sheet, and half the sides of the region, m.
const MIDDLE: [f64; 2] = [0.107, 0.115];
const REGION: [f64; 2] = [0.08876, 0.0954];

type Failure = Box<dyn std::error::Error + Send + Sync>;
type Factor = Box<dyn Fn([f64; 2]) -> f64>;

/// Loads as in training, and others.
const LOADS: [&str; 10] = [
    "polygons, as in training",
    "press of 10 mm",
    "press of 30 mm",
    "one to three discs",
    "ring",
    "bar",
    "disc of twice the conductance",
    "load over an electrode",
    "tenth of the sheet's conductance",
    "ramp over the sheet",
];

/// The factor of the conductance as a function of the position (m), for all kinds except the first.
fn load_of(kind: usize, electrodes: &[[f64; 2]], random: &mut ChaCha8Rng) -> Factor {
    let loss = random.random_range(0.2..0.8);
    let mut inside = |margin: f64| {
        [0, 1].map(|k| MIDDLE[k] + random.random_range(-1.0..1.0) * (REGION[k] - margin))
    };
    match kind {
        1 | 2 => {
            let centre = inside(0.015);
            let radius = if kind == 1 { 5e-3 } else { 15e-3 };
            Box::new(move |at| if away(at, centre) < radius { 0.5 } else { 1.0 })
        }
        3 => {
            let discs: Vec<_> = (0..3).map(|_| inside(0.02)).collect();
            let count = random.random_range(1..=3);
            let radius = 5e-3 * 4_f64.powf(random.random_range(0.0..1.0));
            Box::new(move |at| {
                let under = discs[..count].iter().any(|disc| away(at, *disc) < radius);
                if under { 1.0 - loss } else { 1.0 }
            })
        }
        4 => {
            let centre = inside(0.045);
            let outer = random.random_range(20e-3..45e-3);
            let inner = outer * random.random_range(0.5..0.75);
            Box::new(move |at| match (inner..outer).contains(&away(at, centre)) {
                true => 1.0 - loss,
                false => 1.0,
            })
        }
        5 => {
            let centre = inside(0.07);
            let (sin, cos) = random.random_range(0.0..TAU).sin_cos();
            Box::new(move |at| {
                let [x, y] = [at[0] - centre[0], at[1] - centre[1]];
                let [along, across] = [cos * x + sin * y, cos * y - sin * x];
                let within = along.abs() < 0.05 && across.abs() < 6e-3;
                if within { 1.0 - loss } else { 1.0 }
            })
        }
        6 => {
            let centre = inside(0.03);
            let radius = random.random_range(10e-3..30e-3);
            Box::new(move |at| if away(at, centre) < radius { 2.0 } else { 1.0 })
        }
        7 => {
            let centre = electrodes[random.random_range(0..electrodes.len())];
            let radius = random.random_range(4e-3..15e-3);
            Box::new(move |at| match away(at, centre) < radius {
                true => 1.0 - loss,
                false => 1.0,
            })
        }
        8 => Box::new(|_| 0.9),
        _ => {
            let (sin, cos) = random.random_range(0.0..TAU).sin_cos();
            Box::new(move |[x, y]| {
                let along = cos * (x - MIDDLE[0]) + sin * (y - MIDDLE[1]);
                1.0 - 0.5 * loss * (1.0 + along / 0.16)
            })
        }
    }
}

fn away(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Changes of a map; the first leaves it as the network made it.
const CHANGES: [&str; 4] = ["", "no load", "half of it", "another place"];

fn changed(mut map: Map, change: usize) -> Map {
    let third = map.values.len() / 3;
    match change {
        1 => map.values.fill(0.0),
        2 => map.values.iter_mut().for_each(|value| *value *= 0.5),
        3 => map.values.rotate_left(third),
        _ => {}
    }
    map
}

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().ok_or("own_misfit FILE [FRAMES]")?;
    let frames: usize = arguments.next().map_or(Ok(500), |text| text.parse())?;
    let model = load(Path::new(&file))?;
    let usual = model.metadata().own_misfit.clone();
    println!("{file}: {usual:#?}");
    let sheet = PaperSheet::default();
    let protocol = model.protocol().clone();
    let mesh = Arc::clone(model.mesh());
    let sigma0 = vec![sheet.conductance(); mesh.triangles().len()];
    let noise = Some(NOISE_V / CURRENT);
    let contacts = sheet.contact_ohm_m();
    let check = ModelCheck::new(&mesh, &contacts, &sigma0, &protocol, Scale::Uniform, noise)?;
    let settings = model.metadata().training.clone();
    let network = model.into_reconstructor();

    let fine = PaperSheet {
        fineness: 1.6,
        ..sheet
    };
    let mesh = Arc::new(fine.mesh()?);
    let sigma0 = vec![fine.conductance(); mesh.triangles().len()];
    let case = Case {
        contact_ohm_m: fine.contact_ohm_m(),
        currents: vec![CURRENT; protocol.len()],
        has_region: true,
        sigma: [("homog".to_owned(), sigma0.clone())].into(),
        mesh: Arc::clone(&mesh),
        protocol,
    };
    let fresh = TrainingSettings {
        cases: 2 * frames,
        repeats: 1,
        neurons: 1,
        seed: settings.seed + SEED,
        ..settings
    };
    let simulation = Simulation::new(&mesh, &case.contact_ohm_m, &sigma0, &case.protocol, &fresh)?;
    // cases without a load are skipped
    let polygons: Vec<usize> = (0..simulation.len())
        .filter(|&number| !simulation.target(number).is_empty())
        .take(frames)
        .collect();
    let forward = Forward::new(Arc::clone(&mesh), &case.contact_ohm_m)?;
    let unloaded = forward.readings(&sigma0, &case.protocol)?;
    let electrodes = mesh.electrode_centres();
    println!(
        "| loads | maps | frames | refused | own_misfit | novelty |\n|---|---|---|---|---|---|"
    );
    for (kind, name) in LOADS.iter().enumerate() {
        for (change, what) in CHANGES.iter().enumerate() {
            // only maps of loads as in training are changed
            if change > 0 && ![0, 2].contains(&kind) {
                continue;
            }
            let count = if kind == 0 { polygons.len() } else { frames };
            let found = (0..count)
                .into_par_iter()
                .map(|frame| -> Result<Option<[bool; 2]>, Failure> {
                    let random = &mut ChaCha8Rng::seed_from_u64(SEED);
                    random.set_stream((kind as u64) << 32 | frame as u64);
                    let ohms: Vec<f64> = if kind == 0 {
                        let sample = simulation.solve(polygons[frame])?;
                        let both = unloaded.iter().zip(&sample.input);
                        both.map(|(v, x)| v + simulation.top() * f64::from(*x))
                            .collect()
                    } else {
                        let factor = load_of(kind, &electrodes, random);
                        let at = |t: usize| sigma0[t] * factor(mesh.centroid(t));
                        let sigma: Vec<f64> = (0..sigma0.len()).map(at).collect();
                        let ohms = forward.readings(&sigma, &case.protocol)?;
                        ohms.iter().copied().collect()
                    };
                    let noise = Normal::new(0.0, NOISE_V)?;
                    let mut measured = |ohms: &[f64]| -> Vec<Reading> {
                        let noisy = ohms.iter().map(|v| CURRENT * v + noise.sample(random));
                        noisy.map(|v| Reading::Ok(Volts(v))).collect()
                    };
                    let [baseline, frame] = [measured(unloaded.as_slice()), measured(&ohms)];
                    let map = match network.reconstruct(&baseline, &frame) {
                        Err(ReconstructError::OutsideModel { .. }) => return Ok(None),
                        made => made?,
                    };
                    let map = changed(map, change);
                    let quality = check
                        .judged(&baseline, &frame, map, usual.as_ref())
                        .quality
                        .ok_or("a judged map has a quality")?;
                    let has = |kind| quality.reasons.iter().any(|reason| reason.kind == kind);
                    Ok(Some([has("own_misfit"), has("novelty")]))
                })
                .collect::<Result<Vec<_>, Failure>>()?;
            let maps: Vec<[bool; 2]> = found.iter().copied().flatten().collect();
            let share = |which: usize| {
                let with = maps.iter().filter(|one| one[which]).count();
                100.0 * with as f64 / maps.len().max(1) as f64
            };
            println!(
                "| {name} | {what} | {count} | {} | {:.1} % | {:.1} % |",
                count - maps.len(),
                share(0),
                share(1)
            );
        }
    }
    Ok(())
}
