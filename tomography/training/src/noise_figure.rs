//! Noise figures of nonlinear methods, estimated by draws: for trained networks with the noise of their training, for
//! other methods with white noise.

use std::sync::Arc;

use eit::{Case, Forward, Model, Reconstructor, bounding_box};
use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use survey::{Map, Reading};

use crate::samples::Noise;

/// Number of draws of the noise; [`FEW_DRAWS`] for a method that takes seconds per frame.
const DRAWS: usize = 24;
const FEW_DRAWS: usize = 6;
/// Radius of the load in the middle of the region, as a share of the region's half diagonal. The load halves the
/// conductance.
const SIZE: f64 = 0.1;
/// Seed of the draws of white noise.
const SEED: u64 = 26;

/// Adds the noise figure to a model: signal-to-noise ratio of the readings over that of the map, for a small load in
/// the middle of the region. The model gets no noise figure if the network makes no map of that load, or an empty one.
pub fn with_noise_figure(model: Model, case: &Case, sigma0: &[f64], noise: &Noise) -> Model {
    let network = model.clone().into_reconstructor();
    let figure = Press::new(case, sigma0, None).and_then(|press| {
        let top = press.before.amax();
        let draw = |draw| {
            let mut row = vec![0.0_f32; press.after.len()];
            noise.add(&mut row, draw, 0, 1);
            row.iter().map(|v| top * f64::from(*v)).collect()
        };
        press.figure(network.as_ref(), (0..DRAWS).map(draw).collect())
    });
    match figure {
        Some(figure) => model.clone().with_noise_figure(figure).unwrap_or(model),
        None => model,
    }
}

/// The noise figure of any method, at the case's currents, for white noise of `noise_v` (V, standard deviation of one
/// reading) on baseline and frame; fewer draws for a `slow` method. The figure of a nonlinear method depends on noise
/// and load. `None` if the method makes no map of the load, or an empty one.
pub fn by_draws(
    reconstructor: &dyn Reconstructor,
    case: &Case,
    noise_v: f64,
    slow: bool,
) -> Option<f64> {
    let sigma0 = case.unloaded_conductance();
    let press = Press::new(case, &sigma0, Some(&case.currents))?;
    // the noise of baseline and frame is added to the frame, because every method uses the difference only
    let normal = Normal::new(0.0, std::f64::consts::SQRT_2 * noise_v).ok()?;
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let count = press.after.len();
    let draws = (0..if slow { FEW_DRAWS } else { DRAWS })
        .map(|_| {
            normal
                .sample_iter(&mut random)
                .take(count)
                .collect::<Vec<f64>>()
        })
        .collect();
    press.figure(reconstructor, draws)
}

/// Readings of the sheet without and with a small load in the middle of the region.
struct Press {
    before: DVector<f64>,
    after: DVector<f64>,
}

impl Press {
    /// Computes the readings at `currents`, A, or at 1 A.
    fn new(case: &Case, sigma0: &[f64], currents: Option<&[f64]>) -> Option<Self> {
        let mesh = &case.mesh;
        let centroids = mesh.region_centroids();
        let [low, high] = bounding_box(centroids.iter().copied());
        let middle = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
        let radius = SIZE * 0.5 * (high[0] - low[0]).hypot(high[1] - low[1]);
        let mut pressed = sigma0.to_vec();
        for (&triangle, [x, y]) in mesh.region().iter().zip(&centroids) {
            if (x - middle[0]).hypot(y - middle[1]) < radius {
                pressed[triangle] *= 0.5;
            }
        }
        let forward = Forward::new(Arc::clone(mesh), &case.contact_ohm_m).ok()?;
        let taken = |sigma: &[f64]| {
            let mut volts = forward.readings(sigma, &case.protocol).ok()?;
            for (volts, current) in volts.iter_mut().zip(currents.unwrap_or_default()) {
                *volts *= current;
            }
            Some(volts)
        };
        Some(Self {
            before: taken(sigma0)?,
            after: taken(&pressed)?,
        })
    }

    /// (|dv| / |noise|) / (|map| / |map with noise - map|), |noise| (V) and map changes summed over the draws.
    fn figure(&self, reconstructor: &dyn Reconstructor, draws: Vec<Vec<f64>>) -> Option<f64> {
        let baseline = Reading::of_volts(self.before.iter().copied());
        let map = |noise: &[f64]| -> Option<Map> {
            let frame = Reading::of_volts(self.after.iter().zip(noise).map(|(v, noise)| v + noise));
            reconstructor.reconstruct(&baseline, &frame).ok()
        };
        let size =
            |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
        let clean = map(&vec![0.0; self.after.len()])?;
        let signal = (&self.after - &self.before).norm();
        let answer = size(&mut clean.values.iter().copied());
        let noisy: Vec<Map> = draws
            .par_iter()
            .map(|noise| map(noise))
            .collect::<Option<_>>()?;
        let (mut received, mut shown) = (0.0, 0.0);
        for (noise, noisy) in draws.iter().zip(&noisy) {
            received += size(&mut noise.iter().copied());
            let moved = noisy.values.iter().zip(&clean.values);
            shown += size(&mut moved.map(|(a, b)| a - b));
        }
        let figure = (signal / received) / (answer / shown);
        (figure.is_finite() && answer > 0.0).then_some(figure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use eit::{DiscTank, Hyper, OneStep, OneStepOptions, Scale};
    use survey::Protocol;

    /// For a linear map M the figure from draws equals the closed form |dv| |M| / sqrt(readings) / |M dv|.
    #[test]
    fn the_draws_of_a_linear_map_find_its_closed_form() {
        let tank = DiscTank::default();
        let mesh = Arc::new(tank.mesh().unwrap());
        let protocol = Protocol::sheffield(mesh.electrodes()).unwrap();
        let sigma0 = vec![tank.conductance(); mesh.triangles().len()];
        let case = Case {
            contact_ohm_m: tank.contact_ohm_m(),
            currents: vec![1e-3; protocol.len()],
            has_region: mesh.region().len() < mesh.triangles().len(),
            protocol,
            sigma: [("homog".to_owned(), sigma0.clone())].into(),
            mesh,
        };
        let noise_v = 2e-6;
        let method = |loss_only| {
            OneStep::new(
                Arc::clone(&case.mesh),
                &case.contact_ohm_m,
                &sigma0,
                &case.protocol,
                OneStepOptions {
                    hyper: Hyper::Noise {
                        volts: noise_v,
                        current: 1e-3,
                    },
                    scale: Scale::Currents(case.currents.clone()),
                    loss_only,
                    ..OneStepOptions::default()
                },
            )
            .unwrap()
        };
        let linear = method(false);
        let press = Press::new(&case, &sigma0, Some(&case.currents)).unwrap();
        let change = &press.after - &press.before;
        let matrix = linear.matrix().unwrap();
        let closed = change.norm() * matrix.norm()
            / (change.len() as f64).sqrt()
            / (&matrix * &change).norm();
        let drawn = by_draws(&linear, &case, noise_v, false).unwrap();
        let bounded = by_draws(&method(true), &case, noise_v, false).unwrap();
        println!(
            "closed form {closed:.3}, drawn {drawn:.3}; losses only {bounded:.3}; told for a smaller load {:.3}",
            linear.noise_figure().unwrap()
        );
        assert!((drawn / closed - 1.0).abs() < 0.1, "{drawn} {closed}");
        // most noise outside the load is clipped as a gain
        assert!(bounded > 0.1 * drawn && bounded < drawn, "{bounded}");
    }
}
