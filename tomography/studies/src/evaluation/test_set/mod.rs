//! Test sets: a case folder with frames simulated on a finer, different mesh, and files with the truth.
//!
//! `reconstruct` reads mesh, contacts, protocol and `frames.csv` (baseline first); only `evaluate` reads `truth.csv`
//! and `presses.csv`.

mod loads;

use std::path::Path;
use std::time::Duration;

use clap::ValueEnum;
use eit::{Case, PaperSheet, Preset, frames_text, matrix_text};
use imaging::Geometry;
use nalgebra::DMatrix;
use outfile::Existing;
use phantom::{FINER, Load, Phantom, Scene, SpraySettings, across};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use serde_json::{Value, json};
use shards::{Division, Outcome, StopRequest, Study};
use survey::Amps;

use crate::build;
use crate::failure::{Attempt, Failure, write};
use crate::progress;
pub use loads::true_map;
use loads::{Pressed, check_extent, draw};
pub(crate) use loads::{bounds, polygons, press};

/// File with the description of a test set.
pub const DESCRIPTION: &str = "judged.json";
/// File with the positions of the presses, if every load is one disc.
pub const PRESSES: &str = "presses.csv";
/// Current of every reading, A.
const CURRENT: Amps = Amps(1e-3);
/// Description of a test set.
pub struct Description {
    /// Displayed name and noise of the set.
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
    /// Seed of loads and noise: equal seeds give equal folders. Training uses other random streams.
    pub seed: u64,
    /// Number of frames; default: that of the set. Sets with fixed loads refuse more than that.
    pub count: Option<usize>,
    /// Standard deviation of the logarithm of conductance of an unevenly sprayed sheet.
    pub spray: Option<f64>,
    /// Seed of the sheet, so that sets of different loads can have the same sheet; default: `seed`.
    pub sheet_seed: Option<u64>,
    /// The simulated sheet.
    pub sheet: PaperSheet,
    /// The case for the reconstruction: the sheet on another mesh than the phantom's; default: its preset at 1 mA.
    pub case: Option<Case>,
}

/// The sheet of a set and the loads of its frames, before the frames are solved.
struct Prepared {
    case: Case,
    phantom: Phantom,
    /// The random stream after the loads were drawn; the noise is drawn from it next.
    random: ChaCha8Rng,
    drawn: Vec<Pressed>,
}

/// A set in memory.
pub struct Frames {
    case: Case,
    /// The baseline, then the frames, V.
    frames: Vec<Vec<f64>>,
    truth: Vec<f64>,
    /// Text of [`PRESSES`]; `None` if a load is not a disc.
    presses: Option<String>,
    description: Value,
}

/// Creates the folder of a test set; returns the number of frames without the baseline.
///
/// # Errors
/// Invalid options, a case of another sheet, or files that exist and may not be replaced.
pub fn make(options: &TestSet, folder: &Path, existing: Existing) -> Result<usize, Failure> {
    match frames(options, &Division::Whole, &StopRequest::default())? {
        Outcome::All(frames) => frames.write(folder, existing),
        Outcome::Made(_) | Outcome::Missing(_) => unreachable!("the whole is no shard"),
    }
}

/// Solves the frames of a set. Each frame is an item of work in shards.
///
/// # Errors
/// Invalid options, a case of another sheet, or shards that cannot be used.
pub fn frames(
    options: &TestSet,
    division: &Division,
    stop: &StopRequest,
) -> Result<Outcome<Frames>, Failure> {
    let Prepared {
        case,
        mut phantom,
        random,
        drawn,
    } = Prepared::new(options)?;
    let noise = Normal::new(0.0, options.noise_v)
        .map_err(|_| Failure::usage("--noise-v must be a positive number"))?;
    let study = Study {
        name: "judge",
        settings: json!({
            "build": build(),
            "set": options.set.name(),
            "seed": options.seed,
            "count": drawn.len(),
            "noise_v": options.noise_v,
            "spray": options.spray,
            "sheet_seed": options.sheet_seed,
            "geometry": case.mesh.hash(),
            "survey": case.protocol.hash(),
            "currents": case.currents,
            "simulated_geometry": phantom.mesh().hash(),
        }),
        items: std::iter::once("baseline".to_owned())
            .chain((1..=drawn.len()).map(|frame| format!("frame {frame}")))
            .collect(),
    };
    let bar = progress::bar(study.items.len(), "frames");
    let outcome = study.perform(division, stop, &mut |item| {
        let loads = item.checked_sub(1).map(|frame| &drawn[frame].loads[..]);
        bar.inc(1);
        exact(&mut phantom, &case, loads.unwrap_or_default())
    })?;
    bar.finish_and_clear();
    outcome.then(|exact| Frames::new(options, case, &drawn, exact, noise, random))
}

/// The readings without noise, V.
fn exact(phantom: &mut Phantom, case: &Case, loads: &[Load]) -> Result<Vec<f64>, Failure> {
    let failed = |fault| Failure::of("the simulated sheet", &fault);
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
}

impl Prepared {
    fn new(options: &TestSet) -> Result<Self, Failure> {
        if !(options.noise_v >= 0.0 && options.noise_v.is_finite()) {
            return Err(Failure::usage(format!(
                "--noise-v {}: volts are expected, e.g. 2e-6, or 0",
                options.noise_v
            )));
        }
        if options.count == Some(0) {
            return Err(Failure::usage("--count 0: a set needs a frame"));
        }
        let fixed = match options.set {
            TestSetName::Test1 | TestSetName::Test2 | TestSetName::Sizes => options.set.usual(),
            _ => usize::MAX,
        };
        let count = options.count.unwrap_or(options.set.usual());
        if count > fixed {
            return Err(Failure::usage(format!(
                "--count {count}: the set {} has {fixed} frames at most",
                options.set.name()
            )));
        }
        let sheet = Preset::PaperSheet(options.sheet.clone());
        let case = match &options.case {
            Some(case) => case.clone(),
            None => Geometry::from_preset(&sheet)
                .map_err(|fault| Failure::because(survey::error_chain(&fault)))?
                .case(CURRENT)
                .attempt("no protocol for this number of electrodes")?,
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
        let phantom = Phantom::new(scene).map_err(failed)?;
        if phantom.electrodes() != case.mesh.electrodes()
            || phantom.mesh().hash() == case.mesh.hash()
        {
            return Err(Failure::because(
                "judging data come from the simulated sheet of the paper on its own finer mesh: the case must be that sheet on \
                 another mesh",
            ));
        }
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        random.set_stream(options.set as u64 + 1);
        let drawn: Vec<Pressed> = (0..count)
            .map(|k| draw(options.set, k, &case.mesh, &mut random))
            .collect();
        check_extent(options.set, &drawn, &case.mesh)?;
        Ok(Self {
            case,
            phantom,
            random,
            drawn,
        })
    }
}

impl Frames {
    /// Adds noise to the frames in their order, and computes the truth.
    fn new(
        options: &TestSet,
        case: Case,
        drawn: &[Pressed],
        exact: Vec<Vec<f64>>,
        noise: Normal<f64>,
        mut random: ChaCha8Rng,
    ) -> Result<Self, Failure> {
        let frames = exact
            .into_iter()
            .map(|volts| {
                volts
                    .into_iter()
                    .map(|volts| volts + noise.sample(&mut random))
                    .collect()
            })
            .collect();
        let mut truth = Vec::new();
        let mut presses = String::from("frame,x_m,y_m,diameter_m,loss,mass_kg\n");
        for (k, pressed) in drawn.iter().enumerate() {
            truth.extend(true_map(&case.mesh, &pressed.loads)?);
            if let Some(([x, y], diameter)) = pressed.disc {
                presses.push_str(&format!(
                    "{},{},{},{},{},{}\n",
                    // the baseline is frame 1
                    k + 2,
                    x * 1e-3,
                    y * 1e-3,
                    diameter * 1e-3,
                    pressed.loads[0].loss,
                    // blank if the mass is unknown
                    pressed.mass.map_or(String::new(), |mass| mass.to_string())
                ));
            }
        }
        let discs = drawn.iter().all(|pressed| pressed.disc.is_some());
        Ok(Self {
            case,
            frames,
            truth,
            presses: discs.then_some(presses),
            description: json!({
                "set": options.set.name(),
                "noise_v": options.noise_v,
                "seed": options.seed,
                "frames": drawn.len(),
            }),
        })
    }

    /// Writes the folder; returns the number of frames without the baseline.
    ///
    /// # Errors
    /// Files that exist and may not be replaced, or that cannot be written.
    pub fn write(&self, folder: &Path, existing: Existing) -> Result<usize, Failure> {
        let case = &self.case;
        case.write(folder, existing)
            .attempt("cannot write the case")?;
        let frames: Vec<Vec<Option<f64>>> = self
            .frames
            .iter()
            .map(|frame| frame.iter().copied().map(Some).collect())
            .collect();
        write(&folder.join("frames.csv"), existing, frames_text(&frames))?;
        let triangles = case.mesh.region().len();
        let truth = DMatrix::from_row_slice(self.truth.len() / triangles, triangles, &self.truth);
        write(&folder.join("truth.csv"), existing, matrix_text(&truth))?;
        match &self.presses {
            Some(presses) => write(&folder.join(PRESSES), existing, presses.clone())?,
            // the file of a replaced set does not belong to these loads
            None => outfile::remove(&folder.join(PRESSES), existing)?,
        }
        let description = format!("{}\n", self.description);
        write(&folder.join(DESCRIPTION), existing, description)?;
        Ok(self.frames.len() - 1)
    }
}
