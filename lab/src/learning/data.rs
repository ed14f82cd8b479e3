//! Inputs of a training, from its options: the case, the noise, the set.

use std::path::Path;

use eit::{Case, Jitter, Preset};
use imaging::recorded::read_frames;
use studies::Failure;
use survey::Amps;
use training::dataset::DataSet;
use training::samples::Samples;
use training::{linear, single_current};

use super::limits;
use crate::args::{DataOptions, Profile};
use crate::geometry;

/// The case, the noise and the set of a training.
pub(super) struct Data {
    pub(super) case: Case,
    pub(super) jitter: Jitter,
    pub(super) set: Option<DataSet>,
}

impl Data {
    /// Reads the files that the options name.
    pub(super) fn read(options: &DataOptions) -> Result<Self, Failure> {
        let case = match &options.case {
            Some(folder) => geometry::read(folder)?,
            None => geometry::case(&Preset::default(), Amps(1e-3))?,
        };
        let set = match &options.dataset {
            Some(folder) => Some(DataSet::open(folder, &case)?),
            None => None,
        };
        let jitter = match (options.profile, &options.noise_frames) {
            (Profile::Paper, _) => Jitter::Paper {
                gamma: options.gamma,
            },
            (Profile::Matched, Some(path)) => Jitter::Measured {
                volts: noise_frames(path, case.protocol.len())?,
                current_a: single_current(&case)?,
            },
            (Profile::Matched, None) => {
                let current = single_current(&case)?;
                let largest = match &set {
                    Some(set) => {
                        let readings = set.baseline().iter();
                        current * readings.fold(0.0_f64, |most, ohms| most.max(ohms.abs()))
                    }
                    None => limits::largest_reading(&case)?,
                };
                limits::check_noise(largest, &options.noise_v, options.yes)?;
                linear::matched(&options.noise_v, current)
            }
        };
        Ok(Self { case, jitter, set })
    }

    /// The set for a training; `None` if cases are simulated for it.
    pub(super) fn samples(&self) -> Option<&dyn Samples> {
        self.set.as_ref().map(|set| set as &dyn Samples)
    }
}

/// Frames of the unloaded sheet, V; complete ones only.
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
