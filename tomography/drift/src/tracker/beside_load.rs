//! The sheet as it is now while something lies on it: what was tracked until then, and the drift since.

use nalgebra::DVector;

use super::Tracker;
use crate::DriftError;

/// Standard deviation of the tracked baseline over that of the noise from which on its drift is looked for beside a load: what is less
/// changes no map.
const GROWN: f64 = 2.0;

impl Tracker {
    /// The change of the data since the first baseline that the last frame is to be compared with, V: as it is tracked, and while
    /// something lies on the sheet with the drift that is most probable beside that load, under the covariance that grew since the
    /// sheet was empty. Nothing is learnt from such a frame: how much of it is load is not certain.
    ///
    /// # Errors
    /// No frame yet, or a covariance that cannot be factored.
    pub fn baseline_beside_load(&self) -> Result<DVector<f64>, DriftError> {
        let baseline = self.baseline();
        let noise = self.model.noise();
        let noise_v = (noise.trace() / noise.nrows() as f64).sqrt();
        if !self.state.ledger.loaded() || self.state.deviation() < GROWN * noise_v {
            return Ok(baseline);
        }
        let white = self.whitened()?;
        let fit = white.fit_disc(&self.model)?;
        let covariance = self.state.covariance();
        let drift = self
            .model
            .drift_beside_load(&covariance, noise, &white, &fit)?;
        Ok(baseline + drift)
    }
}
