//! The readings of each injection, handed over before the frame is complete.

use std::time::Duration;

use chrono::{DateTime, Utc};
use survey::{Dipole, Plan, Reading, Step};
use tokio::sync::mpsc::Sender;
use tokio::time::Instant;

/// The readings of one injection.
#[derive(Debug, Clone, PartialEq)]
pub struct InjectionReadings {
    /// Where the current flowed.
    pub drive: Dipole,
    /// The readings with their numbers in the protocol.
    pub readings: Vec<(usize, Reading)>,
    /// The middle of the injection.
    pub monotonic: Duration,
    /// The same as calendar time.
    pub wall: DateTime<Utc>,
    /// How long it lasted.
    pub duration: Duration,
    /// Whether the source was in compliance, here or perhaps in the injection before.
    pub compliance: bool,
}

/// Hands over the injections of a frame. Never waits: a receiver that is behind misses some.
pub(super) struct InjectionReport {
    pub(super) to: Sender<InjectionReadings>,
    /// When the frame began.
    pub(super) began: Instant,
    pub(super) monotonic: Duration,
    pub(super) wall: DateTime<Utc>,
}

impl InjectionReport {
    /// An injection since `from` has ended.
    pub(super) fn ended(
        &self,
        plan: &Plan,
        drive: Dipole,
        readings: &[Reading],
        from: Instant,
        compliance: bool,
    ) {
        let duration = from.elapsed();
        let middle = from.saturating_duration_since(self.began) + duration / 2;
        let measurements = plan.protocol.measurements().iter();
        let own = measurements
            .zip(readings)
            .enumerate()
            .filter(|(_, (measurement, _))| measurement.drive == drive);
        // nobody may be waiting for it any more
        let _ = self.to.try_send(InjectionReadings {
            drive,
            readings: own
                .map(|(number, (_, reading))| (number, *reading))
                .collect(),
            monotonic: self.monotonic + middle,
            wall: self.wall + middle,
            duration,
            compliance,
        });
    }
}

/// Whether an injection has ended before this step.
pub(super) fn ends_before(next: Option<&Step>) -> bool {
    match next {
        None => true,
        Some(step) => matches!(
            step,
            Step::AllOff | Step::Bus { .. } | Step::Break { .. } | Step::Overlap { .. }
        ),
    }
}
