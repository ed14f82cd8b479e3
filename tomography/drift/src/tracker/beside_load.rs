//! The sheet as it is now while something lies on it: the drift since it was empty.

use nalgebra::DVector;

use super::Tracker;
use crate::DriftError;

/// Time since the sheet was last empty from which on its drift is looked for beside a load, s: less drift hardly changes a map, and
/// the estimate takes longer than many methods.
const AFTER_S: f64 = 3.0 * 3600.0;

impl Tracker {
    /// The drift of the data since the tracked baseline learnt last, V, that is most probable beside what lies on the sheet in the last
    /// frame, under the covariance that grew since. Nothing is learnt from it: how much of such a frame is load is not certain. `None`
    /// on an empty sheet, within three hours after it was empty, and for a load that came by degrees, which is itself told from drift by
    /// its pace alone.
    ///
    /// # Errors
    /// No frame yet, or a covariance that cannot be factored.
    pub fn drift_beside_load(&self) -> Result<Option<DVector<f64>>, DriftError> {
        let (ledger, at_s) = (&self.state.ledger, self.state.at_s);
        let lies_long = self.state.since_empty_s(at_s) >= AFTER_S;
        if !(ledger.loaded() && ledger.by_event && lies_long) {
            return Ok(None);
        }
        let white = self.whitened()?;
        let fit = white.fit_disc(&self.model)?;
        let covariance = self.state.covariance();
        let drift = self
            .model
            .drift_beside_load(&covariance, self.model.noise(), &white, &fit)?;
        Ok(Some(drift))
    }
}
