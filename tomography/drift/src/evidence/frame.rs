//! The drift in one frame, separated from a load: what any method compares the frame with.
//!
//! The map x that explains data d = J x + b + noise with drift b ~ N(0, D) is the same whether b is minimised over or the data
//! are whitened by R + D: min over b of |d - J x - b|^2_R + |b|^2_D is |d - J x|^2_(R + D). A method that takes d - b for the
//! most probable b therefore needs no covariance of its own. Here b is the most probable drift beside a load that is a
//! disc, or, where no disc explains the frame, beside a load of any shape (`any_shape`).

use eit::linear_algebra::symmetric_eigen;
use nalgebra::{DMatrix, DVector};
use survey::Reading;

use super::any_shape::Prior;
use crate::DriftError;
use crate::disc::{DiscFit, MODEL_SHARE};
use crate::model::DriftModel;
use crate::sizes::Sizes;
use crate::whitened::Whitened;

/// Share of the standard deviation before the frame above which the frame says nothing of a triangle.
const UNRESOLVED: f64 = 0.9;
/// Standard deviation of ln conductance that a load may have, at least: an empty frame is uncertain by what it would show.
const LEAST_LOAD: f64 = 0.05;

/// The drift since the baseline in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameDrift {
    /// Most probable sizes; `local` is that of the load.
    pub sizes: Sizes,
    /// Most probable change of the data by drift alone, V, one for each pair.
    pub change: DVector<f64>,
    /// Whether a disc explains what is not drift.
    pub is_disc: bool,
    /// Largest linear change of conductance that the load may have, 0 to 2; 0 where there is none.
    pub load: f64,
}

/// How exactly a frame tells each triangle's change of ln conductance, by the linear model.
#[derive(Debug, Clone, PartialEq)]
pub struct MapDeviation {
    /// Standard deviation of each triangle of [`DriftModel::mesh`].
    pub deviation: Vec<f64>,
    /// Whether the frame says anything of a triangle.
    pub resolved: Vec<bool>,
}

impl MapDeviation {
    /// The standard deviation of each triangle, NaN if the frame gives no information about it.
    pub fn values(&self) -> Vec<f64> {
        let each = self.deviation.iter().zip(&self.resolved);
        each.map(|(sd, resolved)| if *resolved { *sd } else { f64::NAN })
            .collect()
    }
}

impl DriftModel {
    /// Separates the drift in one frame from its load.
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

    /// The drift beside the load of a frame, where the covariance of the drift is known (V2): its most probable change of the data, V.
    /// `white`: the data whitened by noise and that drift; `fit`: the disc in them.
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

    /// The same beside a disc.
    fn drift_beside_disc(
        &self,
        drift: &DMatrix<f64>,
        white: &Whitened,
        fit: &DiscFit,
    ) -> Result<DVector<f64>, DriftError> {
        // `load` is a loss
        let change = -fit.load / fit.disc.diameter.powi(2);
        let load = self.disc(fit.disc.centre, fit.disc.diameter) * change;
        let mut beside = white.with_error(&(&load * MODEL_SHARE))?;
        beside.set(&(white.raw() - load));
        Ok(drift * beside.weights())
    }

    /// How exactly a frame with this drift and these rows tells the map: the posterior of local change. Before the frame, local change
    /// is as large as the load's: what is most probable for all of the sheet is far less than what lies under a load.
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

    /// The posterior of local change of this standard deviation, or of the least that a load may have, where the data have errors of
    /// this covariance, V2.
    pub(crate) fn map_deviation_beside(
        &self,
        errors: DMatrix<f64>,
        local: f64,
        rows: &[usize],
    ) -> Result<MapDeviation, DriftError> {
        let local = local.max(LEAST_LOAD);
        let before = local.powi(2);
        // a covariance of linear data does not depend on their values
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

    /// Changes of the readings, V, whose random combinations have the covariance of drift of these sizes; kinds of drift of a
    /// smaller standard deviation than `least_v` in the data are left out.
    ///
    /// # Errors
    /// A covariance without eigenvalues.
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
