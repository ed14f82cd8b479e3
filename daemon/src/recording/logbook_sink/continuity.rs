//! Checks that a frame continues the previous one: its times, and after a gap its readings.

use crate::events::kind::EventKind;
use chrono::TimeDelta;
use logbook::LogbookError;
use survey::{Frame, relative_changes};

use crate::recording::logbook_sink::LogbookSink;

/// Larger than any step that NTP makes at once.
const CLOCK_STEP: TimeDelta = TimeDelta::try_seconds(1).unwrap();
/// Median relative change of the readings, below which an unattended sheet counts as unchanged after a gap.
const PLAUSIBLE: f64 = 0.1;

impl LogbookSink {
    /// Reports that the wall clock was set or the machine slept. Schedules follow the monotonic clock.
    pub(super) fn check_clock(&mut self, frame: &Frame) -> Result<(), LogbookError> {
        if self.is_recording {
            return Ok(());
        }
        let Ok(since) = TimeDelta::from_std(frame.monotonic) else {
            return Ok(());
        };
        let Some(now) = frame.wall.checked_sub_signed(since) else {
            return Ok(());
        };
        let moved = self.began.replace(now).map(|before| now - before);
        match moved {
            Some(moved) if moved.abs() > CLOCK_STEP => {
                let text = format!(
                    "the wall clock has moved by {:+.1} s against the monotonic one since the last frame: it was set, or \
                     the machine slept; frames keep to the schedule, and have both times",
                    moved.num_milliseconds() as f64 / 1e3
                );
                self.write_event(EventKind::ClockMoved, &text)
            }
            _ => Ok(()),
        }
    }

    /// Compares the first frame after a gap with the last one before it, and reports whether the readings have changed.
    pub(super) fn compare_with_previous(&mut self, first: &Frame) -> Result<(), LogbookError> {
        let Some(before) = self.before.take() else {
            return Ok(());
        };
        let changes = relative_changes(&before.frame.readings, &first.readings);
        let mut changes: Vec<f64> = changes.map(f64::abs).collect();
        let middle = changes.len() / 2;
        if changes.is_empty() {
            return self.write_event(
                EventKind::Implausible,
                "after the gap no reading can be compared",
            );
        }
        let (_, median, _) = changes.select_nth_unstable_by(middle, f64::total_cmp);
        let text = format!(
            "half of the readings after the gap are within {:.2} % of those before it",
            1e2 * *median
        );
        if *median <= PLAUSIBLE {
            return self.write_event(EventKind::Plausible, &text);
        }
        let text = format!(
            "{text}: sheet, contacts or loads have changed, and the baseline may no longer be valid"
        );
        self.write_event(EventKind::Implausible, &text)
    }
}
