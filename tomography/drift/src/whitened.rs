//! Data and sensitivity whitened by a covariance: the input of linear methods instead of raw changes.

use std::sync::Arc;

use eit::linear_algebra::{Definite, Rounded};
use nalgebra::{DMatrix, DVector};

use crate::DriftError;
use crate::model::{DriftModel, Place};

/// Improvement of chi squared by a disc above which a frame counts as loaded, or a step as an event.
pub(crate) const LOADED: f64 = 45.0;

/// Data d with covariance S = L L', stored as L^-1 d. Rows without a value are omitted (marginalised).
#[derive(Debug, Clone)]
pub struct Whitened {
    factor: Arc<Definite>,
    rows: Vec<usize>,
    raw: DVector<f64>,
    data: DVector<f64>,
    of: usize,
}

/// The best disc of the load test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LoadTest {
    /// Improvement of chi squared.
    pub(crate) score: f64,
    /// Change of ln conductance in the disc.
    pub(crate) change: f64,
    pub(crate) place: Place,
}

impl Whitened {
    /// Whitens data (V, one per pair) by a covariance (V2), using only these rows.
    ///
    /// # Errors
    /// A covariance that is not positive definite.
    pub fn new(
        covariance: &DMatrix<f64>,
        data: &DVector<f64>,
        rows: &[usize],
    ) -> Result<Self, DriftError> {
        Ok(Self::with(Arc::new(factor(covariance, rows)?), data, rows))
    }

    pub(crate) fn with(factor: Arc<Definite>, data: &DVector<f64>, rows: &[usize]) -> Self {
        let mut white = Self {
            factor,
            rows: rows.to_vec(),
            raw: DVector::zeros(0),
            data: DVector::zeros(0),
            of: data.len(),
        };
        white.set(data);
        white
    }

    /// Replaces the data; the covariance stays the same.
    pub(crate) fn set(&mut self, data: &DVector<f64>) {
        self.raw = data.select_rows(&self.rows);
        self.data = self.column(data);
    }

    /// L^-1 d.
    pub fn data(&self) -> &DVector<f64> {
        &self.data
    }

    /// The data before whitening, V, one per pair; zero in unused rows.
    pub(crate) fn raw(&self) -> DVector<f64> {
        self.spread(&self.raw)
    }

    /// Expands a value for each used row to a value for each pair; zero in unused rows.
    fn spread(&self, values: &DVector<f64>) -> DVector<f64> {
        let mut out = DVector::zeros(self.of);
        for (&row, value) in self.rows.iter().zip(values) {
            out[row] = *value;
        }
        out
    }

    /// The used rows, ascending.
    pub fn rows(&self) -> &[usize] {
        &self.rows
    }

    /// Chi squared of the data divided by their number.
    pub fn chi_per_row(&self) -> f64 {
        self.data.norm_squared() / self.rows.len() as f64
    }

    /// ln det S.
    pub(crate) fn log_determinant(&self) -> f64 {
        self.factor.log_determinant()
    }

    /// L^-1 J for a sensitivity with a row for each pair.
    pub fn sensitivity(&self, sensitivity: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = match self.rows.len() == self.of {
            true => sensitivity.clone(),
            false => sensitivity.select_rows(&self.rows),
        };
        self.factor.whiten(&mut out);
        out
    }

    /// L^-1 a for one column.
    pub(crate) fn column(&self, column: &DVector<f64>) -> DVector<f64> {
        whiten(&self.factor, &column.select_rows(&self.rows))
    }

    /// S^-1 d, zero in unused rows.
    pub(crate) fn weights(&self) -> DVector<f64> {
        self.spread(&self.factor.unwhiten_transposed(&self.data))
    }

    /// The one-step map of the whitened data: change of ln conductance of each triangle, negative for a loss. `size`:
    /// prior standard deviation of local change.
    ///
    /// # Errors
    /// None if `size` is positive.
    pub fn one_step(&self, model: &DriftModel, size: f64) -> Result<Vec<f64>, DriftError> {
        // S + size^2 X X' is factored: cheaper than whitening the sensitivity
        let n = self.rows.len();
        let white = self.whitened_gram(model);
        let system = DMatrix::identity(n, n) + white * size.powi(2);
        let factor = Definite::new(&system).ok_or(DriftError::Covariance)?;
        let inner = factor.solve(&self.data);
        let weights = self.factor.unwhiten_transposed(&inner) * size.powi(2);
        Ok(model.local_map(&self.spread(&weights)))
    }

    /// L^-1 X X' L^-T.
    fn whitened_gram(&self, model: &DriftModel) -> DMatrix<f64> {
        let once = self.sensitivity(&model.local_gram);
        let mut turned = match self.rows.len() == self.of {
            true => once.transpose(),
            false => once.select_columns(&self.rows).transpose(),
        };
        self.factor.whiten(&mut turned);
        turned.fill_upper_triangle_with_lower_triangle();
        turned
    }

    /// The data with independent errors of these standard deviations added to the covariance.
    pub(crate) fn with_error(&self, deviations: &DVector<f64>) -> Result<Self, DriftError> {
        let mut covariance = self.factor.matrix();
        for (k, &row) in self.rows.iter().enumerate() {
            covariance[(k, k)] += deviations[row].powi(2);
        }
        let factor = Definite::new(&covariance).ok_or(DriftError::Covariance)?;
        Ok(Self {
            data: whiten(&factor, &self.raw),
            factor: Arc::new(factor),
            ..self.clone()
        })
    }

    /// Compares the data with discs on a grid: the disc with the largest improvement of chi squared.
    pub(crate) fn load_test(&self, model: &DriftModel) -> Option<LoadTest> {
        self.load_tests(model, 1).into_iter().next()
    }

    /// The best discs that are at least 25 mm apart, best first.
    pub(crate) fn load_tests(&self, model: &DriftModel, most: usize) -> Vec<LoadTest> {
        Atoms::new(&self.sensitivity(&model.atoms)).best(&self.data, model, most)
    }
}

/// Whitened data of the load test's discs, with precomputed quantities that do not depend on the data.
#[derive(Debug)]
pub(crate) struct Atoms {
    columns: Rounded,
    squares: DVector<f64>,
}

impl Atoms {
    pub(crate) fn new(columns: &DMatrix<f64>) -> Self {
        Self {
            squares: DVector::from_fn(columns.ncols(), |k, _| columns.column(k).norm_squared()),
            columns: Rounded::new(columns),
        }
    }

    /// The places that explain the whitened data best.
    pub(crate) fn best(
        &self,
        data: &DVector<f64>,
        model: &DriftModel,
        most: usize,
    ) -> Vec<LoadTest> {
        let dots = self.columns.transposed_times(data);
        places_by_score(model, &dots, &self.squares, most)
    }
}

/// The best places that are at least 25 mm apart, from the products of atoms with data and the squared atoms.
pub(crate) fn places_by_score(
    model: &DriftModel,
    dots: &DVector<f64>,
    squares: &DVector<f64>,
    most: usize,
) -> Vec<LoadTest> {
    const APART_M: f64 = 25e-3;
    let square = |[x, y]: [f64; 2]| x * x + y * y;
    let mut scores: Vec<f64> = dots
        .iter()
        .zip(squares)
        .map(|(dot, square)| dot * dot / square)
        .collect();
    let mut found: Vec<LoadTest> = Vec::new();
    while found.len() < most {
        // places near one that was already found are excluded
        let mut best = None;
        for (k, &score) in scores.iter().enumerate() {
            if score.is_finite() && best.is_none_or(|(_, other)| score > other) {
                best = Some((k, score));
            }
        }
        let Some((k, score)) = best else { break };
        let place = model.places[k];
        found.push(LoadTest {
            score,
            change: dots[k] / squares[k],
            place,
        });
        if found.len() == most {
            break;
        }
        for (score, other) in scores.iter_mut().zip(&model.places) {
            let (p, q) = (place.centre, other.centre);
            if square([p[0] - q[0], p[1] - q[1]]) < APART_M * APART_M {
                *score = f64::NAN;
            }
        }
    }
    found
}

/// L^-1 a for one column with a value for each row of the factor.
fn whiten(factor: &Definite, column: &DVector<f64>) -> DVector<f64> {
    let mut out = DMatrix::from_column_slice(column.len(), 1, column.as_slice());
    factor.whiten(&mut out);
    DVector::from_column_slice(out.as_slice())
}

/// Factors a covariance, using only these rows.
pub(crate) fn factor(covariance: &DMatrix<f64>, rows: &[usize]) -> Result<Definite, DriftError> {
    let factor = match rows.len() == covariance.nrows() {
        true => Definite::new(covariance),
        false => Definite::new(&covariance.select_rows(rows).select_columns(rows)),
    };
    factor.ok_or(DriftError::Covariance)
}
