//! The linear inverse problem solved in the space of readings, which is small, with reciprocal twins folded.
//!
//! J `sensitivity` (rows x unknowns), R the prior, d `data`, x the map, b = J n with n the null space of R:
//!
//! (J'J + lambda^2 R) x = J'd  has the same solution as  x = R^-1 J' u,  (J R^-1 J' + lambda^2 I) u = d,
//!
//! and where R has a null space,  x = R^+ J' u + n c  with  (J R^+ J' + lambda^2 I) u + b c = d,  b'u = 0.
//!
//! The matrix J R^-1 J' has the square of the problem's condition, which costs digits as 1 / lambda^2. For a lambda so
//! small that this matters, orthogonal transformations are used: with R = L L', S = J L^-T and S' over lambda I = Q U,
//! x = L^-T Q_1 U^-T d, which costs digits as 1 / lambda only.

use std::sync::OnceLock;

use nalgebra::{DMatrix, DVector};

use crate::inverse::error::OneStepError;
use crate::inverse::prior::Penalty;
use crate::inverse::reciprocity::Fold;
use crate::linear_algebra::dense::{self, Definite};

/// Relative error of the map from the squared condition above which the orthogonal method is used.
const SQUARED: f64 = 1e-9;
/// Largest relative error of the map from rounding.
const WORTH: f64 = 1e-6;

/// A solved one-step problem: the map is one matrix-vector product away.
#[derive(Debug, Clone)]
pub(crate) struct DataSpace {
    /// x = matrix d.
    matrix: DMatrix<f64>,
    dual: Dual,
    square: f64,
}

/// u = dual d, symmetric.
#[derive(Debug, Clone)]
enum Dual {
    Known(DMatrix<f64>),
    /// The inverse of this matrix, made at the first frame with missing readings: no other needs it.
    Inverse(Box<(Definite, OnceLock<Option<DMatrix<f64>>>)>),
}

impl Dual {
    fn matrix(&self) -> Result<&DMatrix<f64>, OneStepError> {
        match self {
            Self::Known(matrix) => Ok(matrix),
            Self::Inverse(lazy) => {
                let (system, inverse) = lazy.as_ref();
                let inverse = inverse.get_or_init(|| system.inverse());
                inverse.as_ref().ok_or(OneStepError::Prior)
            }
        }
    }
}

impl DataSpace {
    /// Factors the problem. `lambda` must be positive and not negligible relative to the sensitivities.
    pub(crate) fn new(
        sensitivity: &DMatrix<f64>,
        penalty: &Penalty,
        lambda: f64,
    ) -> Result<Self, OneStepError> {
        let refused = |floor| OneStepError::Lambda { lambda, floor };
        if !(lambda.is_finite() && lambda > 0.0) {
            return Err(refused(0.0));
        }
        let square = lambda * lambda;
        let (spread, mut system) = match penalty {
            Penalty::Diagonal(entries) => {
                (None, dense::gram(sensitivity, |i| Some(1.0 / entries[i])))
            }
            Penalty::Laplacian(_) | Penalty::Smooth(_) => {
                let spread = penalty
                    .inverse_times_transposed(sensitivity)
                    .ok_or(OneStepError::Prior)?;
                let system = dense::product(dense::view(sensitivity), dense::view(&spread));
                (Some(spread), 0.5 * (&system + system.transpose()))
            }
        };
        let trace = system.trace();
        let floor = f64::EPSILON / WORTH * trace.sqrt();
        if lambda <= floor {
            return Err(refused(floor));
        }
        if f64::EPSILON * trace > SQUARED * square {
            return Self::orthogonal(sensitivity, penalty, lambda);
        }
        for i in 0..system.nrows() {
            system[(i, i)] += square;
        }
        let definite = Definite::new(&system).ok_or_else(|| refused(floor))?;
        let Some(spread) = spread else {
            let mut columns = sensitivity.clone();
            if let Penalty::Diagonal(entries) = penalty {
                for (mut column, entry) in columns.column_iter_mut().zip(entries) {
                    column /= *entry;
                }
            }
            definite.solve_columns(&mut columns);
            return Ok(Self {
                matrix: columns.transpose(),
                dual: Dual::Inverse(Box::new((definite, OnceLock::new()))),
                square,
            });
        };
        let mut dual = definite.inverse().ok_or_else(|| refused(floor))?;
        let Some(null) = penalty.null_space() else {
            let matrix = dense::product(dense::view(&spread), dense::view(&dual));
            return Ok(Self {
                matrix,
                dual: Dual::Known(dual),
                square,
            });
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
        Ok(Self {
            matrix,
            dual: Dual::Known(dual),
            square,
        })
    }

    /// The same without squaring the condition.
    fn orthogonal(
        sensitivity: &DMatrix<f64>,
        penalty: &Penalty,
        lambda: f64,
    ) -> Result<Self, OneStepError> {
        let rows = sensitivity.nrows();
        let null = penalty.null_space();
        // the unpenalised directions are fitted first; the rest is solved in their orthogonal complement
        let beside = match &null {
            None => DMatrix::identity(rows, rows),
            Some(null) => {
                let b = sensitivity * null;
                let size = sensitivity.norm();
                let qr = b.qr();
                let r = qr.r();
                if (0..r.nrows()).any(|i| r[(i, i)].abs() <= 1e-13 * size) {
                    return Err(OneStepError::Prior);
                }
                let q = qr.q();
                DMatrix::identity(rows, rows) - &q * q.transpose()
            }
        };
        let root = penalty.root(sensitivity).ok_or(OneStepError::Prior)?;
        let seen = if null.is_some() {
            dense::product(dense::view(&root.columns), dense::view(&beside))
        } else {
            root.columns.clone()
        };
        let unknowns = seen.nrows();
        let mut stacked = DMatrix::zeros(unknowns + rows, rows);
        stacked.rows_mut(0, unknowns).copy_from(&seen);
        for i in 0..rows {
            stacked[(unknowns + i, i)] = lambda;
        }
        let (q, inverse) = dense::thin_qr_and_inverse(&stacked).ok_or(OneStepError::Prior)?;
        // U^-T (I - b b^+)
        let after = dense::product(dense::view(&inverse).transpose(), dense::view(&beside));
        let top = q.rows(0, unknowns).into_owned();
        let map = dense::product(dense::view(&top), dense::view(&after));
        let dual = dense::product(dense::view(&after).transpose(), dense::view(&after));
        let dual = 0.5 * (&dual + dual.transpose());
        let level = match &null {
            None => None,
            Some(null) => {
                let b = sensitivity * null;
                let left = DMatrix::identity(rows, rows) - root.columns.tr_mul(&map);
                let qr = b.qr();
                let level = qr.r().solve_upper_triangular(&qr.q().tr_mul(&left));
                Some(level.ok_or(OneStepError::Prior)?)
            }
        };
        let mut matrix = root.back(&map);
        if let (Some(null), Some(level)) = (null, level) {
            matrix += null * level;
        }
        Ok(Self {
            matrix,
            dual: Dual::Known(dual),
            square: lambda * lambda,
        })
    }

    /// The map of complete folded data.
    pub(crate) fn apply(&self, data: &DVector<f64>) -> Vec<f64> {
        dense::times(&self.matrix, data)
    }

    /// Fills `missing` entries of the readings so that [`Self::apply`] gives exactly the map of the problem without
    /// those readings: with u = 0 there, the remaining rows are those of the smaller problem. With twins unfolded, the
    /// dual is F'DF + (I - F'F) / lambda^2, D the folded one.
    pub(crate) fn impute(
        &self,
        fold: &Fold,
        readings: &mut [f64],
        missing: &[usize],
    ) -> Result<(), OneStepError> {
        if missing.is_empty() {
            return Ok(());
        }
        for &reading in missing {
            readings[reading] = 0.0;
        }
        let dual = self.dual.matrix()?;
        let known = fold.data(readings);
        let pushed = dual * &known;
        // times lambda^2, which keeps the numbers moderate
        let block = DMatrix::from_fn(missing.len(), missing.len(), |i, j| {
            let ((p, a), (q, b)) = (fold.row(missing[i]), fold.row(missing[j]));
            let own = f64::from(u8::from(i == j)) - f64::from(u8::from(p == q)) * a * b;
            self.square * a * b * dual[(p, q)] + own
        });
        let pull: Vec<f64> = missing
            .iter()
            .map(|&reading| {
                let (row, share) = fold.row(reading);
                share * (known[row] - self.square * pushed[row])
            })
            .collect();
        let filled = dense::solve_definite(&block, &pull).ok_or(OneStepError::Prior)?;
        for (&reading, value) in missing.iter().zip(filled) {
            readings[reading] = value;
        }
        Ok(())
    }

    /// x = matrix d.
    pub(crate) fn matrix(&self) -> &DMatrix<f64> {
        &self.matrix
    }
}
