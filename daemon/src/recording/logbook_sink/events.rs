//! Events of the session: reported at once, and written in the order in which they came. One that meets a full disk waits
//! for room as a frame does, and events about that may come before it; one that meets a broken disk goes to the next part.

use chrono::{DateTime, Utc};
use logbook::LogbookError;
use rig::Clock;

use crate::events::event::Event;
use crate::events::kind::EventKind;
use crate::recording::logbook_sink::LogbookSink;

impl LogbookSink {
    /// Reports an event, and writes it, however long it takes until there is room.
    ///
    /// # Errors
    /// As [`LogbookSink::settle`].
    pub(in crate::recording) fn write_event(
        &mut self,
        kind: EventKind,
        text: &str,
    ) -> Result<(), LogbookError> {
        self.note(kind, text);
        self.settle()
    }

    /// Reports an event, and writes it when the next [`LogbookSink::settle`] comes by: for what happens while room is waited
    /// for.
    pub(in crate::recording) fn note(&mut self, kind: EventKind, text: &str) {
        let event = self.report(kind, text);
        self.disk.unwritten.push_back(event);
    }

    /// Reports an event that is not written to the record, or not here.
    pub(in crate::recording) fn report(&self, kind: EventKind, text: &str) -> Event {
        let event = self.event_at(self.clock.wall(), kind, text);
        self.events.report(event.clone());
        event
    }

    /// An event of this session.
    pub(in crate::recording) fn event_at(
        &self,
        at: DateTime<Utc>,
        kind: EventKind,
        text: &str,
    ) -> Event {
        Event::new(at, kind, text, Some(&self.status.facts.id))
    }

    /// Writes an event that has been reported.
    ///
    /// # Errors
    /// As [`LogbookSink::settle`].
    pub(in crate::recording) fn event(&mut self, event: Event) -> Result<(), LogbookError> {
        self.disk.unwritten.push_back(event);
        self.settle()
    }

    /// Writes the events that wait, those that come up meanwhile among them.
    ///
    /// # Errors
    /// The disk refuses in a way that does not pass, or the session was asked to end while there was no room.
    pub(in crate::recording) fn settle(&mut self) -> Result<(), LogbookError> {
        // taken out first: what is said while it waits for room is written past it, and does not write it, too
        while let Some(event) = self.disk.unwritten.pop_front() {
            let written =
                self.persist(|writer| writer.event(event.at, event.kind.as_str(), &event.text));
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
    pub(in crate::recording) fn settle_what_fits(&mut self) -> Result<(), LogbookError> {
        while let Some(event) = self.disk.unwritten.front() {
            match self
                .writer
                .event(event.at, event.kind.as_str(), &event.text)
            {
                Ok(()) => {}
                // the next write meets the same error
                Err(error) if error.may_pass() || error.needs_successor() => return Ok(()),
                Err(error) => return Err(error),
            }
            self.disk.unwritten.pop_front();
        }
        Ok(())
    }
}
