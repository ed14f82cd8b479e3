//! Progress of a session, and the frames of its schedule that are missed.

use std::time::Duration;

use crate::acquisition::schedule::{Next, Schedule};
use crate::acquisition::task::Acquisition;
use crate::events::kind::EventKind;

/// Progress of a session, kept when the connection to the rig is lost.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct AcquisitionProgress {
    pub(super) began: Option<Duration>,
    pub(super) taken: u64,
    /// When the last frame that was taken or missed was due.
    pub(super) last: Option<Duration>,
    /// Time spent in pauses, by which the frames of a recording are postponed.
    pub(super) shift: Duration,
}

impl AcquisitionProgress {
    /// Progress of a resumed session with this many frames.
    pub(crate) fn after(taken: u64) -> Self {
        Self {
            taken,
            ..Self::default()
        }
    }

    /// Removes the frames from the schedule that were due and can no longer be taken in time. Returns their number.
    pub(super) fn skip_missed(&mut self, schedule: &Schedule, now: Duration) -> u64 {
        let began = self.began.unwrap_or(now);
        match schedule.next(began, self.taken, self.last, now) {
            Next::Frame { due, missed } if missed > 0 => {
                self.last = Some(due.saturating_sub(schedule.every));
                missed
            }
            _ => 0,
        }
    }
}

impl Acquisition {
    /// Counts frames that were due and could not be taken in time. In step mode, none is due before it is granted.
    pub(super) async fn count_missed(&self, missed: u64) {
        if missed > 0 && self.status.grants().is_none() {
            self.status.count_dropped(missed);
            let text = format!("{missed} frames were due and could not be taken in time");
            self.note(EventKind::FramesMissed, text).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_due_in_a_requested_pause_are_not_missed() {
        let seconds = Duration::from_secs;
        let schedule = Schedule {
            every: seconds(10),
            ..Schedule::default()
        };
        let mut progress = AcquisitionProgress {
            began: Some(Duration::ZERO),
            taken: 1,
            last: Some(Duration::ZERO),
            ..AcquisitionProgress::default()
        };
        // a pause from 21 s to 47 s; the frame of 10 s was missed before it
        assert_eq!(progress.skip_missed(&schedule, seconds(21)), 1);
        assert_eq!(progress.skip_missed(&schedule, seconds(47)), 2);
        let next = |progress: &AcquisitionProgress, now| {
            schedule.next(Duration::ZERO, progress.taken, progress.last, now)
        };
        let frame = |due| Next::Frame {
            due: seconds(due),
            missed: 0,
        };
        assert_eq!(next(&progress, seconds(47)), frame(40));

        // a pause before the first frame
        let mut progress = AcquisitionProgress {
            began: Some(Duration::ZERO),
            ..AcquisitionProgress::default()
        };
        assert_eq!(progress.skip_missed(&schedule, seconds(47)), 4);
        assert_eq!(next(&progress, seconds(47)), frame(40));
    }
}
