//! The probability of data under a linear model of maps and white noise, in the eigenbasis of the maps' covariance.
//!
//! With x ~ N(0, g^2 R^-1) and white noise s, data are N(0, g^2 (J R^-1 J' + q I)), q = s^2 / g^2. For each q of a grid the
//! best g^2 has a closed form.

use std::ops::RangeInclusive;

use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DVector, DefaultAllocator, Dim, Dyn, OMatrix};

use crate::linear_algebra::dense;

/// The covariance J R^-1 J' of the data of maps of size 1, decomposed.
pub(crate) struct Evidence {
    /// Eigenvalues, none below 0.
    pub(crate) values: Vec<f64>,
    vectors: DMatrix<f64>,
    /// Ratios q, ascending, and the sum of the logarithms of the variances for each.
    candidates: Vec<(f64, f64)>,
}

/// The most probable size of maps for one ratio.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fit {
    /// q, the variance of errors over that of maps.
    pub(crate) ratio: f64,
    /// g^2.
    pub(crate) scale: f64,
    /// Minus twice the logarithm of the probability, up to a constant.
    surprise: f64,
}

impl Fit {
    /// Standard deviation of the errors.
    pub(crate) fn error(&self) -> f64 {
        (self.scale * self.ratio).sqrt()
    }
}

impl Evidence {
    /// `steps`: the ratios, as logarithmic steps relative to the largest eigenvalue, `per_decade` of them per decade.
    /// `None` if the decomposition fails.
    pub(crate) fn new(
        gram: &DMatrix<f64>,
        steps: RangeInclusive<i32>,
        per_decade: i32,
    ) -> Option<Self> {
        let (values, vectors) = dense::symmetric_eigen(gram)?;
        let values: Vec<f64> = values.into_iter().map(|value| value.max(0.0)).collect();
        let top = values.iter().copied().fold(0.0, f64::max);
        let candidates = steps
            .map(|step| {
                let ratio = top * 10_f64.powf(f64::from(step) / f64::from(per_decade));
                let logs = values.iter().map(|value| (value + ratio).ln()).sum();
                (ratio, logs)
            })
            .collect();
        Some(Self {
            values,
            vectors,
            candidates,
        })
    }

    /// Components of data (columns) in the eigenbasis.
    pub(crate) fn along<C: Dim>(&self, data: &OMatrix<f64, Dyn, C>) -> OMatrix<f64, Dyn, C>
    where
        DefaultAllocator: Allocator<Dyn, C>,
    {
        self.vectors.tr_mul(data)
    }

    /// The eigenvectors, as columns.
    pub(crate) fn vectors(&self) -> &DMatrix<f64> {
        &self.vectors
    }

    /// The ratios.
    pub(crate) fn ratios(&self) -> impl Iterator<Item = f64> + '_ {
        self.candidates.iter().map(|(ratio, _)| *ratio)
    }

    /// g^2 of the most probable maps for one ratio, for data with these squared components.
    pub(crate) fn scale(&self, squares: &DVector<f64>, ratio: f64) -> f64 {
        let sum: f64 = squares
            .iter()
            .zip(&self.values)
            .map(|(square, value)| square / (value + ratio))
            .sum();
        sum / squares.len() as f64
    }

    /// Twice the logarithm of the ratio of two probabilities of the data: with the most probable fit, and with errors
    /// of the standard deviation `error` alone.
    pub(crate) fn preference(&self, squares: &DVector<f64>, error: f64, fit: &Fit) -> f64 {
        let variance = error * error;
        let nothing = squares.len() as f64 * variance.ln() + squares.sum() / variance;
        nothing - fit.surprise
    }

    /// The most probable fit to data with these squared components, with errors of at least the standard deviation
    /// `floor`; `None` without data.
    pub(crate) fn best(&self, squares: &DVector<f64>, floor: f64) -> Option<Fit> {
        let count = squares.len() as f64;
        let fits = self.candidates.iter().map(|&(ratio, logs)| {
            let free = self.scale(squares, ratio);
            let scale = free.max(floor * floor / ratio);
            Fit {
                ratio,
                scale,
                surprise: count * (scale.ln() + free / scale) + logs,
            }
        });
        fits.min_by(|a, b| a.surprise.total_cmp(&b.surprise))
            .filter(|fit| fit.surprise.is_finite())
    }
}
