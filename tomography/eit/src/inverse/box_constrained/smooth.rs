//! The one-step problem with -1 <= x <= 0 and a prior given by its covariance C = G G'.
//!
//! If its length is several triangles C is numerically singular, so C^-1 is never used. With P = C - C J' (J C J' +
//! lambda^2)^-1 J C and m the unbounded map, the minimum is x = m - P nu. The multipliers nu (one per unknown, in units
//! of 1 / lambda^2) are non-zero only at active bounds: nu >= 0 where x = 0, nu <= 0 where x = -1, otherwise nu = 0.
//!
//! Solved by proximal steps on nu (the augmented Lagrangian, R. T. Rockafellar, Math. Oper. Res. 1 (1976) 97). Each
//! ends at s nu = s nu_before + x - clip(..), found by a semismooth Newton method with a line search; it is finite
//! because everything is piecewise quadratic. A Newton step factors P + s on the unknowns that are outside their
//! bounds.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::inverse::prior::Smooth;
use crate::linear_algebra::dense;

/// Stiffness s of the first step, in units of the largest variance of P, and its factor from step to step.
const FIRST: f64 = 1e-3;
const STIFFER: f64 = 0.1;
/// The smallest s: below it, rounding could make P + s indefinite.
const LAST: f64 = 1e-9;
const MOST_STEPS: usize = 24;
const MOST_NEWTON_STEPS: usize = 60;
/// Largest distance between the map and m - P nu.
const TOUCHES: f64 = 1e-7;
/// Largest error of any unknown of the map, by the bound of [`Bounded::error`].
const CERTAIN: f64 = 1e-3;

/// The problem of one frame.
pub(super) struct Problem<'a> {
    prior: &'a Smooth,
    /// L^-1 J C with J C J' + lambda^2 = L L'.
    explained: DMatrix<f64>,
    /// m
    free: DVector<f64>,
    /// The largest entry of the diagonal of P.
    variance: f64,
}

/// Result of the method.
pub(super) struct Bounded {
    pub(super) x: DVector<f64>,
    /// Multipliers in units of 1 / lambda^2.
    nu: DVector<f64>,
    /// The largest distance between `x` and m - P nu.
    apart: f64,
    /// The largest variance of P.
    variance: f64,
}

impl Bounded {
    /// A bound on the error of any unknown: with e = m - P nu - x the multipliers differ from the optimal ones by d
    /// with d'P d <= |e'd|, and the map by at most the root of v d'P d, v the largest variance. That d is at most twice
    /// nu is an estimate.
    fn error(&self) -> f64 {
        (2.0 * self.variance * self.apart * self.nu.lp_norm(1)).sqrt()
    }

    /// Whether the map is accurate enough to return.
    pub(super) fn good(&self) -> bool {
        self.apart <= TOUCHES && self.error() <= CERTAIN
    }
}

impl<'a> Problem<'a> {
    /// `sensitivity` and `data` for the valid readings; `None` if a matrix cannot be factored.
    pub(super) fn new(
        prior: &'a Smooth,
        sensitivity: &DMatrix<f64>,
        square: f64,
        data: &DVector<f64>,
    ) -> Option<Self> {
        let seen = prior.seen(sensitivity);
        let mut system = dense::gram(&seen, |_| Some(1.0));
        for i in 0..system.nrows() {
            system[(i, i)] += square;
        }
        let lower = system.cholesky()?.unpack();
        let explained =
            lower.solve_lower_triangular(&prior.spread(&seen.transpose()).transpose())?;
        let free = explained.tr_mul(&lower.solve_lower_triangular(data)?);
        let variance = explained
            .column_iter()
            .map(|column| 1.0 - column.norm_squared())
            .fold(0.0, f64::max);
        (variance > 0.0 && free.iter().all(|x| x.is_finite())).then_some(Self {
            prior,
            explained,
            free,
            variance,
        })
    }

    /// P nu
    fn times(&self, nu: &DVector<f64>) -> DVector<f64> {
        self.prior.covariance_times(nu) - self.explained.tr_mul(&(&self.explained * nu))
    }

    /// The map within its bounds; [`Bounded::error`] bounds its error.
    pub(super) fn solve(&self) -> Option<Bounded> {
        let n = self.free.len();
        let mut at = Point::new(self, DVector::zeros(n));
        let mut stiffness = FIRST * self.variance;
        let mut best: Option<Bounded> = None;
        for _ in 0..MOST_STEPS {
            let before = at.nu.clone();
            self.minimum(&mut at, &before, stiffness)?;
            at = Point::new(self, at.nu); // removes the rounding accumulated over many steps
            let x = self.clipped(&at, &before, stiffness);
            let apart = (&self.free - &at.pushed - &x).amax();
            if best.as_ref().is_none_or(|best| apart < best.apart) {
                best = Some(Bounded {
                    nu: at.nu.clone(),
                    x,
                    apart,
                    variance: self.variance,
                });
            }
            if best.as_ref().is_some_and(Bounded::good) {
                break;
            }
            stiffness = (STIFFER * stiffness).max(LAST * self.variance);
        }
        best
    }

    /// The point within the bounds that is nearest to x + s nu_before.
    fn clipped(&self, at: &Point, before: &DVector<f64>, stiffness: f64) -> DVector<f64> {
        (&self.free - &at.pushed + before * stiffness).map(|y| y.clamp(-1.0, 0.0))
    }

    /// nu'P nu / 2 + |x + s nu_before - clip(x + s nu_before)|^2 / 2 s, smooth and convex along every line.
    fn value(&self, at: &Point, before: &DVector<f64>, stiffness: f64) -> f64 {
        let outside: f64 = self
            .free
            .iter()
            .zip(&at.pushed)
            .zip(before)
            .map(|((m, pushed), before)| {
                let y = m - pushed + stiffness * before;
                (y - y.clamp(-1.0, 0.0)).powi(2)
            })
            .sum();
        0.5 * at.nu.dot(&at.pushed) + outside / (2.0 * stiffness)
    }

    /// Newton's method from `at`; `None` where P + s is not definite.
    fn minimum(&self, at: &mut Point, before: &DVector<f64>, stiffness: f64) -> Option<()> {
        let mut last: Option<Vec<usize>> = None;
        for _ in 0..MOST_NEWTON_STEPS {
            let y: Vec<f64> = (0..before.len())
                .map(|i| self.free[i] - at.pushed[i] + stiffness * before[i])
                .collect();
            let outside: Vec<usize> = (0..y.len())
                .filter(|&i| !(-1.0..=0.0).contains(&y[i]))
                .collect();
            if last.as_ref() == Some(&outside) {
                return Some(()); // the same equations again: this point is their solution
            }
            let right: Vec<f64> = outside
                .iter()
                .map(|&i| self.free[i] + stiffness * before[i] - y[i].clamp(-1.0, 0.0))
                .collect();
            let mut system = self.block(&outside);
            for k in 0..outside.len() {
                system[(k, k)] += stiffness;
            }
            let pushes = dense::solve_definite(&system, &right)?;
            let mut nu = DVector::zeros(before.len());
            for (&i, push) in outside.iter().zip(pushes) {
                nu[i] = push;
            }
            let next = Point::new(self, nu);
            let value = self.value(at, before, stiffness);
            let mut length = 1.0;
            let taken = loop {
                let between = at.towards(&next, length);
                // the last steps are below the rounding error of the objective
                if self.value(&between, before, stiffness) <= value * (1.0 + 1e-13) {
                    break between;
                }
                length *= 0.5;
                if length < 1e-10 {
                    return Some(());
                }
            };
            *at = taken;
            last = (length == 1.0).then_some(outside);
        }
        Some(())
    }

    /// The block of P for some unknowns.
    fn block(&self, of: &[usize]) -> DMatrix<f64> {
        let mut block = dense::gram_of_columns(&self.explained.select_columns(of));
        block
            .as_mut_slice()
            .par_chunks_mut(of.len().max(1))
            .zip(of)
            .for_each(|(column, &unknown)| {
                let row = self.prior.covariance_row(unknown);
                for (value, &other) in column.iter_mut().zip(of) {
                    *value = row[other] - *value;
                }
            });
        block
    }
}

/// nu and P nu.
struct Point {
    nu: DVector<f64>,
    pushed: DVector<f64>,
}

impl Point {
    fn new(problem: &Problem<'_>, nu: DVector<f64>) -> Self {
        Self {
            pushed: problem.times(&nu),
            nu,
        }
    }

    fn towards(&self, other: &Self, length: f64) -> Self {
        Self {
            nu: &self.nu * (1.0 - length) + &other.nu * length,
            pushed: &self.pushed * (1.0 - length) + &other.pushed * length,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::inverse::box_constrained::smooth::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// For covariances from nearly diagonal to numerically singular, the result meets the conditions of optimality
    /// stated at the top of this file, with P computed independently of the method.
    #[test]
    fn multipliers_push_only_where_a_bound_is_touched() {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        let points: Vec<[f64; 2]> = (0..300)
            .map(|_| [random.random::<f64>(), random.random::<f64>()])
            .collect();
        let areas: Vec<f64> = (0..300).map(|_| 0.5 + random.random::<f64>()).collect();
        let sensitivity = DMatrix::from_fn(24, 300, |i, j| {
            let [x, y] = points[j];
            ((i / 4) as f64 * 1.3 * x + (i % 4) as f64 * y + i as f64).cos()
        });
        let truth = DVector::from_fn(300, |i, _| {
            let [x, y] = points[i];
            if (x - 0.4).hypot(y - 0.6) < 0.2 {
                -1.6
            } else {
                0.0
            }
        });
        let data = &sensitivity * truth;
        let mut whole = 0;
        for (length, lambda) in [(0.02, 3.0), (0.1, 3.0), (0.1, 0.1), (0.3, 1.0)] {
            let prior = Smooth::new(&points, &areas, length);
            let problem = Problem::new(&prior, &sensitivity, lambda * lambda, &data).unwrap();
            let found = problem.solve().unwrap();
            let covariance = DMatrix::from_fn(300, 300, |i, j| prior.covariance_row(i)[j]);
            assert!((&covariance - covariance.transpose()).amax() < 1e-13);
            let seen = &sensitivity * &covariance;
            let mut system = &seen * sensitivity.transpose();
            for i in 0..24 {
                system[(i, i)] += lambda * lambda;
            }
            let inverse = system.try_inverse().unwrap();
            let free = seen.tr_mul(&(&inverse * &data));
            let pushed = &covariance * &found.nu - seen.tr_mul(&(&inverse * (&seen * &found.nu)));
            let apart = (&free - pushed - &found.x).amax();
            let mut touched = [0, 0];
            for (x, nu) in found.x.iter().zip(&found.nu) {
                assert!((-1.0..=0.0).contains(x));
                match *x {
                    0.0 => assert!(*nu >= 0.0, "{nu}"),
                    -1.0 => assert!(*nu <= 0.0, "{nu}"),
                    _ => assert_eq!(*nu, 0.0, "{x}"),
                }
                touched[0] += usize::from(*x == 0.0);
                touched[1] += usize::from(*x == -1.0);
            }
            println!(
                "length {length}, lambda {lambda}: {apart:.1e}, {touched:?} touched, |nu| {:.1e}, at most {:.1e} from the optimum",
                found.nu.lp_norm(1),
                found.error()
            );
            assert!(
                found.good(),
                "length {length}, lambda {lambda}: {}",
                found.error()
            );
            assert!(
                apart < 2.0 * TOUCHES,
                "length {length}, lambda {lambda}: {apart:e}"
            );
            assert!(touched[0] > 10, "{touched:?}");
            whole += touched[1];
        }
        assert!(whole > 10, "{whole}");
    }
}
