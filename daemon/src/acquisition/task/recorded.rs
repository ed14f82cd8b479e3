//! Frames of a recording that are damaged.

use imaging::recorded::RecordedError;
use rig::Clock;
use survey::error_chain as chain;

use crate::acquisition::playback::Recording;
use crate::acquisition::task::{Acquisition, AcquisitionEnd};
use crate::events::event::Event;
use crate::events::kind::EventKind;

impl Acquisition {
    /// Leaves out a damaged frame of a recording, and counts it as failed. The first, second, fourth, eighth ... is an
    /// event.
    ///
    /// # Errors
    /// No frame is damaged: the file cannot be read, because its disk fails for instance.
    pub(super) async fn leave_out(
        &self,
        recording: &mut Recording,
        error: RecordedError,
    ) -> Result<(), AcquisitionEnd> {
        if !matches!(&error, RecordedError::Session(error) if error.is_damage()) {
            return Err(AcquisitionEnd::Recording(Box::new(error)));
        }
        let number = recording.skip();
        let left_out = format!("frame {number} of the recording cannot be read and is left out");
        let (at, cause) = (self.clock.wall(), chain(&error));
        self.status
            .count_failure(at, &format!("{left_out}: {cause}"));
        let failures = self.status.failures();
        if failures.is_power_of_two() {
            let text = format!("{left_out} ({failures} so far): {cause}");
            let event = Event::new(
                at,
                EventKind::FrameFailed,
                &text,
                Some(&self.status.facts.id),
            );
            self.events.report(event.clone());
            self.record(event).await;
        }
        // lets other tasks run between many such frames
        tokio::task::yield_now().await;
        Ok(())
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
