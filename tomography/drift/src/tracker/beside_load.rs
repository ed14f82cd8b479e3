//! The sheet as it is now while something lies on it: the drift since it was empty.

use nalgebra::DVector;

use super::Tracker;
use crate::DriftError;

/// Standard deviation of the tracked baseline over that of the noise from which on its drift is looked for beside a load: less is
/// hidden by the noise of the frame.
const GROWN: f64 = 2.0;

impl Tracker {
    /// The drift of the data since the tracked baseline learnt last, V, that is most probable beside what lies on the sheet in the last
    /// frame, under the covariance that grew since. Nothing is learnt from it: how much of such a frame is load is not certain. `None`
    /// on an empty sheet, while that covariance is hardly more than noise, and for a load that came by degrees, which is
    /// itself told from drift by its pace alone.
    ///
    /// # Errors
    /// No frame yet, or a covariance that cannot be factored.
    pub fn drift_beside_load(&self) -> Result<Option<DVector<f64>>, DriftError> {
        let noise = self.model.noise();
        let noise_v = (noise.trace() / noise.nrows() as f64).sqrt();
        let ledger = &self.state.ledger;
        if !(ledger.loaded() && ledger.by_event) || self.state.deviation() < GROWN * noise_v {
            return Ok(None);
        }
        let white = self.whitened()?;
        let fit = white.fit_disc(&self.model)?;
        let covariance = self.state.covariance();
        let drift = self
            .model
            .drift_beside_load(&covariance, noise, &white, &fit)?;
        Ok(Some(drift))
    }
}
