//! The load after each injection of the frame in progress, relative to the tracked baseline.

use crate::DriftError;
use crate::disc::{Injection, MovingLoad};

use super::{DAY_S, MOST_MASKED, Tracker};

impl Tracker {
    /// The load after the last of these injections, which are in order of time; the last was at `at_s` (s, on the clock
    /// of the frames). `None` if the readings agree with an empty sheet. The tracker learns nothing from it.
    ///
    /// # Errors
    /// As [`crate::DriftModel::moving_load`].
    pub fn moving_load(
        &self,
        injections: &[Injection],
        at_s: f64,
    ) -> Result<Option<MovingLoad>, DriftError> {
        let masked = self.state.masked();
        let measurements = self.model.pairs().protocol().measurements();
        let healthy = |reading: usize| {
            let used = measurements.get(reading).map(|one| one.electrodes());
            used.is_none_or(|used| used.iter().all(|electrode| !masked.contains(&electrode.0)))
        };
        let mut kept = injections.to_vec();
        for injection in &mut kept {
            injection.readings.retain(|one| healthy(one.reading));
        }
        let days = (at_s - self.state.at_s).abs() / DAY_S;
        let mut covariance = self.predicted(days);
        self.allow_lost_contacts(&mut covariance, None);
        self.model
            .moving_load(&kept, &self.state.baseline(), &covariance)
    }

    /// Whether so many electrodes are faulty that frames cannot be judged.
    pub fn is_blind(&self) -> bool {
        self.state.masked().len() > MOST_MASKED
    }
}
