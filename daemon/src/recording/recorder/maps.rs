//! Maps beside the record: asked for with each frame, waited for a little, written later where they are late.

use logbook::LogbookError;
use survey::Frame;

use crate::recording::reconstruction_worker::{Failure, Made, MapOutcome};
use crate::recording::recorder::{Recorder, Row, Task};
use survey::error_chain as chain;

impl Recorder {
    pub(super) fn ask_for_map(
        &mut self,
        frame: &Frame,
        hurry: impl Fn() -> bool,
    ) -> Option<MapOutcome> {
        match &mut self.task {
            Task::Baseline { .. } => None,
            Task::Maps { worker, .. } => Some(worker.make(&frame.readings, hurry)),
        }
    }

    /// Puts what was made on its row, and says what went wrong.
    pub(super) fn made(&mut self, made: Made, row: &mut Row) -> Result<(), LogbookError> {
        row.reconstruction = made.took;
        match made.outcome {
            Ok(mapped) => {
                let refused = mapped.refused.as_deref().unwrap_or_default();
                self.status.set_last_error(refused);
                row.mapped = Some(mapped);
            }
            Err(Failure::Refused(why)) => self.status.set_last_error(&why),
            Err(Failure::Broken(why)) => {
                let text = format!(
                    "the code of method {} failed ({why}); frames are recorded, and have no maps until the next session; \
                     please report it",
                    self.status.facts.method
                );
                self.status.set_last_error(&text);
                self.say("method-suspended", &text)?;
            }
        }
        Ok(())
    }

    /// A map that was late, if it is ready.
    pub(super) fn late_map(&mut self) -> Result<(), LogbookError> {
        match &mut self.task {
            Task::Maps { worker, .. } => match worker.late() {
                Some(made) => self.arrived(made),
                None => Ok(()),
            },
            Task::Baseline { .. } => Ok(()),
        }
    }

    fn arrived(&mut self, made: Made) -> Result<(), LogbookError> {
        let Task::Maps { late, .. } = &mut self.task else {
            return Ok(());
        };
        let Some(mut row) = late.take() else {
            return Ok(());
        };
        self.made(made, &mut row)?;
        if let Some(mapped) = &row.mapped {
            let (sequence, record) = (row.frame.sequence, &mapped.record);
            match self.writer.late_map(sequence, record) {
                // a roll-over lay between, or the disk: the frame is there, and the map can be made again
                Err(LogbookError::NoSuchFrame { .. }) => {}
                Err(error) if error.is_disk() || error.is_locked() => {
                    tracing::debug!("{}", chain(&error));
                }
                other => other?,
            }
            self.publish_map(*row);
        }
        Ok(())
    }

    /// At the end nobody waits for it again.
    pub(super) fn last_map(&mut self) -> Result<(), LogbookError> {
        match &mut self.task {
            Task::Maps { worker, .. } => match worker.last() {
                Some(made) => self.arrived(made),
                None => Ok(()),
            },
            Task::Baseline { .. } => Ok(()),
        }
    }

    pub(super) fn missed_a_map(&mut self) -> Result<(), LogbookError> {
        let Task::Maps { missed, .. } = &mut self.task else {
            return Ok(());
        };
        *missed += 1;
        let missed = *missed;
        if !missed.is_power_of_two() {
            return Ok(());
        }
        let text = format!(
            "method {} is slower than frames come: {missed} recorded without a map so far (`tactus replay` makes them)",
            self.status.facts.method
        );
        self.say("maps-missed", &text)
    }
}
