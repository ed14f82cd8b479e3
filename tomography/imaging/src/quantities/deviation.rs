//! Standard deviations of quantities by noise: of the readings, and of the tracked baseline.

use eit::{Calibration, Mesh, Pressure};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::{Map, Reading};

use super::quantity::{Quantity, Values};
use crate::map_noise::noisy;
use crate::model::Model;

/// Number of noisy copies of a frame. A standard deviation of 16 draws has a standard error of 18 %.
const DRAWS: usize = 16;

/// Reconstructs noisy copies of each frame.
///
/// The noise of readings is taken as independent. Included: noise of the readings and of the tracked baseline, and of a calibrated map
/// the error of the calibration's gain, one for the whole sheet in each copy. Not included: the error of the method (blur, and
/// inhomogeneity of the sheet that the gain does not follow).
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
                let mut pressure = self.pressure(reconstructor.mesh(), &map)?;
                if let (Some(pressure), Some(calibration)) =
                    (&mut pressure, &self.model.calibration)
                {
                    let draw: f64 = StandardNormal.sample(&mut random);
                    let gain = (gain_deviation(calibration) * draw).exp();
                    pressure.kpa.iter_mut().for_each(|kpa| *kpa *= gain);
                    pressure.newtons *= gain;
                }
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

/// Standard deviation of ln gain at a press that the calibration was not fitted to: the errors of its own presses, enlarged for the
/// parameters that were fitted to them (the level, and the terms of the gain where it has some).
fn gain_deviation(calibration: &Calibration) -> f64 {
    let presses = calibration.presses.max(1) as f64;
    let over_the_place = calibration.gain.iter().any(|term| *term != 0.0);
    let fitted = if over_the_place {
        1.0 + calibration.gain.len() as f64
    } else {
        1.0
    };
    let free = (presses - fitted).max(1.0);
    calibration.rms * (presses / free * (1.0 + fitted / presses)).sqrt()
}

fn deviation(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (count - 1.0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_presses_leave_a_gain_less_certain() {
        let of = |presses: usize, gain: [f64; 5]| {
            gain_deviation(&Calibration {
                kind: String::new(),
                mesh: String::new(),
                method: String::new(),
                loss: Vec::new(),
                kpa: Vec::new(),
                frame: [0.0; 4],
                gain,
                presses,
                rms: 0.06,
            })
        };
        let flat = [0.0; 5];
        let curved = [0.1, 0.0, 0.0, 0.0, 0.0];
        // 6 presses, the level: 0.06 sqrt(6/5 (1 + 1/6)); 9 presses, six parameters: 0.06 sqrt(9/3 (1 + 6/9))
        assert!((of(6, flat) - 0.06 * 1.4_f64.sqrt()).abs() < 1e-12);
        assert!((of(9, curved) - 0.06 * 5.0_f64.sqrt()).abs() < 1e-12);
        assert!((of(10_000, curved) - 0.06).abs() < 1e-4);
        // a file by hand
        assert!(of(0, curved).is_finite());
    }
}
