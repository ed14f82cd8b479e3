//! Separates the drift in one frame from a load, so that any method can compare the frame with the drifted baseline.
//!
//! The map x that explains data d = J x + b + noise with drift b ~ N(0, D) is the same whether b is minimised over or
//! the data are whitened by R + D: min over b of |d - J x - b|^2_R + |b|^2_D is |d - J x|^2_(R + D). A method that uses
//! d - b for the most probable b therefore needs no covariance. Here b is the most probable drift beside a load that is
//! a disc, or, if no disc explains the frame, beside a load of any shape (`any_shape`).

use eit::linear_algebra::symmetric_eigen;
use nalgebra::{DMatrix, DVector};
use survey::Reading;

use super::any_shape::Prior;
use crate::DriftError;
use crate::disc::{DiscFit, MODEL_SHARE};
use crate::model::DriftModel;
use crate::sizes::Sizes;
use crate::whitened::Whitened;

/// Share of the prior standard deviation above which the frame carries no information about a triangle.
const UNRESOLVED: f64 = 0.9;
/// Smallest standard deviation of ln conductance assumed for a load; it applies also to empty frames, whose map has
/// this uncertainty.
const LEAST_LOAD: f64 = 0.05;

/// The drift since the baseline in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameDrift {
    /// Most probable sizes; `local` is the size of the load.
    pub sizes: Sizes,
    /// Most probable change of the data caused by drift alone, V, one value per pair.
    pub change: DVector<f64>,
    /// Whether a disc explains the data after subtraction of the drift.
    pub is_disc: bool,
    /// Largest linear change of conductance that the load may have, 0 to 2; 0 without a load.
    pub load: f64,
}

/// Uncertainty of each triangle's change of ln conductance given one frame, by the linear model.
#[derive(Debug, Clone, PartialEq)]
pub struct MapDeviation {
    /// Standard deviation of each triangle of [`DriftModel::mesh`].
    pub deviation: Vec<f64>,
    /// Whether the frame carries information about each triangle.
    pub resolved: Vec<bool>,
}

impl MapDeviation {
    /// The standard deviation of each triangle, NaN if the frame carries no information about it.
    pub fn values(&self) -> Vec<f64> {
        let each = self.deviation.iter().zip(&self.resolved);
        each.map(|(sd, resolved)| if *resolved { *sd } else { f64::NAN })
            .collect()
    }
}

impl DriftModel {
    /// Separates the drift in one frame from the load.
    ///
    /// # Errors
    /// Data that are not finite.
    pub fn frame_drift(
        &self,
        data: &DVector<f64>,
        rows: &[usize],
    ) -> Result<FrameDrift, DriftError> {
        let assessed = self.assess(data, rows)?;
        let sizes = assessed.sizes;
        let white = &assessed.whitened;
        let (fit, largest) = white.fit_disc_and_change(self, &white.load_tests(self, 3))?;
        let (sizes, change) = match fit.accepted {
            true => {
                let drift = Prior::Kinds.covariance(self, &sizes);
                (sizes, self.drift_beside_disc(&drift, white, &fit)?)
            }
            false => {
                let noise = self.noise() * 2.0;
                self.drift_beside_any_shape(Prior::Kinds, &noise, data, rows)?
            }
        };
        Ok(FrameDrift {
            sizes,
            change,
            is_disc: fit.accepted,
            load: match fit.is_load() {
                true => largest,
                false => 0.0,
            },
        })
    }

    /// The most probable drift beside the load of a frame, as a change of the data, V, if the covariance of the drift
    /// is known (V2). `white`: the data whitened by noise and that drift; `fit`: the disc fitted to them.
    pub(crate) fn drift_beside_load(
        &self,
        drift: &DMatrix<f64>,
        noise: &DMatrix<f64>,
        white: &Whitened,
        fit: &DiscFit,
    ) -> Result<DVector<f64>, DriftError> {
        if fit.accepted {
            return self.drift_beside_disc(drift, white, fit);
        }
        let prior = Prior::Covariance(drift);
        let (_, change) = self.drift_beside_any_shape(prior, noise, &white.raw(), white.rows())?;
        Ok(change)
    }

    /// Like [`Self::drift_beside_load`], for a load that is a disc.
    fn drift_beside_disc(
        &self,
        drift: &DMatrix<f64>,
        white: &Whitened,
        fit: &DiscFit,
    ) -> Result<DVector<f64>, DriftError> {
        // `load` is positive for a loss
        let change = -fit.load / fit.disc.diameter.powi(2);
        let load = self.disc(fit.disc.centre, fit.disc.diameter) * change;
        let mut beside = white.with_error(&(&load * MODEL_SHARE))?;
        beside.set(&(white.raw() - load));
        Ok(drift * beside.weights())
    }

    /// Posterior standard deviation of local change, given a frame with this drift and these rows. The prior standard
    /// deviation of local change is that of the load: the most probable size for the whole sheet is far below the
    /// change under a load.
    ///
    /// # Errors
    /// A covariance that cannot be factored.
    pub fn map_deviation(
        &self,
        drift: &FrameDrift,
        rows: &[usize],
    ) -> Result<MapDeviation, DriftError> {
        let errors = self.noise() * 2.0 + Prior::Kinds.covariance(self, &drift.sizes);
        self.map_deviation_beside(errors, drift.load, rows)
    }

    /// The posterior of local change if the errors of the data have this covariance, V2. Its prior standard deviation
    /// is `local`, but at least the smallest one assumed for a load.
    pub(crate) fn map_deviation_beside(
        &self,
        errors: DMatrix<f64>,
        local: f64,
        rows: &[usize],
    ) -> Result<MapDeviation, DriftError> {
        let local = local.max(LEAST_LOAD);
        let before = local.powi(2);
        // the posterior covariance of a linear model does not depend on the data
        let none = DVector::zeros(self.pairs().len());
        let white = Whitened::new(&(errors + &self.local_gram * before), &none, rows)?;
        let resolved: DMatrix<f64> = white.sensitivity(&self.local_map.transpose());
        let of_cells: Vec<f64> = resolved
            .column_iter()
            .map(|column| (1.0 - before * column.norm_squared()).max(0.0).sqrt())
            .collect();
        let shares = self.cell_of_triangle().iter().map(|&cell| of_cells[cell]);
        Ok(MapDeviation {
            deviation: shares.clone().map(|share| local * share).collect(),
            resolved: shares.map(|share| share <= UNRESOLVED).collect(),
        })
    }

    /// Changes of the readings, V, whose random combinations have the covariance of drift of these sizes. Components
    /// with a standard deviation in the data below `least_v` are omitted.
    ///
    /// # Errors
    /// The covariance has no eigenvalue decomposition.
    pub fn drift_rows(&self, sizes: &Sizes, least_v: f64) -> Result<Vec<Vec<f64>>, DriftError> {
        let (values, vectors) =
            symmetric_eigen(&self.drift(sizes)).ok_or(DriftError::Covariance)?;
        let kept = (0..values.len()).filter(|&k| values[k] > least_v * least_v);
        let rows = kept.map(|k| {
            let changed = self.baseline_with(&(vectors.column(k) * values[k].sqrt()));
            let changes = changed.iter().zip(self.baseline());
            let change = |(now, before): (&Reading, &f64)| Some(now.volts()?.0 - before);
            changes.filter_map(change).collect()
        });
        Ok(rows.collect())
    }
}
