//! Draws from the posterior of the shapes of a frame.

use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::fit::{Fit, Problem, TEMPER};

/// Number of draws.
const DRAWS: usize = 100;
/// Smallest precision of every parameter.
const LEAST_PRECISION: f64 = 4.0;

/// Maps of shapes drawn from the posterior of a fit.
pub(crate) fn maps(problem: &Problem<'_>, fit: &Fit) -> Vec<Vec<f64>> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut hessian = fit.hessian.clone() / TEMPER;
    for p in 0..hessian.nrows() {
        hessian[(p, p)] += LEAST_PRECISION;
    }
    let root = hessian.cholesky().map(|factor| factor.l().transpose());
    let draw = |_| {
        let mut shapes = fit.shapes.clone();
        if let Some(root) = &root {
            let z = DVector::from_fn(root.nrows(), |_, _| StandardNormal.sample(&mut random));
            let step = root.solve_upper_triangular(&z).unwrap_or(z);
            let parameters = shapes.iter_mut().flat_map(|shape| &mut shape.theta);
            for (value, step) in parameters.zip(&step) {
                *value += step;
            }
        }
        problem.map(&shapes)
    };
    (0..DRAWS).map(draw).collect()
}
