//! Replies to READ? and MEAS? that are completed when their readings have been taken, each at its own instant.
//!
//! [`Simulator34980a::receive_from`] computes the reply at once and takes its readings ahead of their time, so that
//! they do not contain changes of the rig in the meantime. A real-time server begins a message, waits, and then fetches
//! the reply.

use std::time::Duration;

use crate::simulator::{Response, Session, Simulator34980a, Wires};

/// A reply that waits for its readings.
#[derive(Debug)]
pub(crate) struct Deferred {
    session: Session,
    /// Replies to the other queries of the message.
    before: Option<String>,
    end: Duration,
    /// The readings, once they have been taken.
    readings: Option<String>,
}

impl Simulator34980a {
    /// As [`Simulator34980a::receive_from`], but a message that ends with READ? or MEAS? has its readings taken at
    /// their own instants. In this case the second value is true: the text is not known yet, and
    /// [`Simulator34980a::fetch`] returns it when the response's time is over.
    pub fn begin_from(
        &mut self,
        session: Session,
        line: &str,
        at: Duration,
        wires: &mut dyn Wires,
    ) -> (Response, bool) {
        // A new query cancels the older reply.
        self.forget_deferred(session);
        self.deferring = self.deferred.is_none();
        let mut response = self.receive_from(session, line, at, wires);
        self.deferring = false;
        match &mut self.deferred {
            Some(deferred) if deferred.session == session && deferred.before.is_none() => {
                deferred.before = Some(response.text.take().unwrap_or_default());
                (response, true)
            }
            _ => (response, false),
        }
    }

    /// The reply to a message that was begun. `None` if its measurement was cancelled.
    pub fn fetch(
        &mut self,
        session: Session,
        at: Duration,
        wires: &mut dyn Wires,
    ) -> Option<String> {
        let deferred = self.deferred.as_ref()?;
        if deferred.session != session {
            return None;
        }
        // the readings of an aborted measurement exist before its end
        if deferred.readings.is_none() {
            self.pass(at.max(deferred.end), wires);
        }
        self.settle_deferred(true);
        let deferred = self.deferred.take()?;
        let parts = [deferred.before, deferred.readings];
        let parts = parts.into_iter().flatten().filter(|part| !part.is_empty());
        let text = parts.collect::<Vec<_>>().join(";");
        (!text.is_empty()).then_some(text)
    }

    /// Whether the readings of the reply that a session waits for have been taken, also because another session has
    /// aborted the measurement.
    pub fn has_readings_for(&self, session: Session) -> bool {
        let mut deferred = self.deferred.iter();
        deferred.any(|deferred| deferred.session == session && deferred.readings.is_some())
    }

    /// Stores that a measurement has begun whose readings form the reply.
    pub(crate) fn defer(&mut self, session: Session, end: Duration) {
        self.deferred = Some(Deferred {
            session,
            before: None,
            end,
            readings: None,
        });
    }

    /// Stores the readings when the measurement is over, or just before it is aborted.
    pub(crate) fn settle_deferred(&mut self, over: bool) {
        if let Some(deferred) = &mut self.deferred
            && deferred.readings.is_none()
            && (over || !self.meter.is_at_work())
        {
            let readings = self.meter.memory().read(deferred.end);
            deferred.readings = Some(self.meter.settings.format.write(readings, &self.calendar));
        }
    }

    /// Ends the waiting of a session whose measurement was aborted.
    pub(crate) fn free_deferred(&mut self) {
        let aborted = self.deferred.as_ref().filter(|it| it.readings.is_some());
        if let Some(aborted) = aborted {
            self.sessions.free(aborted.session);
        }
    }

    /// Cancels a session's pending reply.
    pub(crate) fn forget_deferred(&mut self, session: Session) {
        if self
            .deferred
            .as_ref()
            .is_some_and(|deferred| deferred.session == session)
        {
            self.deferred = None;
        }
    }
}
