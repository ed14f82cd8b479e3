//! The posterior mean over shapes, given the frame.

use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::fit::{Fit, Problem};

/// Mean map of fits weighted by their evidence, each averaged over its own uncertainty.
pub(crate) fn mean(
    problem: &Problem<'_>,
    fits: &[(f64, Fit)],
    temper: f64,
    draws: usize,
) -> Vec<f64> {
    let top = fits.iter().map(|f| f.0).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = fits.iter().map(|f| ((f.0 - top) / temper).exp()).collect();
    let total: f64 = weights.iter().sum();
    let mut map = vec![0.0; problem.model.mesh.region().len()];
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for ((_, fit), weight) in fits.iter().zip(weights) {
        let share = weight / total;
        let count = (share * draws as f64).round() as usize;
        if count == 0 || fit.shapes.is_empty() {
            continue;
        }
        let mut hessian = fit.hessian.clone() / temper;
        for p in 0..hessian.nrows() {
            hessian[(p, p)] += 4.0;
        }
        let factor = hessian.cholesky();
        for _ in 0..count {
            let mut shapes = fit.shapes.clone();
            if let Some(factor) = &factor {
                let z = DVector::from_fn(factor.l_dirty().nrows(), |_, _| {
                    StandardNormal.sample(&mut random)
                });
                let step = factor
                    .l()
                    .transpose()
                    .solve_upper_triangular(&z)
                    .unwrap_or(z);
                let mut at = 0;
                for shape in &mut shapes {
                    for value in &mut shape.theta {
                        *value += step[at];
                        at += 1;
                    }
                }
            }
            for (sum, value) in map.iter_mut().zip(problem.map(&shapes)) {
                *sum += share / count as f64 * value;
            }
        }
    }
    map
}
