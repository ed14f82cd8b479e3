//! Events of the session: reported immediately, and written in order. If the disk is full, an event waits for space
//! like a frame, and events about the disk may be written before it. After an I/O error it is written to the next part.

use chrono::{DateTime, Utc};
use logbook::LogbookError;
use rig::Clock;

use crate::events::event::Event;
use crate::events::kind::EventKind;
use crate::recording::logbook_sink::LogbookSink;

impl LogbookSink {
    /// Reports an event and writes it; waits for space as long as needed.
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

    /// Reports an event, which is written at the next [`LogbookSink::settle`]: for events that occur during a wait for
    /// space.
    pub(in crate::recording) fn note(&mut self, kind: EventKind, text: &str) {
        let event = self.report(kind, text);
        self.disk.unwritten.push_back(event);
    }

    /// Reports an event that is not written to the record by this sink.
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

    /// Writes an event that has already been reported.
    ///
    /// # Errors
    /// As [`LogbookSink::settle`].
    pub(in crate::recording) fn event(&mut self, event: Event) -> Result<(), LogbookError> {
        self.disk.unwritten.push_back(event);
        self.settle()
    }

    /// Writes the waiting events, including those added meanwhile.
    ///
    /// # Errors
    /// A permanent disk error, or the session was requested to end while there was no space.
    pub(in crate::recording) fn settle(&mut self) -> Result<(), LogbookError> {
        // removed first: events during the wait for space must not write it again
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

    /// Writes the events for which there is space, without waiting.
    ///
    /// # Errors
    /// A permanent disk error.
    pub(in crate::recording) fn settle_what_fits(&mut self) -> Result<(), LogbookError> {
        while let Some(event) = self.disk.unwritten.front() {
            match self
                .writer
                .event(event.at, event.kind.as_str(), &event.text)
            {
                Ok(()) => {}
                // the next write handles the error
                Err(error) if error.may_pass() || error.needs_successor() => return Ok(()),
                Err(error) => return Err(error),
            }
            self.disk.unwritten.pop_front();
        }
        Ok(())
    }
}
