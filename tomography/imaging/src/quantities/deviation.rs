//! Standard deviations of quantities by noise: of the readings, and of the tracked baseline.

use std::sync::Arc;

use eit::{Calibration, Mesh, Pressure};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use survey::{Map, Reading, Volts};

use super::quantity::{Quantity, Values};
use crate::map_noise::noisy;
use crate::model::Model;

/// Number of noisy maps. A standard deviation of 16 draws has a standard error of 18 %.
const DRAWS: usize = 16;
/// Largest deviation from linearity, as a share of the largest value.
const LINEAR: f64 = 1e-6;

/// Maps of noise alone, for a linear method: a map plus one of them is the map of a noisier frame.
///
/// The noise of readings is taken as independent. Included: noise of the readings and of the tracked baseline. Not included:
/// the error of the method (blur, inhomogeneity of the sheet) and that of the calibration.
#[derive(Debug, Clone)]
pub struct Deviation {
    mesh: Arc<Mesh>,
    calibration: Option<Arc<Calibration>>,
    /// Map of noise for each draw.
    draws: Vec<Vec<f64>>,
    /// Standard deviation of one reading in them, V.
    noise_v: f64,
}

impl Deviation {
    /// `noise_v`: standard deviation of one reading, in the unit of the baseline. `None` for a method that is not linear, or
    /// that makes no map of an unloaded sheet.
    pub fn new(model: &Model, baseline: &[Reading], noise_v: f64) -> Option<Self> {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let map = |frame: &[Reading]| {
            let map = model.reconstructor.reconstruct(baseline, frame).ok()?;
            Some(map.values)
        };
        let frames: Vec<Vec<Reading>> = (0..DRAWS)
            .map(|_| noisy(baseline, noise_v, &mut random))
            .collect();
        let draws = frames
            .iter()
            .map(|frame| map(frame))
            .collect::<Option<Vec<_>>>()?;
        let sum: Vec<Reading> = (0..baseline.len())
            .map(|k| match (baseline[k], frames[0][k], frames[1][k]) {
                (Reading::Ok(b), Reading::Ok(first), Reading::Ok(second)) => {
                    Reading::Ok(Volts(first.0 + second.0 - b.0))
                }
                (other, _, _) => other,
            })
            .collect();
        let of_sum = map(&sum)?;
        let largest = of_sum
            .iter()
            .fold(0.0_f64, |most, value| most.max(value.abs()));
        let linear = |t: usize| (of_sum[t] - draws[0][t] - draws[1][t]).abs() <= LINEAR * largest;
        (largest > 0.0 && (0..of_sum.len()).all(linear)).then(|| Self {
            mesh: Arc::clone(model.reconstructor.mesh()),
            calibration: model.calibration.clone(),
            draws,
            noise_v,
        })
    }

    /// Standard deviations of what `quantities` computes of a map (and of its pressure), for each of `regions`.
    /// `baseline_sd`: standard deviation of the tracked baseline, in the unit of the baseline.
    pub(super) fn of(
        &self,
        map: &Map,
        baseline_sd: f64,
        regions: usize,
        quantities: impl Fn(&Map, Option<&Pressure>) -> Vec<Values>,
    ) -> Vec<Values> {
        let scale = (1.0 + (baseline_sd / self.noise_v).powi(2)).sqrt();
        let mut drawn: Vec<Vec<Values>> = Vec::with_capacity(self.draws.len());
        let mut noisier = map.clone();
        for noise in &self.draws {
            for (triangle, value) in noisier.values.iter_mut().enumerate() {
                *value = map.values[triangle] + scale * noise[triangle];
            }
            let pressure = match &self.calibration {
                None => None,
                Some(calibration) => match calibration.pressure(&self.mesh, &noisier) {
                    Ok(pressure) => Some(pressure),
                    Err(_) => return vec![Values::default(); regions],
                },
            };
            drawn.push(quantities(&noisier, pressure.as_ref()));
        }
        (0..regions)
            .map(|region| {
                let mut deviations = Values::default();
                for quantity in Quantity::ALL {
                    let of_draws: Option<Vec<f64>> = drawn
                        .iter()
                        .map(|draw| draw[region].get(quantity))
                        .collect();
                    deviations.set(quantity, of_draws.map(|values| deviation(&values)));
                }
                deviations
            })
            .collect()
    }
}

fn deviation(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (count - 1.0)).sqrt()
}
