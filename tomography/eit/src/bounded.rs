//! The one-step problem with the bound -1 <= x <= 0: loads only take conductance away.
//!
//! min |J x - d|^2 / 2 + lambda^2 x'Rx / 2  over  -1 <= x <= 0, R diagonal. Its dual in the space of readings is smooth
//! and convex: with s = J'u the map is x = clip(s / R, -1, 0), and u solves lambda^2 u + J x(u) = d. A semismooth Newton
//! method with an exact Hessian and a backtracking line search finds it in some ten steps.

use nalgebra::{DMatrix, DVector};

use crate::dense;

const MOST_STEPS: usize = 300;
/// Relative size of the residual at which the map has stopped moving.
const TOLERANCE: f64 = 1e-8;
/// Directions of the data whose prior variance is below this share of the noise's are left out of the dual.
const NEGLIGIBLE: f64 = 1e-9;

pub(crate) struct Bounded {
    sensitivity: DMatrix<f64>,
    penalty: Vec<f64>,
    lambda: f64,
    /// Orthonormal directions of the data that matter (columns), and the sensitivity seen along them.
    directions: DMatrix<f64>,
    along: DMatrix<f64>,
}

impl Bounded {
    pub(crate) fn new(sensitivity: DMatrix<f64>, penalty: Vec<f64>, lambda: f64) -> Option<Self> {
        let all = vec![true; penalty.len()];
        let gram = gram(&sensitivity, &penalty, &all);
        let (values, vectors) = dense::symmetric_eigen(&gram)?;
        let kept: Vec<usize> = (0..values.len())
            .filter(|&i| values[i] > NEGLIGIBLE * lambda * lambda)
            .collect();
        let directions =
            DMatrix::from_fn(vectors.nrows(), kept.len(), |i, j| vectors[(i, kept[j])]);
        let along = dense::product(
            dense::view(&directions).transpose(),
            dense::view(&sensitivity),
        );
        Some(Self {
            sensitivity,
            penalty,
            lambda,
            directions,
            along,
        })
    }

    /// The bounded map of the data; rows of `missing` readings are left out.
    pub(crate) fn solve(&self, data: &[f64], missing: &[usize]) -> Option<Vec<f64>> {
        if missing.is_empty() {
            let data = self.directions.transpose() * DVector::from_column_slice(data);
            return self.newton(&self.along, &data);
        }
        let kept: Vec<usize> = (0..data.len())
            .filter(|reading| missing.binary_search(reading).is_err())
            .collect();
        let rows = self.sensitivity.select_rows(&kept);
        let data = DVector::from_iterator(kept.len(), kept.iter().map(|&reading| data[reading]));
        self.newton(&rows, &data)
    }

    fn newton(&self, sensitivity: &DMatrix<f64>, data: &DVector<f64>) -> Option<Vec<f64>> {
        let square = self.lambda * self.lambda;
        let size = data.norm();
        let mut u = DVector::zeros(data.len());
        let (mut value, mut x) = self.dual(sensitivity, data, &u);
        for step in 0..MOST_STEPS {
            let residual = &u * square + sensitivity * &x - data;
            if residual.norm() <= TOLERANCE * size {
                return Some(x.as_slice().to_vec());
            }
            // the first step is the unbounded problem's: at u = 0 every unknown sits on a bound that it need not keep
            let free: Vec<bool> = x
                .iter()
                .map(|x| step == 0 || *x > -1.0 && *x < 0.0)
                .collect();
            let mut hessian = gram(sensitivity, &self.penalty, &free);
            for i in 0..hessian.nrows() {
                hessian[(i, i)] += square;
            }
            let newton = DVector::from_vec(dense::solve_definite(&hessian, residual.as_slice())?);
            let slope = -residual.dot(&newton);
            let mut length = 1.0;
            loop {
                let next = &u - &newton * length;
                let (there, map) = self.dual(sensitivity, data, &next);
                // the last steps gain less than the rounding of the objective itself
                let rounding = 1e-14 * value.abs();
                if there <= value + 1e-4 * length * slope + rounding || length < 1e-8 {
                    (u, value, x) = (next, there, map);
                    break;
                }
                length *= 0.5;
            }
        }
        None
    }

    /// The dual's objective at u, and the map there.
    fn dual(
        &self,
        sensitivity: &DMatrix<f64>,
        data: &DVector<f64>,
        u: &DVector<f64>,
    ) -> (f64, DVector<f64>) {
        let mut x = sensitivity.tr_mul(u);
        let mut value = 0.5 * self.lambda * self.lambda * u.norm_squared() - data.dot(u);
        for (s, &r) in x.iter_mut().zip(&self.penalty) {
            let at = (*s / r).clamp(-1.0, 0.0);
            value += *s * at - 0.5 * r * at * at;
            *s = at;
        }
        (value, x)
    }
}

/// J_F R_F^-1 J_F' over the free unknowns F.
fn gram(sensitivity: &DMatrix<f64>, penalty: &[f64], free: &[bool]) -> DMatrix<f64> {
    let columns: Vec<usize> = (0..penalty.len()).filter(|&i| free[i]).collect();
    let scaled = DMatrix::from_fn(sensitivity.nrows(), columns.len(), |i, j| {
        sensitivity[(i, columns[j])] / penalty[columns[j]].sqrt()
    });
    dense::product(dense::view(&scaled), dense::view(&scaled).transpose())
}
