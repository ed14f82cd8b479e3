//! Significance threshold of a map, from the noise of readings alone.

use eit::Reconstructor;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::{Reading, Volts};

use crate::model::Model;

/// Number of simulated frames of an unloaded sheet, for methods with one regularisation strength for all frames.
const DRAWS: usize = 8;
/// Number of simulated frames for methods that choose the strength for each frame: most maps of noise alone are empty,
/// some are not.
const DRAWS_PER_FRAME: usize = 64;
/// Ratio of the threshold to the mean of the maps' largest losses, or to the largest of them if the strength depends on
/// the frame. It is above 1 because noise is drawn independently for each reading, and the noise of real instruments is
/// correlated.
const FACTOR: f64 = 2.0;

/// Threshold of significance: twice the mean, over seeded draws, of the largest relative loss that noise of one reading
/// (standard deviation, in the unit of the baseline) causes on an unloaded sheet. If the method chooses the strength
/// for each frame, the threshold is that of the method with one strength for all frames, or twice the largest loss of
/// all draws, whichever is more. A map without a larger loss is not significant. `None` if the method makes no map of
/// an unloaded sheet.
pub fn map_noise(model: &Model, baseline: &[Reading], noise: f64) -> Option<f64> {
    let mean = |losses: Vec<f64>| FACTOR * losses.iter().sum::<f64>() / losses.len() as f64;
    let of =
        |reconstructor: &dyn Reconstructor, draws| drawn(reconstructor, baseline, noise, draws);
    let Some(fixed) = &model.fixed_strength else {
        return Some(mean(of(model.reconstructor.as_ref(), DRAWS)?));
    };
    let own = of(model.reconstructor.as_ref(), DRAWS_PER_FRAME)?;
    let most = own.into_iter().fold(0.0, f64::max);
    Some(mean(of(fixed.as_ref(), DRAWS)?).max(FACTOR * most))
}

/// The largest loss of each of `draws` maps of noise alone.
fn drawn(
    reconstructor: &dyn Reconstructor,
    baseline: &[Reading],
    noise: f64,
    draws: usize,
) -> Option<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    (0..draws)
        .map(|_| {
            let frame = noisy(baseline, noise, &mut random);
            let map = reconstructor.reconstruct(baseline, &frame).ok()?;
            Some(map.largest_loss().map_or(0.0, |(_, loss)| loss))
        })
        .collect()
}

/// The baseline plus independent normal noise of this standard deviation.
pub(crate) fn noisy(baseline: &[Reading], noise: f64, random: &mut ChaCha8Rng) -> Vec<Reading> {
    baseline
        .iter()
        .map(|reading| match reading {
            Reading::Ok(Volts(volts)) => {
                let draw: f64 = StandardNormal.sample(random);
                Reading::Ok(Volts(volts + noise * draw))
            }
            other => *other,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Conditions, GeometrySettings, PresetName, ReconstructionSettings, build};
    use eit::{DiscTank, Forward};
    use std::sync::Arc;
    use survey::{Amps, Protocol};

    #[test]
    fn an_untouched_sheet_is_within_its_noise_and_a_press_is_not() {
        let geometry = GeometrySettings {
            preset: Some(PresetName::DiscTank),
            disc_tank: Some(DiscTank {
                fineness: 0.25,
                ..DiscTank::default()
            }),
            ..GeometrySettings::default()
        }
        .geometry(None)
        .unwrap();
        let protocol = Protocol::sheffield(geometry.electrodes()).unwrap();
        let forward = Forward::new(Arc::clone(&geometry.mesh), &geometry.contact_ohm_m).unwrap();
        let answers = |sigma: &[f64]| -> Vec<f64> {
            let ohms = forward.readings(sigma, &protocol).unwrap();
            ohms.iter().map(|ohms| 1e-3 * ohms).collect()
        };
        let readings = |volts: &[f64]| -> Vec<Reading> {
            volts.iter().map(|v| Reading::Ok(Volts(*v))).collect()
        };
        let volts = answers(&geometry.sigma0);
        let baseline = readings(&volts);
        let size = volts
            .iter()
            .fold(0.0_f64, |most, volts| most.max(volts.abs()));
        let noise_v = 1e-4 * size;
        let conditions = Conditions {
            noise_v: Some(noise_v),
            ..Conditions::live(&geometry, &protocol, Amps(1e-3))
        };
        let model = build(&ReconstructionSettings::default(), &conditions).unwrap();
        let reconstructor = model.reconstructor.as_ref();
        let noise = map_noise(&model, &baseline, noise_v).unwrap();
        assert!(noise > 0.0 && noise < 0.2, "{noise}");
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let mut noisy = |volts: &[f64]| {
            let draw = |volts: &f64| {
                let draw: f64 = StandardNormal.sample(&mut random);
                volts + noise_v * draw
            };
            let frame: Vec<f64> = volts.iter().map(draw).collect();
            let map = reconstructor
                .reconstruct(&baseline, &readings(&frame))
                .unwrap();
            map.largest_loss().map_or(0.0, |(_, loss)| loss)
        };
        for _ in 0..50 {
            let loss = noisy(&volts);
            assert!(loss <= noise, "{loss} of an untouched sheet, noise {noise}");
        }
        let mut sigma = geometry.sigma0.clone();
        for (triangle, sigma) in sigma.iter_mut().enumerate() {
            let [x, y] = geometry.mesh.corners(triangle)[0];
            if (x - 0.08).hypot(y) < 0.05 {
                *sigma *= 0.2;
            }
        }
        let loss = noisy(&answers(&sigma));
        assert!(loss > noise, "{loss} of a press, noise {noise}");
    }
}
