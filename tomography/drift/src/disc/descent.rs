//! Levenberg-Marquardt for the few parameters of a disc.

use nalgebra::{DVector, SMatrix, SVector};

/// What is fitted: `N` parameters to data.
pub(super) trait Problem<const N: usize> {
    /// The parameters within their bounds.
    fn clamp(&self, theta: SVector<f64, N>) -> SVector<f64, N>;

    /// The data that are left, and the cost with the priors.
    fn residual(&self, theta: &SVector<f64, N>) -> (DVector<f64>, f64);

    /// The normal matrix with the priors, and the right side, at parameters that leave these data.
    fn normal(
        &self,
        theta: &SVector<f64, N>,
        left: &DVector<f64>,
    ) -> (SMatrix<f64, N, N>, SVector<f64, N>);
}

/// The parameters after at most so many steps, and their cost.
pub(super) fn descend<const N: usize>(
    problem: &impl Problem<N>,
    start: SVector<f64, N>,
    steps: usize,
) -> (SVector<f64, N>, f64) {
    let mut theta = problem.clamp(start);
    let (mut left, mut cost) = problem.residual(&theta);
    let mut damping = 1e-2;
    for _ in 0..steps {
        let (normal, right) = problem.normal(&theta, &left);
        let mut gained = 0.0;
        for _ in 0..8 {
            let mut damped = normal;
            for k in 0..N {
                damped[(k, k)] *= 1.0 + damping;
            }
            let step = damped.cholesky().map(|factor| factor.solve(&right));
            let next = problem.clamp(theta + step.unwrap_or_else(SVector::zeros));
            let (next_left, next_cost) = problem.residual(&next);
            if next_cost < cost {
                gained = cost - next_cost;
                (theta, left, cost) = (next, next_left, next_cost);
                damping = (damping * 0.1).max(1e-9);
                break;
            }
            damping *= 10.0;
        }
        if gained < 1e-4 {
            break;
        }
    }
    (theta, cost)
}
