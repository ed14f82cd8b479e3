//! The drift in a frame whose load is not a disc.
//!
//! If the prior lets every cell change equally, the estimate attributes the mean change of a wide load to the gain,
//! because both change all readings alike. But a load has edges and leaves the rest of the sheet unchanged. Therefore
//! the cells with the largest change are taken as the load, whose size is the one that makes the frame most probable;
//! gain, contacts and field are estimated from the other cells.

use nalgebra::{DMatrix, DVector};

use crate::DriftError;
use crate::disc::MODEL_SHARE;
use crate::model::DriftModel;
use crate::sizes::Sizes;
use crate::whitened::Whitened;

/// Share of the largest change above which a cell belongs to the load.
const LOADED_SHARE: f64 = 0.25;
/// Distance within which neighbouring cells also belong to the load, m: one cell.
const BESIDE_M: f64 = 10e-3;
/// Smallest and largest change of ln conductance for the linearisation: conductance nearly lost, or doubled.
const CHANGE: [f64; 2] = [-3.0, 0.7];
/// Number of rounds: each round searches the cells of the load in the data corrected by the drift of the previous
/// round.
const ROUNDS: usize = 6;
/// Error of the model linearised about the sheet without load, as a share of the load's signal.
const FIRST_SHARE: f64 = 0.3;

/// Knowledge about the drift before the frame.
#[derive(Clone, Copy)]
pub(crate) enum Prior<'a> {
    /// The kinds of drift; the sizes that make the frame most probable are used.
    Kinds,
    /// The covariance of the drift, V2.
    Covariance(&'a DMatrix<f64>),
}

impl Prior<'_> {
    /// The covariance of drift of these sizes, V2.
    pub(super) fn covariance(self, model: &DriftModel, sizes: &Sizes) -> DMatrix<f64> {
        match self {
            Self::Kinds => model.drift(&Sizes {
                local: 0.0,
                ..*sizes
            }),
            Self::Covariance(known) => known.clone(),
        }
    }

    /// The covariance of drift and load, V2; the load has the covariance `load` at size 1.
    pub(super) fn with_load(
        self,
        model: &DriftModel,
        sizes: &Sizes,
        load: &DMatrix<f64>,
    ) -> DMatrix<f64> {
        self.covariance(model, sizes) + load * sizes.local.powi(2)
    }
}

impl DriftModel {
    /// The drift in data with this noise covariance (V2) beside a load of any shape: its sizes and the change of the
    /// data, V.
    pub(super) fn drift_beside_any_shape(
        &self,
        prior: Prior<'_>,
        noise: &DMatrix<f64>,
        data: &DVector<f64>,
        rows: &[usize],
    ) -> Result<(Sizes, DVector<f64>), DriftError> {
        let errors_of = |share: f64, signal: &DVector<f64>| {
            noise + DMatrix::from_diagonal(&signal.map(|v| (share * v).powi(2)))
        };
        let errors = errors_of(FIRST_SHARE, data);
        let (sizes, _) = self.most_probable(prior, data, &errors, &self.local_gram, rows)?;
        let mut map = self.map_beside(prior, &errors, &sizes, data, rows)?;
        let (mut signal, mut share) = (data.clone(), FIRST_SHARE);
        let mut linear = (DVector::zeros(data.len()), self.cell_sensitivity().clone());
        let mut found = (sizes, DVector::zeros(data.len()));
        for round in 1..=ROUNDS {
            let errors = errors_of(share, &signal);
            let rest = data - &linear.0;
            let cells = self.load_cells(&map);
            let sensitivity = linear.1.select_columns(&cells);
            let from_data = self.local_correlation(&cells) * sensitivity.transpose();
            let load = &sensitivity * &from_data;
            let (sizes, _) = self.most_probable(prior, &rest, &errors, &load, rows)?;
            let covariance = &errors + prior.with_load(self, &sizes, &load);
            let weights = Whitened::new(&covariance, &rest, rows)?.weights();
            let of_cells = from_data * &weights * sizes.local.powi(2);
            let mut about = DVector::zeros(map.len());
            for (&cell, value) in cells.iter().zip(&of_cells) {
                about[cell] = value.clamp(CHANGE[0], CHANGE[1]);
            }
            let change = prior.covariance(self, &sizes) * weights;
            signal = data - &change;
            found = (sizes, change);
            if round == ROUNDS {
                break;
            }
            linear = self.linear_about(&about)?;
            // the unexplained rest of this load is the model error expected in the next round
            let left = &signal - &linear.0 - &linear.1 * about;
            let of_rows = |values: &DVector<f64>| values.select_rows(rows).norm();
            let share_left = of_rows(&left) / of_rows(&signal).max(f64::MIN_POSITIVE);
            share = share_left.clamp(MODEL_SHARE, FIRST_SHARE);
            // the cells of the load, after subtraction of that drift
            map = self.map_beside(prior, &errors, &sizes, &signal, rows)?;
        }
        Ok(found)
    }

    /// The map, by cell, of a load anywhere on the sheet.
    fn map_beside(
        &self,
        prior: Prior<'_>,
        errors: &DMatrix<f64>,
        sizes: &Sizes,
        data: &DVector<f64>,
        rows: &[usize],
    ) -> Result<DVector<f64>, DriftError> {
        let covariance = errors + prior.with_load(self, sizes, &self.local_gram);
        let weights = Whitened::new(&covariance, data, rows)?.weights();
        Ok(self.local_by_cell(&weights).0)
    }

    /// The cells covered by a load, from a map by cell.
    fn load_cells(&self, map: &DVector<f64>) -> Vec<usize> {
        let least = LOADED_SHARE * map.amax();
        let most = (0..map.len()).filter(|&cell| map[cell].abs() >= least);
        self.cells_around(&most.collect::<Vec<_>>(), BESIDE_M)
    }
}
