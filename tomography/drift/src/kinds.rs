//! Splits a tracked change into gain, contacts, smooth field and local change: the most probable parts, given the
//! covariance of each kind.

use nalgebra::{DMatrix, DVector};

use crate::DriftError;
use crate::basis::PER_DAY;
use crate::model::DriftModel;
use crate::sizes::Sizes;
use crate::whitened::Whitened;

/// Shortest time for which the parts are computed, days: the change between two frames is mostly noise.
const SHORTEST_DAYS: f64 = 1.0 / 24.0;

/// The parts of a change, by kind.
#[derive(Debug, Clone, PartialEq)]
pub struct DriftKinds {
    /// Change of ln gain.
    pub gain: f64,
    /// Change of ln contact impedance of each electrode.
    pub contacts: Vec<f64>,
    /// Root mean square over the sheet of the smooth field, in ln conductance.
    pub field: f64,
    /// The largest local change.
    pub local: LocalChange,
    /// Root mean square of each part over the data, V.
    pub data_v: Sizes,
}

/// A local change of conductance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalChange {
    /// Change of ln conductance.
    pub change: f64,
    /// Centre of the change, m.
    pub centre: [f64; 2],
}

impl DriftModel {
    /// The most probable parts of a change of the data with this error (covariance, V2) that developed over this time
    /// at this pace.
    ///
    /// # Errors
    /// A covariance that cannot be factored.
    pub fn kinds(
        &self,
        change: &DVector<f64>,
        error: &DMatrix<f64>,
        days: f64,
        pace: f64,
    ) -> Result<DriftKinds, DriftError> {
        let time = pace * days.max(SHORTEST_DAYS).sqrt();
        let sizes = PER_DAY.scaled(time);
        let rows: Vec<usize> = (0..change.len()).collect();
        let covariance = self.drift(&sizes) + error;
        let weights = Whitened::new(&covariance, change, &rows)?.weights();
        let variance = |size: f64| size * size;
        let v = &self.fit().readings;
        let gain = variance(sizes.gain) * v.dot(&weights);
        let contacts = self.contacts.tr_mul(&weights) * variance(sizes.contact);
        let field = self.field_by_cell(&weights) * variance(sizes.field);
        let (local, centres) = self.local_by_cell(&weights);
        let local = local * variance(sizes.local);
        let most = local.icamax();
        let rms = |values: &DVector<f64>| values.norm() / (values.len() as f64).sqrt();
        // includes the second order of the contacts
        let part = |kind: &Sizes| rms(&(self.drift(kind) * &weights));
        let none = Sizes::default();
        Ok(DriftKinds {
            gain,
            contacts: contacts.as_slice().to_vec(),
            field: rms(&field),
            local: LocalChange {
                change: local[most],
                centre: centres[most],
            },
            data_v: Sizes {
                gain: part(&Sizes {
                    gain: sizes.gain,
                    ..none
                }),
                contact: part(&Sizes {
                    contact: sizes.contact,
                    ..none
                }),
                field: part(&Sizes {
                    field: sizes.field,
                    ..none
                }),
                local: part(&Sizes {
                    local: sizes.local,
                    ..none
                }),
            },
        })
    }
}
