//! The linear model of a difference: sensitivity, prior, scale of the baseline.

use std::sync::Arc;

use nalgebra::DMatrix;
use survey::{Protocol, Reading};

use crate::inverse::error::OneStepError;
use crate::inverse::options::{OneStepOptions, Scale};
use crate::inverse::prior::{LAPLACE_WEIGHT, Penalty, Prior, outside};
use crate::inverse::reciprocity::Fold;
use crate::inverse::reconstructor::Difference;
use crate::{Forward, Mesh, Parameters, ReconstructError};

/// Converts readings to the data of a linear problem.
pub(crate) struct Linear {
    scale: Scale,
    /// Readings of the model at 1 A.
    model: Vec<f64>,
    /// Distance round the ring between driving and sensing pair of each reading.
    distances: Vec<usize>,
    /// The reciprocal twin of each reading.
    twins: Vec<Option<usize>>,
    /// 1 over the deviation of each reading, scaled to root mean square 1.
    weights: Option<Vec<f64>>,
    /// Folds reciprocal twins into one row.
    pub(crate) fold: Fold,
}

impl Linear {
    /// Solves the forward model at `sigma0`. Also returns the sensitivity to relative changes of the region (a row for
    /// each folded reading), and the prior.
    pub(crate) fn new(
        mesh: &Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        options: &OneStepOptions,
    ) -> Result<(Self, DMatrix<f64>, Penalty), OneStepError> {
        let forward = Forward::new(Arc::clone(mesh), contact_ohm_m)?;
        let linear = Self::without_sensitivity(&forward, sigma0, protocol, options)?;
        let half = linear.fold.half(protocol)?;
        let relative = Parameters::region().logarithmic();
        let mut sensitivity = forward.sensitivity(sigma0, &half, &relative)?;
        scale_rows(&mut sensitivity, linear.fold.norm());
        let mut penalty = match options.prior {
            Prior::Tikhonov => Penalty::identity(sensitivity.ncols()),
            Prior::Noser { p } => Penalty::noser(&sensitivity, p),
            Prior::Laplace => Penalty::of_borders(mesh, |_| LAPLACE_WEIGHT),
            Prior::Variation => Penalty::of_borders(mesh, |length| length * length),
            Prior::Gaussian { length_m } => Penalty::smooth(mesh, length_m)?,
        };
        penalty.weigh(&outside(options.shown.as_deref(), sensitivity.ncols()));
        Ok((linear, sensitivity, penalty))
    }

    /// Solves the forward model at `sigma0`, for the readings alone.
    pub(crate) fn without_sensitivity(
        forward: &Forward,
        sigma0: &[f64],
        protocol: &Protocol,
        options: &OneStepOptions,
    ) -> Result<Self, OneStepError> {
        let model = forward.readings(sigma0, protocol)?;
        let counted = |what, has: usize| {
            if has == protocol.len() {
                Ok(())
            } else {
                Err(OneStepError::Count {
                    what,
                    has,
                    wants: protocol.len(),
                })
            }
        };
        let mut factors = vec![1.0; protocol.len()];
        if let Scale::Currents(currents) = &options.scale {
            counted("currents", currents.len())?;
            factors.copy_from_slice(currents);
        }
        let weights = match &options.deviations {
            None => None,
            Some(deviations) => {
                counted("deviations", deviations.len())?;
                Some(weights(deviations)?)
            }
        };
        let twins = equal_twins(protocol, &factors);
        for (factor, weight) in factors.iter_mut().zip(weights.iter().flatten()) {
            *factor *= weight;
        }
        Ok(Self {
            scale: options.scale.clone(),
            model: model.as_slice().to_vec(),
            distances: distances(protocol),
            twins,
            weights,
            fold: Fold::new(protocol, &factors),
        })
    }

    /// The model's readings in the scale of the data.
    pub(crate) fn readings(&self) -> Vec<f64> {
        match &self.scale {
            Scale::Currents(currents) => {
                let both = self.model.iter().zip(currents);
                both.map(|(ohms, amps)| ohms * amps).collect()
            }
            Scale::Uniform | Scale::ByDistance => self.model.clone(),
        }
    }

    /// The change from the model's readings to others at 1 A (V), in the scale of the data without weights.
    pub(crate) fn change_to(&self, ohms: &[f64]) -> Vec<f64> {
        let change = ohms
            .iter()
            .zip(&self.model)
            .map(|(after, before)| after - before);
        match &self.scale {
            Scale::Currents(currents) => change
                .zip(currents)
                .map(|(ohms, amps)| ohms * amps)
                .collect(),
            Scale::Uniform | Scale::ByDistance => change.collect(),
        }
    }

    /// The largest magnitude of the model's readings, in the scale of the data: the paper's v-hat.
    pub(crate) fn largest(&self) -> f64 {
        self.readings().iter().fold(0.0, |top, v| v.abs().max(top))
    }

    /// The change between baseline and frame at the model's scale, and the indices of missing readings.
    pub(crate) fn change(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
        method: &str,
    ) -> Result<(Vec<f64>, Vec<usize>), ReconstructError> {
        self.difference(baseline, frame, &self.twins, method)
    }

    /// The same without masking readings that contradict their twins: for estimating the deviation of readings from the
    /// model.
    pub(crate) fn change_as_read(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
        method: &str,
    ) -> Result<(Vec<f64>, Vec<usize>), ReconstructError> {
        self.difference(baseline, frame, &vec![None; self.twins.len()], method)
    }

    fn difference(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
        twins: &[Option<usize>],
        method: &str,
    ) -> Result<(Vec<f64>, Vec<usize>), ReconstructError> {
        let mut difference = Difference::new(baseline, frame, twins, Some(&self.model), method)?;
        match self.scale {
            Scale::Currents(_) => {}
            Scale::Uniform => difference.scale(&self.model, None)?,
            Scale::ByDistance => difference.scale(&self.model, Some(&self.distances))?,
        }
        if let Some(weights) = &self.weights {
            for (value, weight) in difference.change.iter_mut().zip(weights) {
                *value *= weight;
            }
        }
        Ok((difference.change, difference.missing))
    }
}

/// The twins, if all readings have the same current; otherwise none, because twins are then not directly comparable.
fn equal_twins(protocol: &Protocol, currents: &[f64]) -> Vec<Option<usize>> {
    if currents.iter().all(|current| *current == currents[0]) {
        protocol.reciprocal_twins()
    } else {
        vec![None; currents.len()]
    }
}

/// Distance round the ring between each reading's driving and sensing pair, the same for reciprocal twins.
fn distances(protocol: &Protocol) -> Vec<usize> {
    let ring = protocol.electrodes();
    protocol
        .measurements()
        .iter()
        .map(|question| {
            let ahead = (ring + question.sense.plus.0 - question.drive.plus.0) % ring;
            ahead.min(ring - ahead)
        })
        .collect()
}

/// 1 / deviation, scaled so that the deviations have a root mean square of 1.
fn weights(deviations: &[f64]) -> Result<Vec<f64>, OneStepError> {
    for &value in deviations {
        OneStepError::positive("deviation of a reading", value)?;
    }
    let square: f64 = deviations.iter().map(|value| value * value).sum();
    let scale = (square / deviations.len() as f64).sqrt();
    Ok(deviations.iter().map(|value| scale / value).collect())
}

/// Multiplies row i by factor i.
pub(crate) fn scale_rows(matrix: &mut DMatrix<f64>, factors: &[f64]) {
    for mut column in matrix.column_iter_mut() {
        for (value, factor) in column.iter_mut().zip(factors) {
            *value *= factor;
        }
    }
}
