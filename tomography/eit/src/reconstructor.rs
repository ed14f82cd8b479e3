//! The seam between voltages and maps: what every reconstructor promises, and how it refuses.

use std::sync::Arc;

use survey::{Map, Protocol, Reading};

use crate::Mesh;

/// Share of the readings that may be missing before a map is refused.
pub const MOST_MISSING: f64 = 0.25;

/// Turns a baseline and a frame into a map of the relative change of conductance.
pub trait Reconstructor: Send + Sync {
    /// The method as a person would name it.
    fn method(&self) -> &str;
    /// The questions whose answers it understands.
    fn protocol(&self) -> &Protocol;
    /// The mesh whose region the map covers.
    fn mesh(&self) -> &Arc<Mesh>;
    /// The map. Readings that are not valid in either are masked and counted in the map.
    ///
    /// # Errors
    /// A wrong count of readings, too many missing, a baseline or a frame that this method cannot judge.
    fn reconstruct(&self, baseline: &[Reading], frame: &[Reading])
    -> Result<Map, ReconstructError>;
}

/// Why there is no map.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReconstructError {
    /// Baseline or frame does not answer this protocol.
    #[error("the {what} has {has} readings, the {method} reconstruction needs {wants}")]
    Length {
        /// `baseline` or `frame`.
        what: &'static str,
        /// What it has.
        has: usize,
        /// What is needed.
        wants: usize,
        /// The method asked.
        method: String,
    },
    /// More readings are missing than [`MOST_MISSING`].
    #[error(
        "{missing} of {readings} readings are missing, more than a quarter: no map; look at the wiring and the range"
    )]
    TooManyMissing {
        /// Not valid in baseline or frame.
        missing: usize,
        /// Of so many.
        readings: usize,
    },
    /// All valid readings of the baseline are zero.
    #[error("the baseline is zero everywhere: no current flowed when it was recorded")]
    DeadBaseline,
    /// The baseline's readings have the opposite sign of the model's.
    #[error(
        "the baseline's readings have the opposite sign of this geometry's: reversed leads, or an instrument that \
         gives magnitudes (negate them)"
    )]
    OppositeSign,
    /// The input is far from everything the network was trained on.
    #[error(
        "the frame lies outside of what the model was trained on: distance to its nearest centre {novelty:.1} spreads, \
         limit {limit}"
    )]
    OutsideModel {
        /// Distance to the nearest centre over the spread b.
        novelty: f64,
        /// Beyond which nothing is said.
        limit: f64,
    },
    /// The numbers gave out.
    #[error("the {method} reconstruction failed on these readings: {cause}")]
    Numerical {
        /// The method.
        method: String,
        /// What failed.
        cause: String,
    },
}

/// Baseline and difference where both are valid, and what is missing.
pub(crate) struct Difference {
    /// Volts of the baseline, 0 where missing.
    pub(crate) baseline: Vec<f64>,
    /// Frame minus baseline in volts, 0 where missing.
    pub(crate) change: Vec<f64>,
    /// Indices of missing readings, ascending.
    pub(crate) missing: Vec<usize>,
}

impl Difference {
    /// Checks the counts, and masks what is not valid in both.
    pub(crate) fn new(
        baseline: &[Reading],
        frame: &[Reading],
        wants: usize,
        method: &str,
    ) -> Result<Self, ReconstructError> {
        for (what, has) in [("baseline", baseline.len()), ("frame", frame.len())] {
            if has != wants {
                return Err(ReconstructError::Length {
                    what,
                    has,
                    wants,
                    method: method.to_owned(),
                });
            }
        }
        let finite = |reading: Reading| {
            reading
                .volts()
                .map(|volts| volts.0)
                .filter(|volts| volts.is_finite())
        };
        let mut difference = Self {
            baseline: vec![0.0; wants],
            change: vec![0.0; wants],
            missing: Vec::new(),
        };
        for reading in 0..wants {
            match (finite(baseline[reading]), finite(frame[reading])) {
                (Some(before), Some(now)) => {
                    difference.baseline[reading] = before;
                    difference.change[reading] = now - before;
                }
                _ => difference.missing.push(reading),
            }
        }
        if difference.missing.len() as f64 > MOST_MISSING * wants as f64 {
            return Err(ReconstructError::TooManyMissing {
                missing: difference.missing.len(),
                readings: wants,
            });
        }
        if difference.baseline.iter().all(|volts| *volts == 0.0) {
            return Err(ReconstructError::DeadBaseline);
        }
        Ok(difference)
    }

    /// The factor by which the baseline exceeds the model's own, in the sense of least squares over valid readings.
    pub(crate) fn gain(&self, model: &[f64]) -> Result<f64, ReconstructError> {
        let mut missing = self.missing.iter().copied().peekable();
        let (mut cross, mut square) = (0.0, 0.0);
        for (reading, (&measured, &model)) in self.baseline.iter().zip(model).enumerate() {
            if missing.next_if_eq(&reading).is_none() {
                cross += measured * model;
                square += model * model;
            }
        }
        let gain = cross / square;
        if gain.is_finite() && gain > 0.0 {
            Ok(gain)
        } else {
            Err(ReconstructError::OppositeSign)
        }
    }
}
