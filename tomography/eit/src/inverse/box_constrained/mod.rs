//! The one-step problem with the bound -1 <= x <= 0: loads only reduce conductance.
//!
//! min |J x - d|^2 / 2 + lambda^2 x'Rx / 2  over  -1 <= x <= 0. If R is diagonal, the dual in the space of readings is
//! smooth and convex: with s = J'u the map is x = clip(s / R, -1, 0), and u solves lambda^2 u + J x(u) = d. A
//! semismooth Newton method with an exact Hessian and a backtracking line search finds it in about ten steps if lambda
//! suits the noise. If lambda is far smaller and Newton's steps become short, an
//! [`interior`](crate::inverse::interior_point) method first approaches the solution; if R is a graph Laplacian, that
//! method alone solves the problem. A prior given by its covariance has a separate solver ([`smooth`]). Every result
//! is checked against the conditions of optimality.

mod smooth;

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};

use crate::inverse::interior_point;
use crate::inverse::prior::Penalty;
use crate::inverse::reciprocity::Seen;
use crate::linear_algebra::dense;

/// Steps before the interior method takes over, and steps after it.
const MOST_STEPS: usize = 40;
/// Relative size of the residual at which the iteration stops.
const TOLERANCE: f64 = 1e-8;
/// Largest violation of the conditions of optimality at which a map is returned although its residual did not reach
/// [`TOLERANCE`]. The violation of each unknown is the smaller of its gradient, in units of the largest entry of J'd,
/// and its distance from the bound that the gradient points to.
pub(crate) const ACCEPTED: f64 = 1e-5;
/// Directions of the data whose prior variance is below this share of the noise's are dropped from the dual.
const NEGLIGIBLE: f64 = 1e-9;
/// Likewise for those below this share of the largest variance, the limit of double precision.
const ROUNDING: f64 = 1e-14;

pub(crate) struct Bounded {
    sensitivity: DMatrix<f64>,
    penalty: Penalty,
    /// Orthonormal directions of the data, most important last (columns), the sensitivity along them, and the prior
    /// variance.
    directions: DMatrix<f64>,
    along: DMatrix<f64>,
    variances: Vec<f64>,
}

/// An iterate of Newton's method: the dual variable, the dual's objective, the map, and the residual.
struct Point {
    u: DVector<f64>,
    value: f64,
    x: DVector<f64>,
    residual: DVector<f64>,
}

impl Bounded {
    /// `None` if a matrix cannot be factored.
    pub(crate) fn new(sensitivity: DMatrix<f64>, penalty: Penalty) -> Option<Self> {
        let Penalty::Diagonal(entries) = &penalty else {
            return Some(Self {
                directions: DMatrix::zeros(sensitivity.nrows(), 0),
                along: DMatrix::zeros(0, sensitivity.ncols()),
                variances: Vec::new(),
                sensitivity,
                penalty,
            });
        };
        let gram = dense::gram(&sensitivity, |i| Some(1.0 / entries[i]));
        let (values, vectors) = dense::symmetric_eigen(&gram)?;
        let top = values.last().copied().unwrap_or_default();
        let kept: Vec<usize> = (0..values.len())
            .filter(|&i| values[i] > ROUNDING * top)
            .collect();
        let directions =
            DMatrix::from_fn(vectors.nrows(), kept.len(), |i, j| vectors[(i, kept[j])]);
        let along = dense::product(
            dense::view(&directions).transpose(),
            dense::view(&sensitivity),
        );
        let variances = kept.iter().map(|&i| values[i]).collect();
        Some(Self {
            sensitivity,
            penalty,
            directions,
            along,
            variances,
        })
    }

    /// The bounded map of folded data. `None` if no point was found that meets the conditions of optimality to
    /// [`ACCEPTED`].
    pub(crate) fn solve(&self, seen: &Seen, lambda: f64) -> Option<Vec<f64>> {
        let square = lambda * lambda;
        let Penalty::Diagonal(entries) = &self.penalty else {
            let rows = seen.rows(&self.sensitivity);
            if seen.data.iter().all(|value| *value == 0.0) {
                return Some(vec![0.0; rows.ncols()]);
            }
            if let Penalty::Smooth(prior) = &self.penalty {
                let found = smooth::Problem::new(prior, &rows, square, &seen.data)?.solve()?;
                return found.good().then(|| found.x.as_slice().to_vec());
            }
            let x = interior_point::solve(&rows, &self.penalty, square, &seen.data)?;
            return (self.violation(square, &rows, &seen.data, &x) <= ACCEPTED)
                .then(|| x.as_slice().to_vec());
        };
        if seen.complete() {
            let of = self.variances.len();
            let negligible = self
                .variances
                .partition_point(|variance| *variance <= NEGLIGIBLE * square);
            let rows = (negligible, of - negligible);
            let data = self.directions.columns(rows.0, rows.1).tr_mul(&seen.data);
            let along = match negligible {
                0 => Cow::Borrowed(&self.along),
                _ => Cow::Owned(self.along.rows(rows.0, rows.1).into_owned()),
            };
            // start from the unbounded solution: at u = 0 every unknown would be on a bound
            let start = DVector::from_fn(data.len(), |i, _| {
                data[i] / (self.variances[negligible + i] + square)
            });
            return self.minimum(square, &along, entries, &data, start);
        }
        let (rows, data) = (seen.rows(&self.sensitivity), &seen.data);
        let mut hessian = dense::gram(&rows, |i| Some(1.0 / entries[i]));
        for i in 0..hessian.nrows() {
            hessian[(i, i)] += square;
        }
        let start = dense::solve_definite(&hessian, data.as_slice())
            .map_or_else(|| DVector::zeros(data.len()), DVector::from_vec);
        self.minimum(square, &rows, entries, data, start)
    }

    fn minimum(
        &self,
        square: f64,
        sensitivity: &DMatrix<f64>,
        entries: &[f64],
        data: &DVector<f64>,
        start: DVector<f64>,
    ) -> Option<Vec<f64>> {
        if data.iter().all(|value| *value == 0.0) {
            return Some(vec![0.0; entries.len()]);
        }
        let given = |x: DVector<f64>| Some(x.as_slice().to_vec());
        let mut best = match self.newton(square, sensitivity, entries, data, start) {
            Ok(x) => return given(x),
            Err(x) => x,
        };
        if let Some(inner) = interior_point::solve(sensitivity, &self.penalty, square, data) {
            let u = (data - sensitivity * &inner) / square;
            let mut others = vec![inner];
            match self.newton(square, sensitivity, entries, data, u) {
                Ok(x) => return given(x),
                Err(x) => others.push(x),
            }
            for other in others {
                if self.violation(square, sensitivity, data, &other)
                    < self.violation(square, sensitivity, data, &best)
                {
                    best = other;
                }
            }
        }
        (self.violation(square, sensitivity, data, &best) <= ACCEPTED)
            .then(|| best.as_slice().to_vec())
    }

    /// The solution, or the iterate with the smallest residual.
    fn newton(
        &self,
        square: f64,
        sensitivity: &DMatrix<f64>,
        entries: &[f64],
        data: &DVector<f64>,
        start: DVector<f64>,
    ) -> Result<DVector<f64>, DVector<f64>> {
        let goal = TOLERANCE * data.norm();
        let mut at = self.point(square, sensitivity, entries, data, start);
        let mut best = (at.residual.norm(), at.x.clone());
        for _ in 0..MOST_STEPS {
            if best.0 <= goal {
                return Ok(best.1);
            }
            let mut hessian = dense::gram(sensitivity, |i| {
                (at.x[i] > -1.0 && at.x[i] < 0.0).then(|| 1.0 / entries[i])
            });
            for i in 0..hessian.nrows() {
                hessian[(i, i)] += square;
            }
            let Some(newton) = dense::solve_definite(&hessian, at.residual.as_slice()) else {
                break;
            };
            let newton = DVector::from_vec(newton);
            let slope = -at.residual.dot(&newton);
            // the last steps gain less than the rounding error of the objective
            let rounding = 1e-14 * at.value.abs();
            let mut length = 1.0;
            let next = loop {
                let next = self.point(square, sensitivity, entries, data, &at.u - &newton * length);
                if next.value <= at.value + 1e-4 * length * slope + rounding {
                    break Some(next);
                }
                length *= 0.5;
                if length < 1e-8 {
                    break None;
                }
            };
            let Some(next) = next else { break };
            at = next;
            if at.residual.norm() < best.0 {
                best = (at.residual.norm(), at.x.clone());
            }
        }
        if best.0 <= goal {
            Ok(best.1)
        } else {
            Err(best.1)
        }
    }

    fn point(
        &self,
        square: f64,
        sensitivity: &DMatrix<f64>,
        entries: &[f64],
        data: &DVector<f64>,
        u: DVector<f64>,
    ) -> Point {
        let mut x = sensitivity.tr_mul(&u);
        let mut value = 0.5 * square * u.norm_squared() - data.dot(&u);
        for (s, &r) in x.iter_mut().zip(entries) {
            let at = (*s / r).clamp(-1.0, 0.0);
            value += *s * at - 0.5 * r * at * at;
            *s = at;
        }
        let residual = &u * square + sensitivity * &x - data;
        Point {
            u,
            value,
            x,
            residual,
        }
    }

    /// Largest violation of the conditions of optimality by a map, see [`ACCEPTED`].
    fn violation(
        &self,
        square: f64,
        sensitivity: &DMatrix<f64>,
        data: &DVector<f64>,
        x: &DVector<f64>,
    ) -> f64 {
        let pull = sensitivity.tr_mul(&(data - sensitivity * x));
        let size = sensitivity.tr_mul(data).amax();
        let held = self.penalty.times(x.as_slice());
        let mut most = 0.0_f64;
        for ((x, pull), held) in x.iter().zip(&pull).zip(held) {
            let gradient = square * held - pull;
            // towards a bound, the violation is at most the distance to the bound
            let slack = if gradient < 0.0 { -x } else { x + 1.0 };
            most = most.max(slack.min(gradient.abs() / size));
        }
        // a map with a value that is not finite violates everything
        if x.iter().all(|x| x.is_finite()) && size > 0.0 {
            most
        } else {
            f64::INFINITY
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::inverse::box_constrained::*;
    use crate::inverse::reciprocity::Fold;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Random problems, from well to extremely badly conditioned: the map is within its bounds and optimal to the
    /// stated limit.
    #[test]
    fn every_map_is_within_its_bounds_and_optimal() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for (readings, unknowns) in [(8, 5), (12, 40), (30, 120)] {
            for decay in [0.0, 0.5, 1.5] {
                for lambda in [1.0, 1e-2, 1e-4, 1e-6, 1e-7] {
                    let sensitivity = DMatrix::from_fn(readings, unknowns, |i, _| {
                        (random.random::<f64>() - 0.5) * (-decay * i as f64).exp()
                    });
                    let penalty: Vec<f64> = (0..unknowns)
                        .map(|_| 10_f64.powf(-3.0 * random.random::<f64>()))
                        .collect();
                    let truth =
                        DVector::from_fn(unknowns, |i, _| if i % 4 == 0 { -1.5 } else { 0.1 });
                    let data = &sensitivity * truth;
                    let top = dense::symmetric_eigen(&dense::gram(&sensitivity, |i| {
                        Some(1.0 / penalty[i])
                    }))
                    .unwrap()
                    .0
                    .last()
                    .unwrap()
                    .sqrt();
                    let problem =
                        Bounded::new(sensitivity.clone(), Penalty::Diagonal(penalty)).unwrap();
                    for missing in [vec![], vec![1, 3]] {
                        let seen = Fold::none(readings).seen(data.as_slice(), &missing);
                        let x = problem.solve(&seen, lambda * top).unwrap_or_else(|| {
                            panic!("{readings} x {unknowns}, decay {decay}, lambda {lambda:e}")
                        });
                        assert!(x.iter().all(|x| (-1.0..=0.0).contains(x)));
                        let kept: Vec<usize> =
                            (0..readings).filter(|i| !missing.contains(i)).collect();
                        let violation = problem.violation(
                            (lambda * top).powi(2),
                            &sensitivity.select_rows(&kept),
                            &data.select_rows(&kept),
                            &DVector::from_vec(x),
                        );
                        assert!(violation <= ACCEPTED, "{violation:e}");
                    }
                }
            }
        }
    }

    #[test]
    fn no_change_is_no_loss() {
        let penalty = Penalty::Diagonal(vec![1.0; 4]);
        let problem = Bounded::new(DMatrix::from_element(3, 4, 1.0), penalty).unwrap();
        let seen = Fold::none(3).seen(&[0.0; 3], &[]);
        assert_eq!(problem.solve(&seen, 1e-3), Some(vec![0.0; 4]));
    }
}
