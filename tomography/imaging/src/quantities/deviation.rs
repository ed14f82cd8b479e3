//! Standard deviations of quantities, caused by noise of the readings and of the tracked baseline.

use eit::{Calibration, Mesh, Pressure};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::{HotSpot, Map, Reading};

use super::quantity::{LoadUnit, Quantity, Values};
use super::tracks::{SpotUncertainty, distance, radius};
use crate::map_noise::noisy;
use crate::model::Model;
use crate::tracking::principal_axes;

/// Number of noisy copies of a frame. A standard deviation of 16 draws has a standard error of 18 %.
const DRAWS: usize = 16;
/// Radius of the 95 % ellipse of a position, in standard deviations estimated from 16 draws: by Hotelling's distribution
/// the root of 2 (15 / 14) F, F = 3.7389 with 2 and 14 degrees of freedom.
const REGION_95: f64 = 2.8305;
/// Half width of the 95 % interval of a number, in the same unit: Student's distribution with 15 degrees of freedom.
const INTERVAL_95: f64 = 2.1314;

/// Reconstructs noisy copies of each frame.
///
/// The noise of readings is assumed to be independent. Included: noise of the readings and of the tracked baseline; for
/// a calibrated map also the error of the calibration's gain, one value for the whole sheet in each copy. Not included:
/// the error of the method (blur, and inhomogeneity of the sheet that the gain does not describe).
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

/// Quantities of each region, and hot spots, of one map.
pub(super) struct Described {
    pub(super) regions: Vec<Values>,
    pub(super) spots: Vec<HotSpot>,
}

/// Standard deviations of [`Described`] by noise.
pub(super) struct Deviations {
    /// Standard deviations of the quantities of each region.
    pub(super) regions: Vec<Values>,
    pub(super) spots: Vec<Option<SpotUncertainty>>,
}

impl Deviations {
    pub(super) fn none(regions: usize) -> Self {
        Self {
            regions: vec![Values::default(); regions],
            spots: Vec::new(),
        }
    }
}

impl Deviation {
    /// `noise_v`: standard deviation of one reading, in the unit of the readings.
    pub fn new(model: &Model, noise_v: f64) -> Self {
        Self {
            model: model.clone(),
            noise_v,
        }
    }

    /// Standard deviations of the result of `describe` for a map (and its pressure) by noise. A quantity or a hot spot
    /// that is missing from one of the noisy maps has none. `baseline_sd`: standard deviation of the tracked baseline.
    pub(super) fn of(
        &self,
        frame: ComparedReadings<'_>,
        baseline_sd: f64,
        regions: usize,
        spots: &[&HotSpot],
        unit: LoadUnit,
        describe: impl Fn(&Map, Option<&Pressure>) -> Described,
    ) -> Deviations {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let noise_v = self.noise_v.hypot(baseline_sd);
        let drawn: Option<Vec<Described>> = (0..DRAWS)
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
                Some(describe(&map, pressure.as_ref()))
            })
            .collect();
        let Some(drawn) = drawn else {
            return Deviations::none(regions);
        };
        let of_region = |region: usize| {
            let mut deviations = Values::default();
            for quantity in Quantity::ALL {
                let values = drawn.iter().map(|draw| draw.regions[region].get(quantity));
                let values: Option<Vec<f64>> = values.collect();
                deviations.set(
                    quantity,
                    values.map(|values| covariance(&values, &values).sqrt()),
                );
            }
            deviations
        };
        let of_spot = |spot: &&HotSpot| {
            let same = drawn.iter().map(|draw| nearest(spot, &draw.spots));
            let same: Option<Vec<&HotSpot>> = same.collect();
            same.map(|same| uncertainty(spot, &same, unit))
        };
        Deviations {
            regions: (0..regions).map(of_region).collect(),
            spots: spots.iter().map(of_spot).collect(),
        }
    }

    /// The map as pressure, `Some(None)` without a calibration; `None` if the calibration refuses the map.
    fn pressure(&self, mesh: &Mesh, map: &Map) -> Option<Option<Pressure>> {
        match &self.model.calibration {
            None => Some(None),
            Some(calibration) => calibration.pressure(mesh, map).ok().map(Some),
        }
    }
}

/// Standard deviation of ln gain at a press to which the calibration was not fitted: the errors at the calibration's
/// presses, enlarged for the parameters fitted to them (the level, and the terms of the gain if it has any).
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

/// The hot spot of a noisy map that corresponds to `spot`: the nearest, if its centre is within the radius of `spot`.
fn nearest<'a>(spot: &HotSpot, spots: &'a [HotSpot]) -> Option<&'a HotSpot> {
    let apart = |other: &HotSpot| distance(spot.centre, other.centre);
    let nearest = spots.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
    Some(nearest).filter(|other| apart(other) <= radius(spot))
}

/// 95 % ellipse and interval of a hot spot from the corresponding hot spots of the noisy maps.
fn uncertainty(spot: &HotSpot, drawn: &[&HotSpot], unit: LoadUnit) -> SpotUncertainty {
    let [x, y] = [0, 1].map(|axis| -> Vec<f64> { drawn.iter().map(|s| s.centre[axis]).collect() });
    let across = covariance(&x, &y);
    let (deviations, angle_deg) =
        principal_axes([[covariance(&x, &x), across], [across, covariance(&y, &y)]]);
    let loads: Vec<f64> = drawn.iter().map(|s| s.load).collect();
    let width = INTERVAL_95 * covariance(&loads, &loads).sqrt();
    SpotUncertainty {
        half_axes_mm: deviations.map(|metres| 1e3 * REGION_95 * metres),
        angle_deg,
        load_interval: [spot.load - width, spot.load + width].map(|load| unit.load_factor() * load),
    }
}

fn covariance(a: &[f64], b: &[f64]) -> f64 {
    let count = a.len() as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / count;
    let (of_a, of_b) = (mean(a), mean(b));
    let products: f64 = a.iter().zip(b).map(|(a, b)| (a - of_a) * (b - of_b)).sum();
    products / (count - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts how often the ellipse and the interval of a noisy hot spot contain the truth, with deviations from 16
    /// other noisy hot spots.
    #[test]
    fn regions_of_hot_spots_contain_the_truth_in_95_percent() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        // x and y of deviations 2 and 1 mm, turned by 30 degrees; load of 8 %
        let mut spot = || {
            let [along, across, load]: [f64; 3] =
                std::array::from_fn(|_| StandardNormal.sample(&mut random));
            let ((sin, cos), along) = (30.0_f64.to_radians().sin_cos(), 2.0 * along);
            HotSpot {
                centre: [along * cos - across * sin, along * sin + across * cos]
                    .map(|mm| 1e-3 * mm),
                peak: 0.5,
                area: 1e-3,
                load: 1e-4 * (1.0 + 0.08 * load),
            }
        };
        let (mut inside, mut between, mut angles) = (0, 0, 0.0);
        for _ in 0..4000 {
            let measured = spot();
            let drawn: Vec<HotSpot> = (0..DRAWS).map(|_| spot()).collect();
            let drawn: Vec<&HotSpot> = drawn.iter().collect();
            let found = uncertainty(&measured, &drawn, LoadUnit::RelativeLoss);
            let (sin, cos) = found.angle_deg.to_radians().sin_cos();
            let [x, y] = measured.centre.map(|metres| 1e3 * metres);
            let [a, b] = found.half_axes_mm;
            let away = ((x * cos + y * sin) / a).hypot((y * cos - x * sin) / b);
            inside += u32::from(away <= 1.0);
            let [low, high] = found.load_interval;
            between += u32::from((low..=high).contains(&100.0));
            angles += found.angle_deg / 4000.0;
        }
        // the binomial standard deviation is 0.34 %; with quantiles of the normal distribution 90 and 92.5 % would be
        // contained
        for contained in [inside, between] {
            let share = f64::from(contained) / 4000.0;
            assert!((0.938..=0.962).contains(&share), "{inside} {between}");
        }
        assert!((angles - 30.0).abs() < 1.0, "{angles}");
    }

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
        // a manually written file may state 0 presses
        assert!(of(0, curved).is_finite());
    }
}
