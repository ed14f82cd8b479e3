//! Naive conjugate gradients with a diagonal preconditioner, which rely on the updated residual.

use super::bordered::Bordered;

/// Stopping criterion.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Until {
    /// The norm of the updated residual is at most this share of that of the right side.
    Residual(f64),
    /// No unknown changes by more than this, V.
    Step(f64),
}

/// The solution when the stopping criterion or the maximum number of steps is reached.
pub(crate) fn solve(
    matrix: &Bordered<f64>,
    right: &[f64],
    until: Until,
    most_rounds: usize,
) -> Vec<f64> {
    let n = matrix.size;
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let scaled =
        |r: &[f64]| -> Vec<f64> { (0..n).map(|i| r[i] / matrix.entries[i * n + i]).collect() };
    let size = dot(right, right).sqrt();
    let mut x = vec![0.0; n];
    let mut r = right.to_vec();
    let mut z = scaled(&r);
    let mut p = z.clone();
    let mut rz = dot(&r, &z);
    let mut rounds = 0;
    while rounds < most_rounds {
        rounds += 1;
        let ap = matrix.times(&p);
        let alpha = rz / dot(&p, &ap);
        let mut step = 0.0_f64;
        for i in 0..n {
            x[i] += alpha * p[i];
            r[i] -= alpha * ap[i];
            step = step.max((alpha * p[i]).abs());
        }
        let done = match until {
            Until::Residual(share) => dot(&r, &r).sqrt() <= share * size,
            Until::Step(volts) => step <= volts,
        };
        if done {
            break;
        }
        z = scaled(&r);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        for i in 0..n {
            p[i] = z[i] + beta * p[i];
        }
    }
    x
}
