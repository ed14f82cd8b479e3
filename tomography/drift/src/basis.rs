//! Coordinates in which noise and drift are both uncorrelated: R becomes the identity, D per day a diagonal.
//!
//! A sheet that drifts as a random walk then consists of 299 independent walks, so covariances of any age need no
//! factorisation.

use eit::linear_algebra::{Definite, Rounded, product, symmetric_eigen, times, view};
use nalgebra::{DMatrix, DVector};

use crate::DriftError;
use crate::model::DriftModel;
use crate::sizes::Sizes;
use crate::whitened::{LoadTest, places_by_score};

/// Growth of the drift per square root of a day at pace 1.
pub(crate) const PER_DAY: Sizes = Sizes {
    gain: 0.01,
    contact: 0.08,
    field: 2e-3,
    local: 2e-3,
};

/// The transform to these coordinates, with the transformed atoms of the load test.
pub(crate) struct Basis {
    transform: DMatrix<f32>,
    /// Variance per day in units of the noise.
    pub(crate) growth: DVector<f64>,
    /// Variance of local change of standard deviation 1, without correlations between coordinates.
    pub(crate) local: DVector<f64>,
    atoms: Rounded,
    atoms_squared: Rounded,
}

impl Basis {
    pub(crate) fn new(model: &DriftModel) -> Result<Self, DriftError> {
        let factor = Definite::new(&model.noise).ok_or(DriftError::Covariance)?;
        let n = model.noise.nrows();
        let whiten = |matrix: &DMatrix<f64>| {
            let mut once = matrix.clone();
            factor.whiten(&mut once);
            let mut twice = once.transpose();
            factor.whiten(&mut twice);
            twice.fill_upper_triangle_with_lower_triangle();
            twice
        };
        let (growth, vectors) =
            symmetric_eigen(&whiten(&model.drift(&PER_DAY))).ok_or(DriftError::Covariance)?;
        let mut transform = DMatrix::identity(n, n);
        factor.whiten(&mut transform);
        let transform = product(view(&vectors.transpose()), view(&transform));
        let atoms = product(view(&transform), view(&model.atoms));
        let local = {
            let once = product(view(&transform), view(&model.local_gram));
            let both = product(view(&once), view(&transform.transpose()));
            both.diagonal()
        };
        Ok(Self {
            atoms_squared: Rounded::new(&atoms.map(|value| value * value)),
            atoms: Rounded::new(&atoms),
            local,
            growth: DVector::from_vec(growth).map(|value| value.max(0.0)),
            transform: transform.map(|value| value as f32),
        })
    }

    /// Transforms data to these coordinates.
    pub(crate) fn of(&self, data: &DVector<f64>) -> DVector<f64> {
        DVector::from_vec(times(&self.transform, data))
    }

    /// Squared norms of the whitened load test discs at these variances.
    pub(crate) fn squares(&self, variances: &DVector<f64>) -> DVector<f64> {
        let weights = variances.map(|variance| 1.0 / variance);
        self.atoms_squared.transposed_times(&weights)
    }

    /// The best discs for data with these variances, best first. `squares` is the result of [`Basis::squares`] for
    /// them.
    pub(crate) fn load_tests(
        &self,
        model: &DriftModel,
        data: &DVector<f64>,
        variances: &DVector<f64>,
        squares: &DVector<f64>,
        most: usize,
    ) -> Vec<LoadTest> {
        let weights = variances.map(|variance| 1.0 / variance);
        let dots = self.atoms.transposed_times(&data.component_mul(&weights));
        places_by_score(model, &dots, squares, most)
    }
}
