//! Schedule of frames, a pure function: times are passed in as durations of one monotonic clock.

use std::time::Duration;

/// A session's schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Schedule {
    /// Period from start to start of frames; zero is back to back.
    pub every: Duration,
    /// Number of frames.
    pub count: Option<u64>,
    /// Duration of the session.
    pub lasts: Option<Duration>,
}

/// The next action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Next {
    /// A frame is due then; `missed` frames were due before it and could not be taken.
    Frame { due: Duration, missed: u64 },
    /// The session is over.
    End(&'static str),
}

impl Schedule {
    /// The next action at time `now`, after `taken` frames; the last frame that was taken or missed was due at `last`
    /// (`None` before the first), and the session began at `began`.
    pub(crate) fn next(
        &self,
        began: Duration,
        taken: u64,
        last: Option<Duration>,
        now: Duration,
    ) -> Next {
        if self.count.is_some_and(|count| taken >= count) {
            return Next::End("the scheduled number of frames was taken");
        }
        let (due, missed) = self.due(began, last, now);
        if self
            .lasts
            .is_some_and(|lasts| due >= began.saturating_add(lasts))
        {
            return Next::End("the scheduled duration is over");
        }
        Next::Frame { due, missed }
    }

    fn due(&self, began: Duration, last: Option<Duration>, now: Duration) -> (Duration, u64) {
        let due = match last {
            Some(_) if self.every.is_zero() => return (now, 0),
            None if self.every.is_zero() => return (began, 0),
            Some(last) => last.saturating_add(self.every),
            None => began,
        };
        if now < due.saturating_add(self.every) {
            return (due, 0);
        }
        // the rig was slower than the schedule: use the latest time that has passed, and report the missed ones
        let late = (now - due).as_nanos() / self.every.as_nanos();
        let missed = u64::try_from(late).unwrap_or(u64::MAX);
        let step = self
            .every
            .saturating_mul(u32::try_from(missed).unwrap_or(u32::MAX));
        (due.saturating_add(step), missed)
    }
}

#[cfg(test)]
mod tests {
    use crate::acquisition::schedule::*;

    const S: fn(u64) -> Duration = Duration::from_secs;

    #[test]
    fn back_to_back_until_the_count() {
        let schedule = Schedule {
            count: Some(2),
            ..Schedule::default()
        };
        let frame = |due| Next::Frame { due, missed: 0 };
        assert_eq!(schedule.next(S(5), 0, None, S(6)), frame(S(5)));
        assert_eq!(schedule.next(S(5), 1, Some(S(5)), S(7)), frame(S(7)));
        assert!(matches!(
            schedule.next(S(5), 2, Some(S(7)), S(8)),
            Next::End(_)
        ));
    }

    #[test]
    fn a_slow_rig_drops_places_and_counts_them_without_drifting() {
        let schedule = Schedule {
            every: S(10),
            ..Schedule::default()
        };
        let on_time = schedule.next(S(0), 1, Some(S(0)), S(3));
        assert_eq!(
            on_time,
            Next::Frame {
                due: S(10),
                missed: 0
            }
        );
        let a_little_late = schedule.next(S(0), 1, Some(S(0)), S(13));
        assert_eq!(
            a_little_late,
            Next::Frame {
                due: S(10),
                missed: 0
            }
        );
        let very_late = schedule.next(S(0), 1, Some(S(0)), S(47));
        assert_eq!(
            very_late,
            Next::Frame {
                due: S(40),
                missed: 3
            }
        );
    }

    #[test]
    fn no_frame_begins_after_the_end() {
        let schedule = Schedule {
            every: S(10),
            lasts: Some(S(25)),
            ..Schedule::default()
        };
        assert!(matches!(
            schedule.next(S(100), 2, Some(S(110)), S(112)),
            Next::Frame { .. }
        ));
        assert!(matches!(
            schedule.next(S(100), 3, Some(S(120)), S(122)),
            Next::End(_)
        ));
    }
}
