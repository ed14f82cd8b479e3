//! The next part of a session: if the file has reached its maximum size or a new day has begun, and if the file has an
//! I/O error, or is locked or deleted.

use chrono::{DateTime, Utc};
use logbook::LogbookError;
use rig::Clock;
use survey::error_chain as chain;

use crate::events::kind::EventKind;
use crate::recording::logbook_sink::LogbookSink;
use crate::recording::logbook_sink::disk_space::MEGABYTE;

impl LogbookSink {
    /// Continues the session in its next part if the file has reached its maximum size or a new day has begun. If the
    /// part cannot be created, continues in this one, and tries again with the next frame.
    pub(in crate::recording) fn roll(&mut self, at: DateTime<Utc>) -> Result<(), LogbookError> {
        let section = &self.disk.section;
        let before = self.disk.day.replace(at.date_naive());
        let new_day = section.roll_daily && before.is_some_and(|before| before != at.date_naive());
        let large = section.roll_mb > 0 && self.writer.bytes() > section.roll_mb * MEGABYTE;
        if !(new_day || large || self.disk.part_refused) {
            return Ok(());
        }
        match self.writer.roll(at) {
            Ok(_) => {
                self.status.set_path(self.writer.path());
                self.end_refusal();
                self.settle()
            }
            Err(error) if error.needs_successor() => self.renew(&error),
            // tried again with the next frame
            Err(error) if error.is_locked() => {
                self.disk.day = before;
                Ok(())
            }
            Err(error) if self.disk.part_refused => {
                tracing::debug!("{}", chain(&error));
                Ok(())
            }
            Err(error) => {
                self.disk.part_refused = true;
                self.write_event(EventKind::PartRefused, &chain(&error))
            }
        }
    }

    /// Reports that a part could be created after it had been refused.
    fn end_refusal(&mut self) {
        if std::mem::take(&mut self.disk.part_refused) {
            let text = format!("the session continues in {}", self.writer.path().display());
            self.note(EventKind::PartCreated, &text);
        }
    }

    /// Continues the session in another file, after the acknowledged frames. After an I/O error the state of the old
    /// file on disk is unknown: reads may be served from the page cache. The frames of a deleted file are copied to a
    /// new one.
    pub(in crate::recording) fn renew(&mut self, error: &LogbookError) -> Result<(), LogbookError> {
        let at = self.clock.wall();
        let why = chain(error);
        let rescued = error.is_gone().then(|| self.writer.rescue());
        let kept = match &rescued {
            None => String::new(),
            Some(Ok(copy)) => format!("; its frames are in {}", copy.display()),
            Some(Err(refused)) => format!(
                "; frames {} to {} were in it and could not be copied ({})",
                self.writer.header().first_sequence,
                self.writer.acknowledged(),
                chain(refused)
            ),
        };
        let left = self.writer.successor(at, &format!("{why}{kept}"))?;
        self.status.set_path(self.writer.path());
        let todo = match error {
            LogbookError::Gone { .. } => "do not touch the files of a session that runs",
            LogbookError::Locked { .. } => "do not open the files of a running session for writing",
            _ => "repair the disk",
        };
        let text = format!(
            "writing to {} has stopped: {why}{kept}; the session continues in {}; {todo}",
            left.display(),
            self.writer.path().display()
        );
        // not written to the record: the new part contains the reason itself
        self.report(EventKind::Alarm, &text);
        self.end_refusal();
        Ok(())
    }

    /// Checks that the file is still at its path; called while no frame is written.
    pub(in crate::recording) fn look_at_place(&mut self) -> Result<(), LogbookError> {
        match self.writer.check_place() {
            Err(gone) => self.renew(&gone),
            Ok(()) => Ok(()),
        }
    }
}
