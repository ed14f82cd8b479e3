//! The noise figure of a trained network, which is not linear: found by draws of the noise it was trained for.

use std::sync::Arc;

use eit::{Case, Forward, Model, Noise};
use survey::{Reading, Volts};

/// Draws of the noise.
const DRAWS: usize = 24;
/// Radius of the load in the middle of the region, as a share of the region's half diagonal; it loses half.
const SIZE: f64 = 0.1;

/// The model with its noise figure: signal-to-noise ratio of the readings over that of the map, for a small load in the
/// middle of the region. Without one where the network makes no map of that load or an empty one.
pub(crate) fn with_noise_figure(model: Model, case: &Case, sigma0: &[f64], noise: &Noise) -> Model {
    match figure(&model, case, sigma0, noise) {
        Some(figure) => model.clone().with_noise_figure(figure).unwrap_or(model),
        None => model,
    }
}

fn figure(model: &Model, case: &Case, sigma0: &[f64], noise: &Noise) -> Option<f64> {
    let mesh = &case.mesh;
    let centroids = mesh.region_centroids();
    let bounds = [0, 1].map(|axis| {
        let along = centroids.iter().map(|point| point[axis]);
        let low = along.clone().fold(f64::INFINITY, f64::min);
        (low, along.fold(f64::NEG_INFINITY, f64::max))
    });
    let middle = bounds.map(|(low, high)| 0.5 * (low + high));
    let radius = SIZE * 0.5 * (bounds[0].1 - bounds[0].0).hypot(bounds[1].1 - bounds[1].0);
    let mut pressed = sigma0.to_vec();
    for (&triangle, [x, y]) in mesh.region().iter().zip(&centroids) {
        if (x - middle[0]).hypot(y - middle[1]) < radius {
            pressed[triangle] *= 0.5;
        }
    }
    let forward = Forward::new(Arc::clone(mesh), &case.contact_ohm_m).ok()?;
    let before = forward.readings(sigma0, &case.protocol).ok()?;
    let after = forward.readings(&pressed, &case.protocol).ok()?;
    let top = before.amax();
    let network = model.clone().into_reconstructor();
    let baseline: Vec<Reading> = before.iter().map(|v| Reading::Ok(Volts(*v))).collect();
    let map = |noise: &[f32]| {
        let frame: Vec<Reading> = after
            .iter()
            .zip(noise)
            .map(|(v, noise)| Reading::Ok(Volts(v + top * f64::from(*noise))))
            .collect();
        network.reconstruct(&baseline, &frame).ok()
    };
    let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let clean = map(&vec![0.0; after.len()])?;
    let signal = size(&mut after.iter().zip(&before).map(|(a, b)| (a - b) / top));
    let answer = size(&mut clean.values.iter().copied());
    let (mut heard, mut shown) = (0.0, 0.0);
    for draw in 0..DRAWS {
        let mut row = vec![0.0_f32; after.len()];
        noise.add(&mut row, draw, 0, 1);
        let noisy = map(&row)?;
        heard += size(&mut row.iter().map(|v| f64::from(*v)));
        let moved = noisy.values.iter().zip(&clean.values);
        shown += size(&mut moved.map(|(a, b)| a - b));
    }
    let figure = (signal / heard) / (answer / shown);
    (figure.is_finite() && answer > 0.0).then_some(figure)
}
