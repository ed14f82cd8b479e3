//! The drift in one frame, separated from a load: what any method compares the frame with.
//!
//! The map x that explains data d = J x + b + noise with drift b ~ N(0, D) is the same whether b is minimised over or the data
//! are whitened by R + D: min over b of |d - J x - b|^2_R + |b|^2_D is |d - J x|^2_(R + D). A method that takes d - b for the
//! most probable b therefore needs no covariance of its own. Here b is the most probable drift beside a load that is a
//! disc, or, where no disc explains the frame, beside local change of the size that makes the frame most probable.

use eit::linear_algebra::symmetric_eigen;
use nalgebra::{DMatrix, DVector};
use survey::Reading;

use crate::DriftError;
use crate::disc::MODEL_SHARE;
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
    /// The standard deviation of each triangle, NaN where the frame says nothing of it.
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
        let drift = self.drift(&Sizes {
            local: 0.0,
            ..sizes
        });
        let fit = assessed.whitened.fit_disc(self)?;
        let weights = match fit.accepted {
            true => {
                // `load` is a loss
                let change = -fit.load / fit.disc.diameter.powi(2);
                let load = self.disc(fit.disc.centre, fit.disc.diameter) * change;
                let mut beside = assessed.whitened.with_error(&(&load * MODEL_SHARE))?;
                beside.set(&(data - load));
                beside.weights()
            }
            false => self.with_load(&sizes, data, rows)?.weights(),
        };
        Ok(FrameDrift {
            change: drift * weights,
            sizes,
            is_disc: fit.accepted,
        })
    }

    /// How exactly a frame of these sizes and rows tells the map: the posterior of local change.
    ///
    /// # Errors
    /// A covariance that cannot be factored.
    pub fn map_deviation(&self, sizes: &Sizes, rows: &[usize]) -> Result<MapDeviation, DriftError> {
        let sizes = Sizes {
            local: sizes.local.max(LEAST_LOAD),
            ..*sizes
        };
        let white = self.with_load(&sizes, &DVector::zeros(self.pairs().len()), rows)?;
        let resolved: DMatrix<f64> = white.sensitivity(&self.local_map.transpose());
        let before = sizes.local.powi(2);
        let of_cells: Vec<f64> = resolved
            .column_iter()
            .map(|column| (1.0 - before * column.norm_squared()).max(0.0).sqrt())
            .collect();
        let shares = self.cell_of_triangle().iter().map(|&cell| of_cells[cell]);
        Ok(MapDeviation {
            deviation: shares.clone().map(|share| sizes.local * share).collect(),
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

    /// Data whitened by noise, drift and load.
    fn with_load(
        &self,
        sizes: &Sizes,
        data: &DVector<f64>,
        rows: &[usize],
    ) -> Result<Whitened, DriftError> {
        Whitened::new(&(self.noise() * 2.0 + self.drift(sizes)), data, rows)
    }
}
