//! The linear inverse problem solved where it is small: in the space of readings.
//!
//! J `sensitivity` (readings x unknowns), R the prior, d `data`, x the map, b = J n with n the null space of R:
//!
//! (J'J + lambda^2 R) x = J'd  has the same solution as  x = R^-1 J' u,  (J R^-1 J' + lambda^2 I) u = d,
//!
//! and where R has a null space,  x = R^+ J' u + n c  with  (J R^+ J' + lambda^2 I) u + b c = d,  b'u = 0.

use nalgebra::{DMatrix, DVector};

use crate::dense;
use crate::one_step::OneStepError;
use crate::prior::Penalty;

/// A solved one-step problem: the map is one matrix-vector product away.
#[derive(Debug, Clone)]
pub(crate) struct DataSpace {
    /// x = matrix d.
    matrix: DMatrix<f64>,
    /// u = dual d, symmetric.
    dual: DMatrix<f64>,
}

impl DataSpace {
    /// Factors once. `lambda` must be positive and not vanish beside the sensitivities.
    pub(crate) fn new(
        sensitivity: &DMatrix<f64>,
        penalty: &Penalty,
        lambda: f64,
    ) -> Result<Self, OneStepError> {
        let readings = sensitivity.nrows();
        let refused = |floor| OneStepError::Lambda { lambda, floor };
        if !(lambda.is_finite() && lambda > 0.0) {
            return Err(refused(0.0));
        }
        let null = penalty.null_space();
        let spread = penalty
            .inverse_times_transposed(sensitivity)
            .ok_or(OneStepError::Prior)?;
        let mut system = dense::product(dense::view(sensitivity), dense::view(&spread));
        if null.is_some() {
            system = 0.5 * (&system + system.transpose());
        }
        let trace = system.trace();
        let floor = (f64::EPSILON * trace).sqrt();
        if lambda <= floor {
            return Err(refused(floor));
        }
        for i in 0..readings {
            system[(i, i)] += lambda * lambda;
        }
        let mut dual = dense::inverse_of_definite(&system).ok_or_else(|| refused(floor))?;
        let Some(null) = null else {
            let matrix = dense::product(dense::view(&spread), dense::view(&dual));
            return Ok(Self { matrix, dual });
        };
        let b = sensitivity * &null;
        let dual_b = &dual * &b;
        let schur = b.transpose() * &dual_b;
        let inverse = schur.try_inverse().ok_or(OneStepError::Prior)?;
        let level = &inverse * dual_b.transpose();
        dual -= &dual_b * &level;
        dual = 0.5 * (&dual + dual.transpose());
        let mut matrix = dense::product(dense::view(&spread), dense::view(&dual));
        matrix += null * level;
        Ok(Self { matrix, dual })
    }

    /// The map of complete data.
    pub(crate) fn apply(&self, data: &[f64]) -> Vec<f64> {
        (&self.matrix * DVector::from_column_slice(data))
            .as_slice()
            .to_vec()
    }

    /// Fills `missing` entries of `data` so that [`Self::apply`] gives exactly the map of the problem without those
    /// readings: with u = 0 there, the rows that are left are the smaller problem's own.
    pub(crate) fn impute(&self, data: &mut [f64], missing: &[usize]) -> Result<(), OneStepError> {
        if missing.is_empty() {
            return Ok(());
        }
        for &reading in missing {
            data[reading] = 0.0;
        }
        let known = DVector::from_column_slice(data);
        let block = DMatrix::from_fn(missing.len(), missing.len(), |i, j| {
            self.dual[(missing[i], missing[j])]
        });
        let pull: Vec<f64> = missing
            .iter()
            .map(|&reading| -self.dual.column(reading).dot(&known))
            .collect();
        let filled = dense::solve_definite(&block, &pull).ok_or(OneStepError::Prior)?;
        for (&reading, value) in missing.iter().zip(filled) {
            data[reading] = value;
        }
        Ok(())
    }

    /// x = matrix d.
    pub(crate) fn matrix(&self) -> &DMatrix<f64> {
        &self.matrix
    }
}
