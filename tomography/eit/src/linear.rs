//! The linear model of a difference: sensitivity, prior, the baseline's scale; and how probable it makes a recording.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use survey::{Protocol, Reading};

use crate::one_step::{OneStepError, OneStepOptions, Scale};
use crate::prior::{Penalty, Prior};
use crate::reconstructor::Difference;
use crate::{Forward, Mesh, ReconstructError, dense};

/// How readings become the data of a linear problem.
pub(crate) struct Linear {
    scale: Scale,
    /// Readings of the model at 1 A.
    model: Vec<f64>,
    /// Distance round the ring between driving and sensing pair of each reading.
    distances: Vec<usize>,
    /// 1 over the deviation of each reading, root mean square 1.
    weights: Option<Vec<f64>>,
}

impl Linear {
    /// Solves the forward model at `sigma0`. Gives the sensitivity to relative changes of the region too, and the prior.
    pub(crate) fn new(
        mesh: &Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        options: &OneStepOptions,
    ) -> Result<(Self, DMatrix<f64>, Penalty), OneStepError> {
        let forward = Forward::new(Arc::clone(mesh), contact_ohm_m)?;
        let model = forward.readings(sigma0, protocol)?;
        let absolute = forward.jacobian(sigma0, protocol)?;
        let region = mesh.region();
        let mut sensitivity = DMatrix::from_fn(protocol.len(), region.len(), |reading, unknown| {
            absolute[(reading, region[unknown])] * sigma0[region[unknown]]
        });
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
        if let Scale::Currents(currents) = &options.scale {
            counted("currents", currents.len())?;
            scale_rows(&mut sensitivity, currents);
        }
        let weights = match &options.deviations {
            None => None,
            Some(deviations) => {
                counted("deviations", deviations.len())?;
                Some(weights(deviations)?)
            }
        };
        if let Some(weights) = &weights {
            scale_rows(&mut sensitivity, weights);
        }
        let penalty = match options.prior {
            Prior::Tikhonov => Penalty::identity(region.len()),
            Prior::Noser { p } => Penalty::noser(&sensitivity, p),
            Prior::Laplace => Penalty::laplacian(mesh),
            Prior::Variation => Penalty::variation(mesh),
        };
        let linear = Self {
            scale: options.scale.clone(),
            model: model.as_slice().to_vec(),
            distances: distances(protocol),
            weights,
        };
        Ok((linear, sensitivity, penalty))
    }

    /// The largest magnitude of the model's readings, as the data are: the paper's v-hat.
    pub(crate) fn largest(&self) -> f64 {
        let currents = match &self.scale {
            Scale::Currents(currents) => Some(currents),
            Scale::Uniform | Scale::ByDistance => None,
        };
        self.model
            .iter()
            .enumerate()
            .map(|(i, v)| currents.map_or(v.abs(), |currents| (v * currents[i]).abs()))
            .fold(0.0, f64::max)
    }

    /// The change between baseline and frame at the model's scale, and which readings are missing in it.
    pub(crate) fn change(
        &self,
        baseline: &[Reading],
        frame: &[Reading],
        method: &str,
    ) -> Result<(Vec<f64>, Vec<usize>), ReconstructError> {
        let mut difference = Difference::new(baseline, frame, self.model.len(), method)?;
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

/// The lambda that makes recorded frames most probable, for a recording whose noise nobody knows: with x ~ N(0, g^2 R^-1)
/// and white noise s, a change is N(0, g^2 J R^-1 J' + s^2 I); each frame has its own g, all share lambda = s / g. What the
/// model does not explain counts as noise. Frames with missing readings, and those without any change, are left out;
/// `None` when no other is left. It is searched from 3e-4 of the largest singular value of J R^-1/2 up.
///
/// # Errors
/// As [`crate::OneStep::new`]; `options.hyper` is not looked at.
pub fn probable_lambda(
    mesh: &Arc<Mesh>,
    contact_ohm_m: &[f64],
    sigma0: &[f64],
    protocol: &Protocol,
    options: &OneStepOptions,
    baseline: &[Reading],
    frames: &[&[Reading]],
) -> Result<Option<f64>, OneStepError> {
    const STEPS_A_DECADE: i32 = 10;
    // of lambda squared, below the largest eigenvalue: the linear model is not exact to more (MODEL_SHARE)
    const DECADES: i32 = -7;
    let (linear, sensitivity, penalty) =
        Linear::new(mesh, contact_ohm_m, sigma0, protocol, options)?;
    let spread = penalty
        .inverse_times_transposed(&sensitivity)
        .ok_or(OneStepError::Prior)?;
    let gram = dense::product(dense::view(&sensitivity), dense::view(&spread));
    let (values, vectors) = dense::symmetric_eigen(&gram).ok_or(OneStepError::Prior)?;
    let squares: Vec<DVector<f64>> = frames
        .iter()
        .filter_map(|frame| linear.change(baseline, frame, "one-step").ok())
        .filter(|(change, missing)| missing.is_empty() && change.iter().any(|c| *c != 0.0))
        .map(|(change, _)| {
            vectors
                .tr_mul(&DVector::from_vec(change))
                .map(|along| along * along)
        })
        .collect();
    if squares.is_empty() {
        return Ok(None);
    }
    let top = values.iter().copied().fold(0.0, f64::max);
    // minus twice the logarithm of the probability, up to a constant, with every g at its best
    let surprise = |square: f64| -> f64 {
        let variance: Vec<f64> = values.iter().map(|value| value.max(0.0) + square).collect();
        let logs: f64 = variance.iter().map(|variance| variance.ln()).sum();
        squares
            .iter()
            .map(|squares| {
                let sum: f64 = squares.iter().zip(&variance).map(|(c, v)| c / v).sum();
                variance.len() as f64 * sum.ln() + logs
            })
            .sum()
    };
    let best = (DECADES * STEPS_A_DECADE..=0)
        .map(|step| top * 10_f64.powf(f64::from(step) / f64::from(STEPS_A_DECADE)))
        .map(|square| (square, surprise(square)))
        .min_by(|a, b| a.1.total_cmp(&b.1));
    Ok(best.map(|(square, _)| square.sqrt()))
}

/// Distance round the ring from each reading's driving to its sensing pair, the same for reciprocal twins.
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
    if let Some(&value) = deviations
        .iter()
        .find(|value| !(**value > 0.0 && value.is_finite()))
    {
        return Err(OneStepError::NotPositive {
            what: "deviation of a reading",
            value,
        });
    }
    let square: f64 = deviations.iter().map(|value| value * value).sum();
    let scale = (square / deviations.len() as f64).sqrt();
    Ok(deviations.iter().map(|value| scale / value).collect())
}

/// Multiplies row i by factor i.
fn scale_rows(matrix: &mut DMatrix<f64>, factors: &[f64]) {
    for mut column in matrix.column_iter_mut() {
        for (value, factor) in column.iter_mut().zip(factors) {
            *value *= factor;
        }
    }
}
