//! The tracked baseline of a recording, frame by frame.

use imaging::recorded::{RecordedFrame, Recording};
use imaging::tracking::Orders;
use imaging::{TrackedArguments, TrackedFrame, Tracking};
use survey::Reading;

use crate::failure::Failure;
use crate::maps::reconstruction::Reconstruction;

/// Tracks a recording's baseline.
#[derive(Clone)]
pub(crate) struct Follower {
    tracking: Tracking,
    /// Time between frames without times of their own, s.
    period_s: Option<f64>,
    /// Number of the first frame that was not tracked yet.
    next: u64,
    /// Orders that persons gave in the session.
    orders: Orders,
}

impl Follower {
    /// The follower of a recording; `None` if the baseline is not to be tracked.
    ///
    /// # Errors
    /// A period that does not suit the frames' times; a stored state of tracking that cannot be restored.
    pub(crate) fn of(
        reconstruction: &Reconstruction,
        requested: &TrackedArguments,
        recording: &Recording,
    ) -> Result<Option<Self>, Failure> {
        Self::new(reconstruction.tracking.clone(), requested, recording)
    }

    /// The follower of this tracked baseline; `None` without one.
    ///
    /// # Errors
    /// As [`Follower::of`].
    pub(crate) fn new(
        tracking: Option<Tracking>,
        requested: &TrackedArguments,
        recording: &Recording,
    ) -> Result<Option<Self>, Failure> {
        let have_times = tracking.is_some() && recording.has_times();
        let period_s = requested.period_s(tracking.is_some(), have_times);
        let period_s = period_s.map_err(Failure::Usage)?;
        let Some(mut tracking) = tracking else {
            return Ok(None);
        };
        if let Some(state) = recording.tracking()? {
            tracking.restore(state).map_err(|error| {
                Failure::failed(
                    "the baseline cannot be tracked as in the session; give --baseline or --tracked=off, which do not use the session's tracking state",
                    &error,
                )
            })?;
        }
        Ok(Some(Self {
            tracking,
            period_s,
            next: 0,
            orders: recording.orders()?,
        }))
    }

    /// The frame and the baseline to compare it with. Every frame must be given to this method or to
    /// [`Follower::pass`], in order.
    ///
    /// # Errors
    /// The frame cannot be tracked.
    pub(crate) fn follow(&mut self, frame: &RecordedFrame) -> Result<TrackedFrame, Failure> {
        let at_s = self.begin(frame);
        let followed = self.tracking.follow(&frame.readings, at_s);
        followed.map_err(|error| not_followed(frame, &error))
    }

    /// Tracks a frame whose result is not needed.
    ///
    /// # Errors
    /// As [`Follower::follow`].
    pub(crate) fn pass(&mut self, frame: &RecordedFrame) -> Result<(), Failure> {
        let at_s = self.begin(frame);
        let passed = self.tracking.pass(&frame.readings, at_s);
        passed.map_err(|error| not_followed(frame, &error))
    }

    /// Applies the orders for this frame, which come before it; returns the time of the frame, s.
    fn begin(&mut self, frame: &RecordedFrame) -> f64 {
        for order in self.orders.due(frame.sequence) {
            self.tracking.order(order);
        }
        self.next = frame.sequence + 1;
        self.time(frame)
    }

    fn time(&self, frame: &RecordedFrame) -> f64 {
        frame.time_s(self.period_s).unwrap_or_default()
    }

    /// Number of the first frame that was not tracked yet.
    pub(crate) fn next(&self) -> u64 {
        self.next
    }

    /// The frame and its baseline in the present state, without tracking the frame.
    pub(crate) fn compare(&self, readings: &[Reading]) -> (Vec<Reading>, Vec<Reading>) {
        self.tracking.compare(readings)
    }

    /// Tracks all frames before this number that were not tracked yet.
    ///
    /// # Errors
    /// As [`Follower::follow`].
    pub(crate) fn pass_before(
        &mut self,
        recording: &Recording,
        sequence: u64,
    ) -> Result<(), Failure> {
        for frame in recording.frames_from(self.next).filter_map(Result::ok) {
            if frame.sequence >= sequence {
                break;
            }
            self.pass(&frame)?;
        }
        Ok(())
    }
}

fn not_followed(frame: &RecordedFrame, error: &dyn std::error::Error) -> Failure {
    let what = format!("the baseline cannot be tracked to frame {}", frame.sequence);
    Failure::failed(&what, error)
}
