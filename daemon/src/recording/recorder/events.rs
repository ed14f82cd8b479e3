//! Events of the session: told to everybody at once, and written in the order in which they came. One that meets a full
//! disk waits for room as a frame does, and what is said of that may come before it; one that meets a broken one goes to the next part.

use chrono::{DateTime, Utc};
use logbook::LogbookError;
use rig::Clock;
use survey::printable;

use crate::recording::recorder::Recorder;

/// An event that is not in the record yet.
#[derive(Debug)]
pub(super) struct Unwritten {
    at: DateTime<Utc>,
    kind: &'static str,
    text: String,
}

impl Recorder {
    /// To everybody, and to the record, however long it takes until there is room.
    ///
    /// # Errors
    /// As [`Recorder::settle`].
    pub(super) fn say(&mut self, kind: &'static str, text: &str) -> Result<(), LogbookError> {
        self.note(kind, text);
        self.settle()
    }

    /// To everybody, and to the record when the next [`Recorder::settle`] comes by: for what is said while room is waited
    /// for.
    pub(super) fn note(&mut self, kind: &'static str, text: &str) {
        let at = self.clock.wall();
        let text = &*printable(text);
        (self.tell)(at, kind, text);
        self.disk.unwritten.push_back(Unwritten {
            at,
            kind,
            text: text.to_owned(),
        });
    }

    /// To the record, which has told everybody.
    ///
    /// # Errors
    /// As [`Recorder::settle`].
    pub(super) fn event(
        &mut self,
        at: DateTime<Utc>,
        kind: &'static str,
        text: String,
    ) -> Result<(), LogbookError> {
        let text = printable(&text).into_owned();
        self.disk.unwritten.push_back(Unwritten { at, kind, text });
        self.settle()
    }

    /// Writes the events that wait, those that come up meanwhile among them.
    ///
    /// # Errors
    /// The disk refuses in a way that does not pass, or the session was asked to end while there was no room.
    pub(super) fn settle(&mut self) -> Result<(), LogbookError> {
        // taken out first: what is said while it waits for room is written past it, and does not write it, too
        while let Some(event) = self.disk.unwritten.pop_front() {
            let written = self.persist(|writer| writer.event(event.at, event.kind, &event.text));
            if let Err(error) = written {
                self.disk.unwritten.push_front(event);
                return Err(error);
            }
        }
        Ok(())
    }

    /// Writes those that there is room for, and waits for none.
    ///
    /// # Errors
    /// The disk refuses in a way that does not pass.
    pub(super) fn settle_what_fits(&mut self) -> Result<(), LogbookError> {
        while let Some(event) = self.disk.unwritten.front() {
            match self.writer.event(event.at, event.kind, &event.text) {
                Ok(()) => {}
                // who writes next finds out
                Err(error)
                    if error.is_full()
                        || error.is_broken()
                        || error.is_locked()
                        || error.is_gone() =>
                {
                    return Ok(());
                }
                Err(error) => return Err(error),
            }
            self.disk.unwritten.pop_front();
        }
        Ok(())
    }
}
