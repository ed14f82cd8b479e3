//! What a frame shows that is no load and that the tracked baseline does not contain: the drift since the sheet was empty, and what lost
//! contacts change in the readings of others.

use nalgebra::{DMatrix, DVector};

use super::Tracker;
use crate::DriftError;

/// Time since the sheet was last empty from which on its drift is looked for beside a load, s: less drift hardly changes a map, and
/// the estimate takes longer than many methods.
const AFTER_S: f64 = 3.0 * 3600.0;

impl Tracker {
    /// The change of the data, V, that the tracked baseline lacks, as it is most probable beside what lies on the sheet in the last frame:
    /// drift since the baseline learnt last, and what the contacts of masked electrodes change in the readings of others. Nothing is learnt
    /// from it: how much of a frame is load is not certain. `None` where it is nothing: without masked electrodes on an empty sheet, within
    /// three hours after it was empty, and for a load that came by degrees, which is itself told from drift by its pace alone.
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
