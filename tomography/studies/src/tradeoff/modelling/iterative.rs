//! Conjugate gradients with two preconditioners, for comparison with direct solutions.

use super::system::System;

/// Maximum number of steps of one solution.
const MOST: usize = 4000;

/// An approximate inverse.
pub(crate) enum Preconditioner {
    Jacobi(Vec<f64>),
    /// Incomplete Cholesky factor without fill: rows of the lower triangle, the diagonal last.
    Cholesky(Vec<Vec<(usize, f64)>>),
}

impl Preconditioner {
    pub(crate) fn jacobi(system: &System) -> Self {
        let diagonal = |(i, row): (usize, &Vec<(usize, f64)>)| {
            row.iter()
                .find(|(j, _)| *j == i)
                .map_or(1.0, |(_, value)| value.recip())
        };
        Self::Jacobi(system.rows.iter().enumerate().map(diagonal).collect())
    }

    /// The incomplete Cholesky factor; `None` if a pivot is not positive.
    pub(crate) fn cholesky(system: &System) -> Option<Self> {
        let mut factor: Vec<Vec<(usize, f64)>> = Vec::with_capacity(system.size());
        for (i, row) in system.rows.iter().enumerate() {
            let mut built: Vec<(usize, f64)> = Vec::new();
            for &(j, value) in row.iter().filter(|(j, _)| *j <= i) {
                let other: &[(usize, f64)] = if j < i { &factor[j] } else { &built };
                let below = if j < i {
                    &other[..other.len() - 1]
                } else {
                    other
                };
                let sum = shared(&built, below);
                if j < i {
                    let pivot = factor[j].last()?.1;
                    built.push((j, (value - sum) / pivot));
                } else {
                    let pivot = value - sum;
                    if pivot.is_nan() || pivot <= 0.0 {
                        return None;
                    }
                    built.push((i, pivot.sqrt()));
                }
            }
            factor.push(built);
        }
        Some(Self::Cholesky(factor))
    }

    fn apply(&self, r: &[f64], out: &mut [f64]) {
        match self {
            Self::Jacobi(inverse) => {
                for ((out, r), inverse) in out.iter_mut().zip(r).zip(inverse) {
                    *out = r * inverse;
                }
            }
            Self::Cholesky(factor) => {
                for (i, row) in factor.iter().enumerate() {
                    let (diagonal, below) = row.split_last().expect("every row has a diagonal");
                    let sum: f64 = below.iter().map(|(j, value)| value * out[*j]).sum();
                    out[i] = (r[i] - sum) / diagonal.1;
                }
                for (i, row) in factor.iter().enumerate().rev() {
                    let (diagonal, below) = row.split_last().expect("every row has a diagonal");
                    out[i] /= diagonal.1;
                    let value = out[i];
                    for (j, entry) in below {
                        out[*j] -= entry * value;
                    }
                }
            }
        }
    }
}

/// Sum of products over the columns common to two sorted rows.
fn shared(a: &[(usize, f64)], b: &[(usize, f64)]) -> f64 {
    let (mut sum, mut k) = (0.0, 0);
    for (j, value) in a {
        while k < b.len() && b[k].0 < *j {
            k += 1;
        }
        if k < b.len() && b[k].0 == *j {
            sum += value * b[k].1;
        }
    }
    sum
}

/// Solves until the residual is below `tolerance` relative to the right side; returns the solution, the number of
/// steps, and whether it converged.
pub(crate) fn conjugate_gradients(
    system: &System,
    right: &[f64],
    preconditioner: &Preconditioner,
    tolerance: f64,
) -> (Vec<f64>, usize, bool) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let n = system.size();
    let (mut x, mut r) = (vec![0.0; n], right.to_vec());
    let mut z = vec![0.0; n];
    preconditioner.apply(&r, &mut z);
    let mut p = z.clone();
    let mut q = vec![0.0; n];
    let mut rz = dot(&r, &z);
    let goal = tolerance * dot(right, right).sqrt();
    for step in 0..MOST {
        if dot(&r, &r).sqrt() <= goal {
            return (x, step, true);
        }
        system.times(&p, &mut q);
        let alpha = rz / dot(&p, &q);
        for i in 0..n {
            x[i] += alpha * p[i];
            r[i] -= alpha * q[i];
        }
        preconditioner.apply(&r, &mut z);
        let next = dot(&r, &z);
        let beta = next / rz;
        rz = next;
        for (p, z) in p.iter_mut().zip(&z) {
            *p = z + beta * *p;
        }
    }
    (x, MOST, false)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain of resistors to ground.
    fn chain(n: usize) -> System {
        let rows: Vec<Vec<(usize, f64)>> = (0..n)
            .map(|i| {
                let mut row = Vec::new();
                if i > 0 {
                    row.push((i - 1, -1.0));
                }
                row.push((i, 2.0 + 0.1 * i as f64));
                if i + 1 < n {
                    row.push((i + 1, -1.0));
                }
                row
            })
            .collect();
        // conductance to ground is minus the sum of the row
        let ground = |row: &Vec<(usize, f64)>| -row.iter().map(|(_, value)| value).sum::<f64>();
        System {
            ground: rows.iter().map(ground).collect(),
            rows,
            first_electrode: n,
            electrodes: 1,
        }
    }

    #[test]
    fn both_preconditioners_solve_a_chain() {
        let system = chain(40);
        let wanted: Vec<f64> = (0..40).map(|k| (k as f64 * 0.7).sin()).collect();
        let mut right = vec![0.0; 40];
        system.times(&wanted, &mut right);
        let cholesky = Preconditioner::cholesky(&system).unwrap();
        for (preconditioner, most) in [(Preconditioner::jacobi(&system), 40), (cholesky, 2)] {
            let (x, steps, there) = conjugate_gradients(&system, &right, &preconditioner, 1e-13);
            // a tridiagonal matrix has no fill, so its incomplete factor is exact
            assert!(there && steps <= most, "{steps} steps");
            let error = x.iter().zip(&wanted).map(|(x, w)| (x - w).abs());
            assert!(error.fold(0.0, f64::max) < 1e-12);
            let rest = vec![0.0; 40];
            let residual = system.residual(&right, &wanted, &rest);
            assert!(residual.iter().all(|r| r.abs() < 1e-14));
        }
    }
}
