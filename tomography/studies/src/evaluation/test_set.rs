//! Test sets: a case folder with frames from a finer, different mesh, and files with the truth.
//!
//! `reconstruct` reads mesh, contacts, protocol and `frames.csv` (baseline first); only `evaluate` reads `truth.csv`
//! and `presses.csv`.

use std::f64::consts::TAU;
use std::path::Path;
use std::time::Duration;

use clap::ValueEnum;
use eit::{Case, Mesh, PaperSheet, Preset, frames_text, matrix_text};
use imaging::Geometry;
use nalgebra::DMatrix;
use outfile::Existing;
use phantom::{
    FINER, Load, Phantom, Scene, Shape, SpraySettings, across, loss_of_pressure, paper,
    pressure_kpa,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::Amps;

use crate::failure::{Failure, write};
use crate::progress;

/// File with the description of a test set.
pub const DESCRIPTION: &str = "judged.json";
/// Current of every reading, A.
const CURRENT: Amps = Amps(1e-3);
/// Loss of conductance under a press.
const LOSS: f64 = 0.5;
/// Algorithm 1 of the paper: maximum polygons, radius (mm), vertices.
const POLYGONS: usize = 4;
const RADIUS_MM: f64 = 70.0;
const VERTICES: usize = 5;

/// Masses (kg) and diameters (mm) of the presses of known mass, used in turn.
const MASSES_KG: [f64; 6] = [0.2, 0.5, 1.0, 2.0, 3.0, 4.0];
const DIAMETERS_MM: [f64; 4] = [25.0, 30.0, 40.0, 50.0];

/// The load of one frame.
pub(crate) struct Pressed {
    /// Mass, kg, if known.
    mass: Option<f64>,
    pub(crate) loads: Vec<Load>,
    /// Centre and diameter, mm, if the load is one disc.
    disc: Option<([f64; 2], f64)>,
}

/// Description of a test set.
pub struct Description {
    /// Name and noise of the set, for people.
    pub name: String,
    /// White noise of one reading, V.
    pub noise_v: f64,
}

/// Reads the description that [`make`] wrote to a folder.
///
/// # Errors
/// A missing file, or one without name and noise.
pub fn description(folder: &Path) -> Result<Description, Failure> {
    let path = folder.join(DESCRIPTION);
    let wrong = |why: String| {
        Failure::because(format!(
            "{}: {why}; make judging data with tactus-lab judge",
            path.display()
        ))
    };
    let text = std::fs::read_to_string(&path).map_err(|cause| wrong(cause.to_string()))?;
    let description: serde_json::Value =
        serde_json::from_str(&text).map_err(|cause| wrong(cause.to_string()))?;
    match (description["set"].as_str(), description["noise_v"].as_f64()) {
        (Some(set), Some(noise_v)) => Ok(Description {
            name: format!("{set} {:.0} uV", 1e6 * noise_v),
            noise_v,
        }),
        _ => Err(wrong("set or noise_v is missing".to_owned())),
    }
}

/// Which loads a set has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TestSetName {
    /// Discs of 10 mm, half the conductance lost, anywhere in the region
    #[value(name = "presses-10")]
    Presses10,
    /// Discs of 30 mm
    #[value(name = "presses-30")]
    Presses30,
    /// Algorithm 1 of the paper: up to four polygons, losses up to all
    Polygons,
    /// The paper's Test #1: S1 at 16 places
    #[value(name = "test-1")]
    Test1,
    /// The paper's Test #2: S2, S3 and S4 at three places each
    #[value(name = "test-2")]
    Test2,
    /// Discs of 20 to 140 mm, four of each, half the conductance lost
    Sizes,
    /// Discs of 25 to 50 mm under known masses, 200 g to 4 kg: what `calibrate` is fitted to
    Masses,
}

impl TestSetName {
    /// Name on the command line.
    pub fn name(self) -> String {
        self.to_possible_value()
            .map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Default number of frames.
    fn usual(self) -> usize {
        match self {
            Self::Presses10 | Self::Presses30 => 32,
            Self::Polygons => 100,
            Self::Test1 => 16,
            Self::Test2 => 9,
            Self::Sizes => 28,
            Self::Masses => 24,
        }
    }
}

/// Options of a test set.
#[derive(Debug)]
pub struct TestSet {
    /// Its loads.
    pub set: TestSetName,
    /// White noise of one reading on baseline and frames, V; 0 for none.
    pub noise_v: f64,
    /// Equal seeds give equal folders; training uses other random streams.
    pub seed: u64,
    /// Number of frames; default: that of the set.
    pub count: Option<usize>,
    /// Standard deviation of the logarithm of conductance of an unevenly sprayed sheet.
    pub spray: Option<f64>,
    /// Seed of the sheet, so that sets of different loads can have the same one; default: `seed`.
    pub sheet_seed: Option<u64>,
    /// The simulated sheet.
    pub sheet: PaperSheet,
    /// The case for the reconstruction: the sheet on another mesh than the phantom's; default: its preset at 1 mA.
    pub case: Option<Case>,
}

/// Makes the folder; returns the number of frames without the baseline.
///
/// # Errors
/// Invalid options, a case of another sheet, or files that exist and may not be replaced.
pub fn make(options: &TestSet, folder: &Path, existing: Existing) -> Result<usize, Failure> {
    if !(options.noise_v >= 0.0 && options.noise_v.is_finite()) {
        return Err(Failure::usage(format!(
            "--noise-v {}: volts are expected, e.g. 2e-6, or 0",
            options.noise_v
        )));
    }
    if options.count == Some(0) {
        return Err(Failure::usage("--count 0: a set needs a frame"));
    }
    let sheet = Preset::PaperSheet(options.sheet.clone());
    let case = match &options.case {
        Some(case) => case.clone(),
        None => Geometry::from_preset(&sheet)
            .map_err(|fault| Failure::because(survey::error_chain(&fault)))?
            .case(CURRENT)
            .map_err(|fault| Failure::of("no protocol for this ring", &fault))?,
    };
    let mut scene = Scene {
        seed: options.sheet_seed.unwrap_or(options.seed),
        sheet: sheet.remeshed(FINER, 1),
        ..Scene::quiet()
    };
    if let Some(std) = options.spray {
        scene.effects.spray = Some(SpraySettings {
            std,
            ..SpraySettings::default()
        });
        scene.effects.check().map_err(|(effect, fault)| {
            Failure::usage(format!(
                "--spray {std}: effect {effect}: {} {}",
                fault.key, fault.why
            ))
        })?;
    }
    let failed = |fault| Failure::of("the simulated sheet", &fault);
    let mut phantom = Phantom::new(scene).map_err(failed)?;
    if phantom.electrodes() != case.mesh.electrodes() || phantom.mesh().hash() == case.mesh.hash() {
        return Err(Failure::because(
            "judging data come from the simulated sheet of the paper on its own finer mesh: the case must be that sheet on \
             another mesh",
        ));
    }
    let mut random = ChaCha8Rng::seed_from_u64(options.seed);
    random.set_stream(options.set as u64 + 1);
    let fixed = match options.set {
        TestSetName::Test1 | TestSetName::Test2 | TestSetName::Sizes => options.set.usual(),
        _ => usize::MAX,
    };
    let count = options.count.unwrap_or(options.set.usual()).min(fixed);
    let drawn: Vec<Pressed> = (0..count)
        .map(|k| match options.set {
            TestSetName::Presses10 => press(&case.mesh, 10.0, &mut random),
            TestSetName::Presses30 => press(&case.mesh, 30.0, &mut random),
            TestSetName::Polygons => polygons(&case.mesh, &mut random),
            TestSetName::Test1 => disc(paper::s1(paper::test1_positions()[k]), 10.0),
            TestSetName::Test2 => {
                let shape = [paper::s2, paper::s3, paper::s4][k / 3];
                Pressed {
                    mass: None,
                    loads: vec![shape(paper::TEST2_MM[k % 3])],
                    disc: None,
                }
            }
            TestSetName::Masses => mass(&case.mesh, k, &mut random),
            TestSetName::Sizes => press(&case.mesh, 20.0 * (1 + k / 4) as f64, &mut random),
        })
        .collect();
    let noise = Normal::new(0.0, options.noise_v)
        .map_err(|_| Failure::usage("--noise-v must be a positive number"))?;
    let mut exact = |loads: &[Load]| -> Result<Vec<f64>, Failure> {
        phantom.release();
        for load in loads {
            phantom.press(load.clone()).map_err(failed)?;
        }
        let z = phantom.transfer_impedance(Duration::ZERO).map_err(failed)?;
        Ok(case
            .protocol
            .measurements()
            .iter()
            .zip(&case.currents)
            .map(|(q, current)| current * across(z, q.sense, q.drive))
            .collect())
    };
    let mut noisy = |volts: Vec<f64>| -> Vec<f64> {
        volts
            .into_iter()
            .map(|volts| volts + noise.sample(&mut random))
            .collect()
    };
    let bar = progress::bar(count, "frames");
    let mut frames = vec![noisy(exact(&[])?)];
    let mut truth = Vec::new();
    let mut presses = String::from("frame,x_m,y_m,diameter_m,loss,mass_kg\n");
    for (k, pressed) in drawn.iter().enumerate() {
        frames.push(noisy(exact(&pressed.loads)?));
        truth.extend(true_map(&case, &pressed.loads)?);
        if let Some(([x, y], diameter)) = pressed.disc {
            presses.push_str(&format!(
                "{},{},{},{},{},{}\n",
                // the baseline is frame 1
                k + 2,
                x * 1e-3,
                y * 1e-3,
                diameter * 1e-3,
                pressed.loads[0].loss,
                pressed.mass.unwrap_or(f64::NAN)
            ));
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    put(folder, existing, &case, &frames, truth)?;
    if drawn.iter().all(|pressed| pressed.disc.is_some()) {
        write(&folder.join("presses.csv"), existing, presses)?;
    }
    let description = serde_json::json!({
        "set": options.set.name(),
        "noise_v": options.noise_v,
        "seed": options.seed,
        "frames": count,
    });
    write(
        &folder.join(DESCRIPTION),
        existing,
        format!("{description}\n"),
    )?;
    Ok(count)
}

fn put(
    folder: &Path,
    existing: Existing,
    case: &Case,
    frames: &[Vec<f64>],
    truth: Vec<f64>,
) -> Result<(), Failure> {
    case.write(folder, existing)
        .map_err(|fault| Failure::of("cannot write the case", &fault))?;
    let frames: Vec<Vec<Option<f64>>> = frames
        .iter()
        .map(|frame| frame.iter().copied().map(Some).collect())
        .collect();
    write(&folder.join("frames.csv"), existing, frames_text(&frames))?;
    let triangles = case.mesh.region().len();
    let truth = DMatrix::from_row_slice(truth.len() / triangles, triangles, &truth);
    write(&folder.join("truth.csv"), existing, matrix_text(&truth))
}

/// Relative change of every triangle of the case's region by covered shares; overlaps multiply.
///
/// # Errors
/// A load without an area.
pub fn true_map(case: &Case, loads: &[Load]) -> Result<Vec<f64>, Failure> {
    let mut kept = vec![1.0; case.mesh.triangles().len()];
    for load in loads {
        let covered = load
            .coverage(&case.mesh)
            .map_err(|fault| Failure::of("the truth", &fault))?;
        for (triangle, share) in covered {
            kept[triangle] *= 1.0 - load.loss * share;
        }
    }
    Ok(case.mesh.region().iter().map(|&t| kept[t] - 1.0).collect())
}

/// Lowest and highest corner of the region's centroids, mm.
pub(crate) fn bounds(mesh: &Mesh) -> [[f64; 2]; 2] {
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    for centroid in mesh.region_centroids() {
        for axis in 0..2 {
            low[axis] = low[axis].min(centroid[axis] * 1e3);
            high[axis] = high[axis].max(centroid[axis] * 1e3);
        }
    }
    [low, high]
}

/// A disc at a random position, completely inside the region; diameter in mm.
pub(crate) fn press(mesh: &Mesh, diameter: f64, random: &mut ChaCha8Rng) -> Pressed {
    let [low, high] = bounds(mesh);
    let margin = 0.5 * diameter;
    let centre = [0, 1].map(|axis| {
        let (from, to) = (low[axis] + margin, high[axis] - margin);
        from + random.random::<f64>() * (to - from)
    });
    disc(Load::disc(centre, diameter, LOSS), diameter)
}

fn disc(load: Load, diameter: f64) -> Pressed {
    Pressed {
        mass: None,
        disc: Some((load.centre_mm, diameter)),
        loads: vec![load],
    }
}

/// A press of known mass: all combinations of mass and diameter in turn, so that pressures repeat at several positions.
fn mass(mesh: &Mesh, k: usize, random: &mut ChaCha8Rng) -> Pressed {
    let (mass, diameter) = (MASSES_KG[k % 6], DIAMETERS_MM[(k + k / 12) % 4]);
    let mut pressed = press(mesh, diameter, random);
    let kpa = pressure_kpa(1e3 * mass, pressed.loads[0].shape.area());
    pressed.loads[0].loss = loss_of_pressure(kpa, paper::HALF_KPA);
    pressed.mass = Some(mass);
    pressed
}

/// A case of Algorithm 1 with a load: drawn again until it has one. The polygons are clipped at the region's border as
/// in training.
pub(crate) fn polygons(mesh: &Mesh, random: &mut ChaCha8Rng) -> Pressed {
    let [low, high] = bounds(mesh);
    loop {
        let mut loads = Vec::new();
        for _ in 0..random.random_range(0..=POLYGONS) {
            let centre =
                [0, 1].map(|axis| low[axis] + random.random::<f64>() * (high[axis] - low[axis]));
            let radius = random.random::<f64>() * RADIUS_MM;
            let mut angles: Vec<f64> = (0..random.random_range(0..=VERTICES))
                .map(|_| random.random::<f64>() * TAU)
                .collect();
            let loss = random.random::<f64>();
            angles.sort_by(f64::total_cmp);
            let points: Vec<[f64; 2]> = angles
                .iter()
                .map(|angle| {
                    [
                        centre[0] + radius * angle.cos(),
                        centre[1] + radius * angle.sin(),
                    ]
                })
                .collect();
            let points = within(points, [low, high])
                .into_iter()
                .map(|p| [p[0] - centre[0], p[1] - centre[1]])
                .collect();
            let load = Load {
                name: format!("polygon {}", loads.len() + 1),
                shape: Shape::Polygon { points_mm: points },
                centre_mm: centre,
                turn_deg: 0.0,
                loss,
            };
            if load.check().is_ok() {
                loads.push(load);
            }
        }
        let seen = |load: &Load| load.coverage(mesh).is_ok_and(|covered| !covered.is_empty());
        loads.retain(seen);
        if !loads.is_empty() {
            return Pressed {
                mass: None,
                loads,
                disc: None,
            };
        }
    }
}

/// A convex polygon clipped by a box (Sutherland and Hodgman).
fn within(mut points: Vec<[f64; 2]>, [low, high]: [[f64; 2]; 2]) -> Vec<[f64; 2]> {
    for (axis, border, sign) in [
        (0, low[0], 1.0),
        (0, high[0], -1.0),
        (1, low[1], 1.0),
        (1, high[1], -1.0),
    ] {
        let depth = |p: &[f64; 2]| sign * (p[axis] - border);
        let count = points.len();
        let mut kept: Vec<[f64; 2]> = Vec::with_capacity(count + 1);
        for k in 0..count {
            let (p, q) = (points[(k + count - 1) % count], points[k]);
            if (depth(&p) >= 0.0) != (depth(&q) >= 0.0) {
                let share = depth(&p) / (depth(&p) - depth(&q));
                kept.push([0, 1].map(|i| p[i] + share * (q[i] - p[i])));
            }
            if depth(&q) >= 0.0 {
                kept.push(q);
            }
        }
        points = kept;
    }
    points.dedup_by(|a, b| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9);
    points
}
