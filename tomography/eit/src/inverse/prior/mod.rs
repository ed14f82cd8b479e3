//! Priors: the matrix R of x'Rx, and products with its inverse.

mod laplacian;
mod smooth;

use std::borrow::Cow;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::Mesh;
use crate::inverse::error::OneStepError;
pub(crate) use crate::inverse::prior::laplacian::{Half, Laplacian, block_of_columns};
use crate::inverse::prior::laplacian::{block_of_rows, matrix_of};
pub(crate) use crate::inverse::prior::smooth::Smooth;
use crate::linear_algebra::sparse::Block;

/// The prior of a one-step reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind")]
pub enum Prior {
    /// R = I.
    Tikhonov,
    /// R = diag(J'J)^p: p = 0.5 compensates half of the variation of the sensitivity, p = 1 all of it.
    Noser {
        /// The exponent p.
        p: f64,
    },
    /// R = twice the graph Laplacian of the triangles that share an edge (the scale of EIDORS). Its null space, the
    /// constants on each connected part, is exactly unpenalised.
    Laplace,
    /// R = L'L with L the difference across each border times its length (m): the paper's Eq. 5 inside the square of its
    /// Eq. 4, as printed, so not total variation. Its null space is the constant.
    Variation,
    /// R^-1 is a covariance: variance 1 everywhere, correlation exp(-r^2 / 2 l^2) at distance r. Smooth maps.
    Gaussian {
        /// l, m.
        length_m: f64,
    },
}

/// Default length of [`Prior::Gaussian`], m.
pub const SMOOTH_LENGTH_M: f64 = 0.01;

/// The prior of [`crate::OneStepOptions::default`].
pub(crate) const ONE_STEP_NOSER: Prior = Prior::Noser { p: 0.25 };

impl Default for Prior {
    fn default() -> Self {
        Self::Noser { p: 0.5 }
    }
}

impl Prior {
    /// NOSER with the given exponent. Default: 0.5 if the prior was named, as in the literature; otherwise the prior of
    /// [`crate::OneStepOptions::default`].
    pub fn noser(named: bool, exponent: Option<f64>) -> Self {
        match exponent {
            Some(p) => Self::Noser { p },
            None if named => Self::default(),
            None => ONE_STEP_NOSER,
        }
    }

    /// User-readable name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tikhonov => "tikhonov",
            Self::Noser { .. } => "noser",
            Self::Laplace => "laplace",
            Self::Variation => "quadratic variation",
            Self::Gaussian { .. } => "gaussian",
        }
    }
}

/// If the whole sheet is unknown, the penalty outside of the region is multiplied by this factor: a diagonal prior's
/// standard deviation is a third there. With a factor of 1, the unknowns near the edge, to which the readings are most
/// sensitive, absorb part of a small load inside the region (presses of 10 mm, 2 uV: correlation 0.368 instead of
/// 0.393); from 64 on they absorb too little of real changes there.
pub const OUTSIDE_WEIGHT: f64 = 9.0;

/// The unknowns that maps show: all if `shown` is `None`.
pub(crate) fn shown_or_all(shown: Option<&[usize]>, unknowns: usize) -> Cow<'_, [usize]> {
    match shown {
        Some(shown) => Cow::Borrowed(shown),
        None => Cow::Owned((0..unknowns).collect()),
    }
}

/// For each unknown, whether maps omit it; `shown` as in [`OneStepOptions::shown`](crate::OneStepOptions).
pub(crate) fn outside(shown: Option<&[usize]>, unknowns: usize) -> Vec<bool> {
    let mut outside = vec![shown.is_some(); unknowns];
    for &unknown in shown.into_iter().flatten() {
        outside[unknown] = false;
    }
    outside
}

/// R of one prior on one mesh.
#[derive(Debug, Clone)]
pub(crate) enum Penalty {
    /// R is diagonal: its entries, all positive.
    Diagonal(Vec<f64>),
    /// R is the weighted graph Laplacian of some edges.
    Laplacian(Laplacian),
    /// R^-1 is a smooth covariance.
    Smooth(Smooth),
}

/// EIDORS' scale of the Laplace prior: each shared edge adds 2 to both diagonals.
pub(crate) const LAPLACE_WEIGHT: f64 = 2.0;

/// Number of unit right sides solved together.
const AT_A_TIME: usize = 256;

impl Penalty {
    /// R = I.
    pub(crate) fn identity(unknowns: usize) -> Self {
        Self::Diagonal(vec![1.0; unknowns])
    }

    /// R = diag(J'J)^p. Triangles without sensitivity keep 1e-12 of the largest entry, so that R stays invertible.
    pub(crate) fn noser(sensitivity: &DMatrix<f64>, p: f64) -> Self {
        let squares: Vec<f64> = sensitivity
            .column_iter()
            .map(|column| column.norm_squared())
            .collect();
        let largest = squares.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        Self::Diagonal(
            squares
                .into_iter()
                .map(|square| square.max(1e-12 * largest).powf(p))
                .collect(),
        )
    }

    /// Multiplies the entries of unknowns that maps omit by [`OUTSIDE_WEIGHT`]; only a diagonal R has separate entries
    /// for each unknown.
    pub(crate) fn weigh(&mut self, outside: &[bool]) {
        if let Self::Diagonal(entries) = self {
            for (entry, outside) in entries.iter_mut().zip(outside) {
                if *outside {
                    *entry *= OUTSIDE_WEIGHT;
                }
            }
        }
    }

    /// The squared differences across the borders of the region's triangles, each times the weight of a border of its
    /// length (m).
    pub(crate) fn of_borders(mesh: &Mesh, weight: impl Fn(f64) -> f64) -> Self {
        let (edges, weights) = mesh
            .borders(mesh.region())
            .into_iter()
            .map(|(edge, length)| (edge, weight(length)))
            .unzip();
        Self::Laplacian(Laplacian::new(mesh.region_centroids(), edges, weights))
    }

    /// A covariance of correlation length `length_m` over the mesh's region.
    pub(crate) fn smooth(mesh: &Mesh, length_m: f64) -> Result<Self, OneStepError> {
        OneStepError::positive("length of the gaussian prior", length_m)?;
        let (points, areas) = (mesh.region_centroids(), mesh.region_areas());
        Ok(Self::Smooth(Smooth::new(&points, &areas, length_m)))
    }

    /// The Frobenius norm of J R^-1/2, without the null space.
    pub(crate) fn size(&self, sensitivity: &DMatrix<f64>) -> Option<f64> {
        if let Self::Diagonal(entries) = self {
            let square: f64 = sensitivity
                .column_iter()
                .zip(entries)
                .map(|(column, entry)| column.norm_squared() / entry)
                .sum();
            return Some(square.sqrt());
        }
        Some(self.root(sensitivity)?.columns.norm())
    }

    /// R x; zero if R is not explicit.
    pub(crate) fn times(&self, x: &[f64]) -> Vec<f64> {
        match self {
            Self::Diagonal(entries) => x.iter().zip(entries).map(|(x, r)| x * r).collect(),
            Self::Laplacian(laplacian) => laplacian.times(x),
            Self::Smooth(_) => vec![0.0; x.len()],
        }
    }

    /// The columns of R's null space, one per connected part; none if R is invertible.
    pub(crate) fn null_space(&self) -> Option<DMatrix<f64>> {
        match self {
            Self::Diagonal(_) | Self::Smooth(_) => None,
            Self::Laplacian(laplacian) => Some(laplacian.null_space()),
        }
    }

    /// R^-1 J', or R^+ J' with the pseudo-inverse if R is singular: the caller adds the null space itself.
    pub(crate) fn inverse_times_transposed(
        &self,
        sensitivity: &DMatrix<f64>,
    ) -> Option<DMatrix<f64>> {
        if let Self::Diagonal(entries) = self {
            let mut spread = sensitivity.transpose();
            for mut column in spread.column_iter_mut() {
                for (value, entry) in column.iter_mut().zip(entries) {
                    *value /= entry;
                }
            }
            return Some(spread);
        }
        let root = self.root(sensitivity)?;
        Some(root.back(&root.columns))
    }

    /// S' = L^-1 J' with R = L L'; if R is singular, of J without its null space.
    pub(crate) fn root(&self, sensitivity: &DMatrix<f64>) -> Option<Root<'_>> {
        let (columns, half) = match self {
            Self::Diagonal(entries) => {
                let mut columns = sensitivity.transpose();
                for mut column in columns.column_iter_mut() {
                    for (value, entry) in column.iter_mut().zip(entries) {
                        *value /= entry.sqrt();
                    }
                }
                (columns, None)
            }
            Self::Laplacian(laplacian) => {
                let mut block = block_of_columns(sensitivity);
                laplacian.remove_means(&mut block);
                let half = laplacian.grounded()?;
                let halved = half.down(&block);
                (matrix_of(&halved, sensitivity.nrows()), Some(half))
            }
            Self::Smooth(smooth) => (smooth.seen(sensitivity).transpose(), None),
        };
        Some(Root {
            penalty: self,
            columns,
            half,
        })
    }

    /// The factor g for which the prior N(0, g^2 R^-1) has the root mean square `change` over the unknowns that are
    /// shown (`None`: all), without the null space.
    pub(crate) fn amplitude(
        &self,
        change: f64,
        shown: Option<&[usize]>,
    ) -> Result<f64, OneStepError> {
        let shown = shown_or_all(shown, self.unknowns());
        let trace = match self {
            Self::Diagonal(entries) => shown.iter().map(|&unknown| 1.0 / entries[unknown]).sum(),
            // the squares of L^-1 outside the null space, some columns at a time
            Self::Laplacian(laplacian) => {
                let unknowns = laplacian.unknowns();
                let half = laplacian.grounded().ok_or(OneStepError::Prior)?;
                let mut trace = 0.0;
                for some in shown.chunks(AT_A_TIME) {
                    let mut block = Block::zeros(unknowns, some.len());
                    for (k, &unknown) in some.iter().enumerate() {
                        block.row_mut(unknown)[k] = 1.0;
                    }
                    laplacian.remove_means(&mut block);
                    let halved = half.down(&block);
                    trace += halved.values.iter().map(|value| value * value).sum::<f64>();
                }
                trace
            }
            Self::Smooth(_) => shown.len() as f64,
        };
        Ok(change / (trace / shown.len() as f64).sqrt())
    }

    /// Number of unknowns.
    fn unknowns(&self) -> usize {
        match self {
            Self::Diagonal(entries) => entries.len(),
            Self::Laplacian(laplacian) => laplacian.unknowns(),
            Self::Smooth(smooth) => smooth.unknowns(),
        }
    }
}

/// A sensitivity multiplied by the root of a prior.
pub(crate) struct Root<'a> {
    penalty: &'a Penalty,
    /// S', a column per reading.
    pub(crate) columns: DMatrix<f64>,
    half: Option<Half>,
}

impl Root<'_> {
    /// L^-T z: the maps of these coefficients, one per column.
    pub(crate) fn back(&self, z: &DMatrix<f64>) -> DMatrix<f64> {
        match (self.penalty, &self.half) {
            (Penalty::Laplacian(laplacian), Some(half)) => {
                let mut block = half.up(block_of_rows(z), laplacian.unknowns());
                laplacian.remove_means(&mut block);
                matrix_of(&block, z.ncols())
            }
            (Penalty::Smooth(smooth), _) => smooth.spread(z),
            (Penalty::Diagonal(entries), _) => {
                let mut maps = z.clone();
                for mut column in maps.column_iter_mut() {
                    for (value, entry) in column.iter_mut().zip(entries) {
                        *value /= entry.sqrt();
                    }
                }
                maps
            }
            // `root` creates a factor for every Laplacian
            (Penalty::Laplacian(_), None) => z.clone(),
        }
    }
}
