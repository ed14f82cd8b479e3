//! Standard deviations of quantities by noise: of the readings, and of the tracked baseline.

use eit::{Mesh, Pressure};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use survey::{Map, Reading};

use super::quantity::{Quantity, Values};
use crate::map_noise::noisy;
use crate::model::Model;

/// Number of noisy copies of a frame. A standard deviation of 16 draws has a standard error of 18 %.
const DRAWS: usize = 16;

/// Reconstructs noisy copies of each frame.
///
/// The noise of readings is taken as independent. Included: noise of the readings and of the tracked baseline. Not included:
/// the error of the method (blur, inhomogeneity of the sheet) and that of the calibration.
#[derive(Clone)]
pub struct Deviation {
    model: Model,
    /// Standard deviation of one reading, in the unit of the readings.
    noise_v: f64,
}

/// A frame with the baseline that it is compared with.
#[derive(Debug, Clone, Copy)]
pub struct ComparedReadings<'a> {
    /// The unloaded sheet.
    pub baseline: &'a [Reading],
    /// The frame.
    pub readings: &'a [Reading],
}

impl Deviation {
    /// `noise_v`: standard deviation of one reading, in the unit of the readings.
    pub fn new(model: &Model, noise_v: f64) -> Self {
        Self {
            model: model.clone(),
            noise_v,
        }
    }

    /// Standard deviations of what `quantities` computes of a map (and of its pressure), for each of `regions`; none for a
    /// quantity that does not exist in one of the noisy maps. `baseline_sd`: standard deviation of the tracked baseline.
    pub(super) fn of(
        &self,
        frame: ComparedReadings<'_>,
        baseline_sd: f64,
        regions: usize,
        quantities: impl Fn(&Map, Option<&Pressure>) -> Vec<Values>,
    ) -> Vec<Values> {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let noise_v = self.noise_v.hypot(baseline_sd);
        let drawn: Option<Vec<Vec<Values>>> = (0..DRAWS)
            .map(|_| {
                let readings = noisy(frame.readings, noise_v, &mut random);
                let reconstructor = &self.model.reconstructor;
                let map = reconstructor.reconstruct(frame.baseline, &readings).ok()?;
                let pressure = self.pressure(reconstructor.mesh(), &map)?;
                Some(quantities(&map, pressure.as_ref()))
            })
            .collect();
        let Some(drawn) = drawn else {
            return vec![Values::default(); regions];
        };
        (0..regions)
            .map(|region| {
                let mut deviations = Values::default();
                for quantity in Quantity::ALL {
                    let values: Option<Vec<f64>> = drawn
                        .iter()
                        .map(|draw| draw[region].get(quantity))
                        .collect();
                    deviations.set(quantity, values.map(|values| deviation(&values)));
                }
                deviations
            })
            .collect()
    }

    /// The map as pressure, if the model is calibrated; `None` where the calibration refuses it.
    fn pressure(&self, mesh: &Mesh, map: &Map) -> Option<Option<Pressure>> {
        match &self.model.calibration {
            None => Some(None),
            Some(calibration) => calibration.pressure(mesh, map).ok().map(Some),
        }
    }
}

fn deviation(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (count - 1.0)).sqrt()
}
