//! The interface from voltages to maps, and its errors.

use std::sync::Arc;

use survey::{Map, Protocol, Reading};

use crate::Mesh;
use crate::metrics::median;

/// If the factor of a distance differs from the uniform one by more than this factor, the uniform one is used.
pub const LARGEST_SCALE_RATIO: f64 = 4.0;

/// Share of the readings that may be missing before a method with a model of the sheet refuses a map: three faulty
/// electrodes of 26 cause 43 %.
pub const MOST_MISSING: f64 = 0.5;

/// The corresponding share for a trained method, which replaces missing readings by other values.
pub const MOST_MISSING_TRAINED: f64 = 0.25;

/// Reciprocal twins that differ by more than this share of the larger cannot both be right, whatever the noise and
/// loads.
const CONTRADICTED: f64 = 0.9;

/// Turns a baseline and a frame into a map of the relative change of conductance.
pub trait Reconstructor: Send + Sync {
    /// The method's user-readable name.
    fn method(&self) -> &str;
    /// The protocol whose readings it takes.
    fn protocol(&self) -> &Protocol;
    /// The mesh whose region the map covers.
    fn mesh(&self) -> &Arc<Mesh>;
    /// The map. Readings that are not valid in either are masked and counted in the map.
    ///
    /// # Errors
    /// A wrong count of readings, too many missing, or a baseline or frame outside the method's domain.
    fn reconstruct(&self, baseline: &[Reading], frame: &[Reading])
    -> Result<Map, ReconstructError>;
    /// User-readable assumptions and accuracy of the method, one sentence each: prior, hyper-parameter and its source,
    /// noise, bounds, training set, stated errors. May be empty.
    fn assumptions(&self) -> Vec<String> {
        Vec::new()
    }
    /// The noise figure: signal-to-noise ratio of the readings over that of the map, for a small load in the middle of
    /// the region. Below 1 the method averages noise away, at the price of sharpness. `None` if it is not defined. May
    /// take a second: a nonlinear method estimates it from seeded draws of noise.
    fn noise_figure(&self) -> Option<f64> {
        None
    }
    /// Distance of these readings from those that the method can explain or was trained on; `None` if the method has no
    /// such measure.
    ///
    /// # Errors
    /// As [`Reconstructor::reconstruct`] before the reconstruction: counts, missing readings, a dead baseline.
    fn novelty(
        &self,
        _baseline: &[Reading],
        _frame: &[Reading],
    ) -> Result<Option<Novelty>, ReconstructError> {
        Ok(None)
    }
}

/// Distance of a frame from the data that a method expects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Novelty {
    /// The distance, at least 0; `measure` describes its unit.
    pub value: f64,
    /// The frame is outside the method's domain above this value.
    pub limit: f64,
    /// User-readable description of the measure. Model-based methods: root mean square of the part that no map
    /// explains, in standard deviations of the noise. Networks: distance from their training inputs.
    pub measure: &'static str,
}

impl Novelty {
    /// Whether the frame is outside the method's domain; true for NaN.
    pub fn outside(&self) -> bool {
        self.value.is_nan() || self.value > self.limit
    }
}

/// Errors of a reconstruction.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ReconstructError {
    /// Baseline or frame does not have one reading per measurement of the protocol.
    #[error("the {what} has {has} readings, the {method} reconstruction needs {wants}")]
    Length {
        /// `baseline` or `frame`.
        what: &'static str,
        /// Number of readings.
        has: usize,
        /// Number required.
        wants: usize,
        /// The method.
        method: String,
    },
    /// More readings are missing than [`MOST_MISSING`] or [`MOST_MISSING_TRAINED`].
    #[error(
        "{missing} of {readings} readings are missing, more than {most_percent:.0} %: no map; check the wiring and the range"
    )]
    TooManyMissing {
        /// Readings that are not valid in baseline or frame.
        missing: usize,
        /// Readings in all.
        readings: usize,
        /// Largest share of them that may be missing, %.
        most_percent: f64,
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
        "the frame is unlike the training data of the model: novelty {novelty:.1}, limit {limit}; record a new \
         baseline, or train with loads and noise like these"
    )]
    OutsideModel {
        /// Distance of the input, in the measure of the model's kind.
        novelty: f64,
        /// The limit.
        limit: f64,
    },
    /// The computation failed numerically.
    #[error("the {method} reconstruction failed on these readings: {cause}")]
    Numerical {
        /// The method.
        method: String,
        /// What failed.
        cause: String,
    },
}

/// Baseline and change of the readings valid in both, and the missing ones.
pub(crate) struct Difference {
    /// Volts of the baseline, 0 where missing.
    pub(crate) baseline: Vec<f64>,
    /// Frame minus baseline in volts, 0 where missing.
    pub(crate) change: Vec<f64>,
    /// Indices of missing readings, ascending.
    pub(crate) missing: Vec<usize>,
}

impl Difference {
    /// Checks the counts and masks readings that are not valid in both, or contradict reciprocity: of two twins that
    /// differ by more than [`CONTRADICTED`] of the larger, unless that is a small reading, the one farther from the
    /// model's is masked (both if there is no model). Otherwise one bad channel would determine the scale of all.
    pub(crate) fn new(
        baseline: &[Reading],
        frame: &[Reading],
        twins: &[Option<usize>],
        model: Option<&[f64]>,
        method: &str,
    ) -> Result<Self, ReconstructError> {
        let wants = twins.len();
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
        difference.mask_contradictions(twins, model);
        let most = match model {
            Some(_) => MOST_MISSING,
            None => MOST_MISSING_TRAINED,
        };
        if difference.missing.len() as f64 > most * wants as f64 {
            return Err(ReconstructError::TooManyMissing {
                missing: difference.missing.len(),
                readings: wants,
                most_percent: 100.0 * most,
            });
        }
        if difference.baseline.iter().all(|volts| *volts == 0.0) {
            return Err(ReconstructError::DeadBaseline);
        }
        Ok(difference)
    }

    fn mask_contradictions(&mut self, twins: &[Option<usize>], model: Option<&[f64]>) {
        let after: Vec<f64> = self
            .baseline
            .iter()
            .zip(&self.change)
            .map(|(before, change)| before + change)
            .collect();
        let mut wrong = contradictions(&self.baseline, &self.missing, twins, model);
        wrong.extend(contradictions(&after, &self.missing, twins, model));
        for &reading in &wrong {
            self.baseline[reading] = 0.0;
            self.change[reading] = 0.0;
        }
        self.missing.append(&mut wrong);
        self.missing.sort_unstable();
        self.missing.dedup();
    }

    /// Eq. 6: the change over the largest reading of the baseline. A missing reading is replaced by its valid
    /// reciprocal twin; the indices of those without one are returned too.
    pub(crate) fn normalised(mut self, twins: &[Option<usize>]) -> (Vec<f64>, Vec<usize>) {
        let top = self
            .baseline
            .iter()
            .fold(0.0_f64, |top, v| top.max(v.abs()));
        let left = self
            .missing
            .iter()
            .copied()
            .filter(|&reading| match twins[reading] {
                Some(twin) if self.missing.binary_search(&twin).is_err() => {
                    self.change[reading] = self.change[twin];
                    false
                }
                _ => true,
            })
            .collect();
        for value in &mut self.change {
            *value /= top;
        }
        (self.change, left)
    }

    /// Scales the change to the model: divides it by the factor between baseline and model. There is one factor for all
    /// readings, or one per group if that stays within [`LARGEST_SCALE_RATIO`] of the common one.
    pub(crate) fn scale(
        &mut self,
        model: &[f64],
        groups: Option<&[usize]>,
    ) -> Result<(), ReconstructError> {
        let mut valid = vec![true; model.len()];
        for &reading in &self.missing {
            valid[reading] = false;
        }
        let count = groups.map_or(0, |groups| groups.iter().max().map_or(0, |top| top + 1));
        // sums of products and squares of each group; those of all readings are last
        let mut sums = vec![[0.0; 2]; count + 1];
        for reading in (0..model.len()).filter(|&reading| valid[reading]) {
            let group = groups.map(|groups| groups[reading]);
            for slot in group.into_iter().chain([count]) {
                sums[slot][0] += self.baseline[reading] * model[reading];
                sums[slot][1] += model[reading] * model[reading];
            }
        }
        let uniform = sums[count][0] / sums[count][1];
        if !(uniform.is_finite() && uniform > 0.0) {
            return Err(ReconstructError::OppositeSign);
        }
        for (reading, change) in self.change.iter_mut().enumerate() {
            let own = groups
                .map(|groups| sums[groups[reading]])
                .map(|[cross, square]| cross / square)
                .filter(|own| {
                    (LARGEST_SCALE_RATIO.recip()..=LARGEST_SCALE_RATIO).contains(&(own / uniform))
                });
            *change /= own.unwrap_or(uniform);
        }
        Ok(())
    }
}

/// Readings that contradict their twins.
fn contradictions(
    volts: &[f64],
    missing: &[usize],
    twins: &[Option<usize>],
    model: Option<&[f64]>,
) -> Vec<usize> {
    let valid = |reading: usize| missing.binary_search(&reading).is_err();
    let top = |[twin, reading]: [usize; 2]| volts[twin].abs().max(volts[reading].abs());
    let mut doubtful: Vec<[usize; 2]> = twins
        .iter()
        .enumerate()
        .filter_map(|(reading, twin)| Some([(*twin)?, reading]))
        .filter(|&[twin, reading]| {
            twin < reading
                && (volts[twin] - volts[reading]).abs() > CONTRADICTED * top([twin, reading])
                && valid(twin)
                && valid(reading)
        })
        .collect();
    // the following steps are slow compared with a fast frame, and seldom needed
    if doubtful.is_empty() {
        return Vec::new();
    }
    let mut sizes: Vec<f64> = (0..volts.len())
        .filter(|&reading| valid(reading))
        .map(|reading| volts[reading].abs())
        .collect();
    let usual = median(&mut sizes);
    doubtful.retain(|&pair| top(pair) > usual);
    let Some(model) = model.filter(|_| !doubtful.is_empty()) else {
        return doubtful.into_flattened();
    };
    let mut ratios: Vec<f64> = (0..volts.len())
        .filter(|&reading| valid(reading) && model[reading] != 0.0)
        .map(|reading| volts[reading] / model[reading])
        .collect();
    let scale = median(&mut ratios);
    let far = |reading: usize| (volts[reading] - scale * model[reading]).abs();
    doubtful
        .into_iter()
        .map(|[twin, reading]| {
            if far(twin) > far(reading) {
                twin
            } else {
                reading
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use crate::inverse::reconstructor::*;

    const MODEL: [f64; 6] = [1.0, 1.0, 0.5, 0.5, 0.1, 0.1];
    const TWINS: [Option<usize>; 6] = [Some(1), Some(0), Some(3), Some(2), Some(5), Some(4)];

    fn wrong(change: impl Fn(&mut [f64]), model: Option<&[f64]>) -> Vec<usize> {
        let mut volts = MODEL.map(|v| 2e-3 * v);
        change(&mut volts);
        contradictions(&volts, &[], &TWINS, model)
    }

    #[test]
    fn model_finds_the_wrong_one_of_contradicting_twins() {
        assert!(wrong(|_| (), Some(&MODEL)).is_empty());
        assert_eq!(wrong(|v| v[3] *= 100.0, Some(&MODEL)), [3]);
        assert_eq!(wrong(|v| v[1] = 0.0, Some(&MODEL)), [1]);
        assert_eq!(wrong(|v| v[0] *= -1.0, Some(&MODEL)), [0]);
        assert_eq!(wrong(|v| v[3] *= 100.0, None), [2, 3]);
    }

    #[test]
    fn loads_noise_and_small_readings_are_no_contradiction() {
        assert!(wrong(|v| v[0] *= 5.0, Some(&MODEL)).is_empty());
        assert!(wrong(|v| v[4] = 0.0, Some(&MODEL)).is_empty());
        let lonely = contradictions(&[1.0, 100.0], &[], &[None, None], Some(&[1.0, 1.0]));
        assert!(lonely.is_empty());
    }
}
