//! How exactly a frame tells the map that is compared with the tracked baseline.

use super::Tracker;
use crate::DriftError;
use crate::evidence::MapDeviation;
use crate::whitened::LOADED;

impl Tracker {
    /// How exactly the last frame tells the map relative to the sheet without its load: the posterior of local change, with noise and the
    /// error of the tracked baseline as errors of the data. Before the frame, local change has the size of the disc that explains
    /// most of it, because what lies there may be as large elsewhere. The sizes of the drift are those that are tracked.
    ///
    /// # Errors
    /// No frame yet, or a covariance that cannot be factored.
    pub fn map_deviation(&self) -> Result<MapDeviation, DriftError> {
        let white = self.whitened()?;
        let tests = white.load_tests(&self.model, 3);
        let is_loaded = self.state.ledger.loaded();
        let load = match tests.first() {
            // what lies there for days may be hidden by the drift since then
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
