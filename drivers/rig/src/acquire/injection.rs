//! The readings of each injection, handed over before the frame is complete.

use std::time::Duration;

use chrono::{DateTime, Utc};
use survey::{Dipole, Plan, Reading, Step};
use tokio::sync::mpsc::Sender;
use tokio::time::Instant;

/// The readings of one injection.
#[derive(Debug, Clone, PartialEq)]
pub struct InjectionReadings {
    /// Number of the frame, as it was given.
    pub frame: u64,
    /// When the frame began.
    pub frame_began: Duration,
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

/// Where the injections of a frame are sent. The frame never waits for the receiver: what the channel does not hold is not sent.
#[derive(Debug, Clone)]
pub struct InjectionSink {
    /// Number of the frame, passed on with each injection.
    pub frame: u64,
    /// The receiver's channel.
    pub to: Sender<InjectionReadings>,
}

/// Hands over the injections of a frame.
pub(super) struct InjectionReport {
    pub(super) sink: InjectionSink,
    /// When the frame began.
    pub(super) began: Instant,
    pub(super) monotonic: Duration,
    pub(super) wall: DateTime<Utc>,
}

impl InjectionReport {
    /// An injection has ended; its time is from when the relays were to close to its last reading.
    pub(super) fn ended(
        &self,
        plan: &Plan,
        drive: Dipole,
        readings: &[Reading],
        (from, to): (Instant, Instant),
        compliance: bool,
    ) {
        let duration = to.saturating_duration_since(from);
        let middle = from.saturating_duration_since(self.began) + duration / 2;
        let measurements = plan.protocol.measurements().iter();
        let own = measurements
            .zip(readings)
            .enumerate()
            .filter(|(_, (measurement, _))| measurement.drive == drive);
        // nobody may be waiting for it any more
        let _ = self.sink.to.try_send(InjectionReadings {
            frame: self.sink.frame,
            frame_began: self.monotonic,
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

/// Whether an injection has ended before this step. The step that switches all off belongs to the last one: it queries the
/// compliance that began after the last query.
pub(super) fn ends_before(next: Option<&Step>) -> bool {
    match next {
        None => true,
        Some(step) => matches!(
            step,
            Step::Bus { .. } | Step::Break { .. } | Step::Overlap { .. }
        ),
    }
}
