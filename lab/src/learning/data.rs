//! Inputs of a training, from its options: the case, the noise, the set.

use std::path::Path;

use eit::{Case, Jitter, Model, Preset};
use imaging::recorded::read_frames;
use imaging::{Conditions, Geometry, months_of_drift};
use studies::Failure;
use survey::Amps;
use training::dataset::DataSet;
use training::samples::Samples;
use training::{linear, own_misfit, single_current};

use super::limits;
use crate::args::{DataOptions, Profile};
use crate::geometry;

/// Default gamma of the profile `paper`: that of the paper.
const GAMMA: f64 = 0.01;
/// Default noise of one reading of the other profiles, V.
const NOISE_V: &[f64] = &[2e-6];

/// The case, the noise and, if one is given, the set of a training.
pub(super) struct Data {
    pub(super) case: Case,
    pub(super) jitter: Jitter,
    pub(super) set: Option<DataSet>,
}

impl Data {
    /// Reads the files that the options name.
    pub(super) fn read(options: &DataOptions) -> Result<Self, Failure> {
        check_options(options)?;
        let case = match &options.case {
            Some(folder) => geometry::read(folder)?,
            None => geometry::case(&Preset::default(), Amps(1e-3))?,
        };
        let set = match &options.dataset {
            Some(folder) => Some(DataSet::open(folder, &case)?),
            None => None,
        };
        let levels = match &options.noise_v[..] {
            [] => NOISE_V,
            stated => stated,
        };
        let jitter = match (options.profile, &options.noise_frames) {
            (Profile::Paper, _) => Jitter::Paper {
                gamma: options.gamma.unwrap_or(GAMMA),
            },
            (Profile::Matched, Some(path)) => Jitter::Measured {
                volts: noise_frames(path, case.protocol.len())?,
                current_a: single_current(&case)?,
            },
            (Profile::Matched, None) => {
                let current = single_current(&case)?;
                let largest = largest_reading(&case, set.as_ref(), current)?;
                limits::check_noise(largest, levels, options.yes)?;
                linear::matched(levels, current)
            }
            (Profile::Months, _) => {
                let largest = largest_reading(&case, set.as_ref(), single_current(&case)?)?;
                limits::check_noise(largest, levels, options.yes)?;
                drifting(&case, levels)?
            }
        };
        Ok(Self { case, jitter, set })
    }

    /// Adds to the model its misfit, the share of a change that its maps leave unexplained, on unseen cases: on the
    /// last `held_out` cases of a recorded set, otherwise on simulated ones.
    pub(super) fn judged(&self, model: Model, held_out: usize) -> Result<Model, Failure> {
        let settings = self.set.as_ref().map(|set| set.settings());
        let drawn = settings.unwrap_or(&model.metadata().training).seed;
        Ok(match self.set.as_ref().filter(|set| set.is_recorded()) {
            Some(set) => {
                let first = set.len().saturating_sub(held_out);
                own_misfit::of_cases(model, &self.case, set, first..set.len())?
            }
            None => own_misfit::of_fresh_cases(model, &self.case, drawn)?,
        })
    }

    /// The set for a training; `None` if cases are simulated for it.
    pub(super) fn samples(&self) -> Option<&dyn Samples> {
        self.set.as_ref().map(|set| set as &dyn Samples)
    }
}

/// Refuses options that the profile would ignore.
fn check_options(options: &DataOptions) -> Result<(), Failure> {
    let refused = |option: &str, of: &str, advice: &str| {
        let profile = options.profile.name();
        Err(Failure::usage(format!(
            "{option} belongs to --profile {of} and does not apply to --profile {profile}; {advice}"
        )))
    };
    let levels = !options.noise_v.is_empty();
    let frames = options.noise_frames.is_some();
    match options.profile {
        Profile::Paper if levels => refused(
            "--noise-v",
            "matched and months",
            "give the jitter by --gamma",
        ),
        Profile::Paper if frames => {
            refused("--noise-frames", "matched", "give the jitter by --gamma")
        }
        Profile::Matched | Profile::Months if options.gamma.is_some() => {
            refused("--gamma", "paper", "give the noise by --noise-v")
        }
        Profile::Matched if levels && frames => Err(Failure::usage(
            "--noise-v and --noise-frames both set the noise of --profile matched; leave one of them out",
        )),
        Profile::Months if frames => refused(
            "--noise-frames",
            "matched",
            "give the noise by --noise-v: frames of an unloaded sheet contain its drift only if they span months",
        ),
        Profile::Paper | Profile::Matched | Profile::Months => Ok(()),
    }
}

/// The largest reading of the set's baseline, or of the case without a set, V.
fn largest_reading(case: &Case, set: Option<&DataSet>, current_a: f64) -> Result<f64, Failure> {
    match set {
        Some(set) => {
            let readings = set.baseline().iter();
            Ok(current_a * readings.fold(0.0_f64, |most, ohms| most.max(ohms.abs())))
        }
        None => limits::largest_reading(case),
    }
}

/// White noise of one level, and months of drift.
fn drifting(case: &Case, levels: &[f64]) -> Result<Jitter, Failure> {
    let &[noise_v] = levels else {
        return Err(Failure::usage("--profile months takes one --noise-v"));
    };
    let current_a = single_current(case)?;
    let geometry = Geometry::of_case(case, "the case".to_owned());
    let conditions = Conditions::live(&geometry, &case.protocol, Amps(current_a));
    Ok(Jitter::Drift {
        noise_v,
        current_a,
        drift_v: months_of_drift(&conditions, noise_v)
            .map_err(|fault| Failure::of("the drift of the sheet", &fault))?,
    })
}

/// Frames of the unloaded sheet, V; a frame with missing readings is an error.
fn noise_frames(path: &Path, readings: usize) -> Result<Vec<Vec<f64>>, Failure> {
    read_frames(path, readings, false)?
        .iter()
        .map(|(name, frame)| {
            frame
                .iter()
                .map(|reading| reading.volts().map(|volts| volts.0))
                .collect::<Option<Vec<f64>>>()
                .ok_or_else(|| {
                    Failure::because(format!(
                        "{}: frame '{name}' has missing readings",
                        path.display()
                    ))
                })
        })
        .collect()
}
