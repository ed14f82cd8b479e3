//! The tracked baseline of a recording, frame by frame.

use imaging::recorded::{RecordedFrame, Recording};
use imaging::tracking::seconds;
use imaging::{TrackedArguments, TrackedFrame, Tracking};

use crate::failure::Failure;
use crate::maps::reconstruction::Reconstruction;

/// Follows a recording's baseline.
pub(crate) struct Follower {
    tracking: Tracking,
    /// Time between frames that have none, s.
    period_s: Option<f64>,
}

impl Follower {
    /// `None` where the baseline is not to be followed.
    ///
    /// # Errors
    /// Frames without times.
    pub(crate) fn of(
        reconstruction: &Reconstruction,
        requested: &TrackedArguments,
        recording: &Recording,
    ) -> Result<Option<Self>, Failure> {
        let Some(mut tracking) = reconstruction.tracking.clone() else {
            if requested.period_s.is_some() {
                return Err(Failure::Usage("--period-s belongs to --tracked".to_owned()));
            }
            return Ok(None);
        };
        let has_times = recording.has_times();
        match (has_times, requested.period_s) {
            (true, Some(_)) => {
                return Err(Failure::Usage(
                    "the frames have times of their own; leave --period-s out".to_owned(),
                ));
            }
            (false, None) => {
                return Err(Failure::Usage(
                    "--tracked needs the time of each frame, and these have none; say --period-s S"
                        .to_owned(),
                ));
            }
            _ => {}
        }
        if let Some(state) = recording.tracking()? {
            tracking.restore(state).map_err(|error| {
                Failure::failed(
                    "the baseline cannot be followed as in the session; --baseline or --tracked=off works without its state",
                    &error,
                )
            })?;
        }
        Ok(Some(Self {
            tracking,
            period_s: requested.period_s,
        }))
    }

    /// The frame with the baseline to compare it with. Every frame must be given, in order.
    ///
    /// # Errors
    /// A frame that cannot be followed.
    pub(crate) fn follow(&mut self, frame: &RecordedFrame) -> Result<TrackedFrame, Failure> {
        let at_s = match (frame.wall, self.period_s) {
            (Some(wall), _) => seconds(wall),
            (None, period_s) => period_s.unwrap_or_default() * frame.sequence as f64,
        };
        self.tracking
            .follow(&frame.readings, at_s)
            .map_err(|error| {
                Failure::failed(
                    &format!("frame {}: the baseline cannot be followed", frame.sequence),
                    &error,
                )
            })
    }

    /// The frame with this number, after all frames before it.
    ///
    /// # Errors
    /// As [`Follower::follow`], or no such frame.
    pub(crate) fn up_to(
        mut self,
        recording: &Recording,
        sequence: u64,
    ) -> Result<TrackedFrame, Failure> {
        for frame in recording.frames().filter_map(Result::ok) {
            let last = frame.sequence >= sequence;
            let followed = self.follow(&frame)?;
            if last {
                return Ok(followed);
            }
        }
        Err(Failure::Failed(format!(
            "{} has no frame {sequence}",
            recording.name
        )))
    }
}
