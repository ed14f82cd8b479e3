//! Changes in a frame that are not load and that the tracked baseline does not contain: the drift since the sheet was
//! empty, and the effect of lost contacts on readings of other electrodes.

use nalgebra::{DMatrix, DVector};

use super::Tracker;
use crate::DriftError;

/// Time since the sheet was last empty after which the drift beside a load is estimated, s: less drift hardly changes a
/// map, and the estimate takes longer than many methods.
const AFTER_S: f64 = 3.0 * 3600.0;

impl Tracker {
    /// The most probable change of the data, V, that the tracked baseline lacks, given the load in the last frame:
    /// drift since the baseline last learnt, and the effect of the contacts of masked electrodes on readings of other
    /// electrodes. The tracker does not learn it, because the share of a frame that is load is uncertain. `None` if no
    /// electrode is masked and the sheet is empty, was empty within the last three hours, or has a load that came
    /// gradually (such a load is distinguished from drift by its pace alone).
    ///
    /// # Errors
    /// No frame yet, or a covariance that cannot be factored.
    pub fn unlearnt(&self) -> Result<Option<DVector<f64>>, DriftError> {
        let (ledger, at_s) = (&self.state.ledger, self.state.at_s);
        let drifts =
            ledger.loaded() && ledger.by_event && self.state.since_empty_s(at_s) >= AFTER_S;
        if !drifts && self.state.masked().is_empty() {
            return Ok(None);
        }
        let mut change = match drifts {
            true => self.state.covariance(),
            false => DMatrix::zeros(self.prepared.rows.len(), self.prepared.rows.len()),
        };
        self.allow_lost_contacts(&mut change, None);
        let white = self.whitened()?;
        if !ledger.loaded() {
            return Ok(Some(change * white.weights()));
        }
        let fit = white.fit_disc(&self.model)?;
        let noise = self.model.noise();
        let beside = self.model.drift_beside_load(&change, noise, &white, &fit)?;
        Ok(Some(beside))
    }
}
