//! Frames of a recording that cannot be read.

use imaging::recorded::RecordedError;
use rig::Clock;
use survey::error_chain as chain;

use crate::acquisition::playback::Recording;
use crate::acquisition::task::{Acquisition, AcquisitionEnd};
use crate::events::event::Event;
use crate::events::kind::EventKind;

impl Acquisition {
    /// Leaves out a frame of a recording that cannot be read, and counts it as failed. The first, second, fourth,
    /// eighth ... is an event.
    pub(super) async fn leave_out(&self, recording: &mut Recording, error: &RecordedError) {
        let number = recording.skip();
        self.status.count_failure();
        let failures = self.status.failures();
        if failures.is_power_of_two() {
            let text = format!(
                "frame {number} of the recording cannot be read and is left out ({failures} so far): {}",
                chain(error)
            );
            let (at, id) = (self.clock.wall(), Some(self.status.facts.id.as_str()));
            let event = Event::new(at, EventKind::FrameFailed, &text, id);
            self.events.report(event.clone());
            self.record(event).await;
        }
        // lets other tasks run between many such frames
        tokio::task::yield_now().await;
    }

    pub(super) fn end_of_recording(&self) -> AcquisitionEnd {
        AcquisitionEnd::Done(match self.status.failures() {
            0 => "the recording is over".to_owned(),
            failures => format!(
                "the recording is over; {failures} of its frames cannot be read and were left out"
            ),
        })
    }
}
