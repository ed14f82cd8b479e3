//! The readings of each injection, sent before the frame is complete.

use std::time::Duration;

use chrono::{DateTime, Utc};
use survey::{Dipole, Plan, Reading, Step};
use tokio::sync::mpsc::Sender;
use tokio::time::Instant;

/// The readings of one injection.
#[derive(Debug, Clone, PartialEq)]
pub struct InjectionReadings {
    /// Number of the frame, from [`InjectionSink::frame`].
    pub frame: u64,
    /// When the frame began.
    pub frame_began: Duration,
    /// The pair of electrodes that the current flowed through.
    pub drive: Dipole,
    /// The readings with their numbers in the protocol.
    pub readings: Vec<(usize, Reading)>,
    /// Monotonic time of the middle of the injection.
    pub monotonic: Duration,
    /// Calendar time of the middle of the injection.
    pub wall: DateTime<Utc>,
    /// Duration of the injection.
    pub duration: Duration,
    /// Whether the source was in compliance during this injection, or possibly during the one before it.
    pub compliance: bool,
}

/// Destination of the injections of a frame. The frame never waits for the receiver: an injection that does not fit in
/// the channel is dropped.
#[derive(Debug, Clone)]
pub struct InjectionSink {
    /// Number of the frame, passed on with each injection.
    pub frame: u64,
    /// The receiver's channel.
    pub to: Sender<InjectionReadings>,
}

/// Sends the injections of a frame.
pub(super) struct InjectionReport {
    pub(super) sink: InjectionSink,
    /// When the frame began.
    pub(super) began: Instant,
    pub(super) monotonic: Duration,
    pub(super) wall: DateTime<Utc>,
}

impl InjectionReport {
    /// Sends the readings of an injection that has ended. Its time runs from the moment before its relays move (with
    /// [`Step::Break`] from the moment after they have settled) to its last reading.
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
        // dropped if the receiver is gone or the channel is full
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

/// Whether an injection has ended before this step. The step that switches everything off belongs to the last
/// injection, because it queries the compliance since the last query.
pub(super) fn ends_before(next: Option<&Step>) -> bool {
    match next {
        None => true,
        Some(step) => matches!(
            step,
            Step::Bus { .. } | Step::Break { .. } | Step::Overlap { .. }
        ),
    }
}
