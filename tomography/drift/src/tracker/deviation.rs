//! Uncertainty of the map relative to the tracked baseline.

use super::Tracker;
use crate::DriftError;
use crate::evidence::MapDeviation;
use crate::whitened::LOADED;

impl Tracker {
    /// Uncertainty of the last frame's map relative to the sheet without load: the posterior of local change, with
    /// noise and the error of the tracked baseline as errors of the data. The prior standard deviation of local change
    /// is the largest change that the load of this frame may have, because an equal change may exist elsewhere. The
    /// drift has the tracked sizes.
    ///
    /// # Errors
    /// No frame yet, or a covariance that cannot be factored.
    pub fn map_deviation(&self) -> Result<MapDeviation, DriftError> {
        let white = self.whitened()?;
        let tests = white.load_tests(&self.model, 3);
        let is_loaded = self.state.ledger.loaded();
        let load = match tests.first() {
            // the drift since then may hide a load that has been on the sheet for days
            Some(best) if is_loaded || best.score > LOADED => {
                let (_, change) = white.fit_disc_and_change(&self.model, &tests)?;
                change
            }
            _ => 0.0,
        };
        let errors = self.of_frame(&self.state.covariance());
        self.model
            .map_deviation_beside(errors, load, &self.state.last_rows)
    }
}
