//! What the instruments hear, from whom, and what is told of what they refuse.

use std::time::Duration;

use rig::transcript::Said;
use scpi::ParseError;

use super::{Instrument, SimulatedRig};

impl SimulatedRig {
    /// Lets an instrument hear one message, and says what it answers and how long that takes in the caller's time.
    pub fn hear(&self, instrument: Instrument, line: &str) -> (Option<String>, Duration) {
        self.hear_from(instrument, 0, line)
    }

    /// As [`SimulatedRig::hear`], from a session with an output queue of its own.
    pub(crate) fn hear_from(
        &self,
        instrument: Instrument,
        session: u32,
        line: &str,
    ) -> (Option<String>, Duration) {
        self.apply_due_faults();
        let (heard, refused) = {
            let mut bench = self.bench();
            let at = bench.now();
            let heard = bench.hear(instrument, session, line);
            let (reply, busy) = &heard.0;
            self.record_line(
                &mut bench,
                instrument,
                session,
                at,
                Said::Sent(line.to_owned()),
            );
            if let Some(reply) = reply {
                let said = Said::Received(reply.clone());
                self.record_line(&mut bench, instrument, session, at + *busy, said);
            }
            heard
        };
        if let Some(refused) = refused {
            self.tell_refused(instrument, session, line, refused);
        }
        self.shared.changed.notify_waiters();
        heard
    }

    /// Queues an error that arose outside of any message of a session.
    pub(crate) fn refuse(&self, instrument: Instrument, session: u32, refusal: ParseError) {
        self.bench().refuse(instrument, session, refusal);
        self.tell_refused(instrument, session, "", refusal.to_string());
    }

    fn tell_refused(&self, instrument: Instrument, session: u32, line: &str, refused: String) {
        let from = self
            .guests()
            .get(&session)
            .map_or_else(|| "the bench".to_owned(), |(_, address)| address.clone());
        // Escaped: what a stranger sends must not steer a terminal.
        let shown: String = line.chars().take(80).flat_map(char::escape_debug).collect();
        match line {
            "" => tracing::warn!("{from} at the {instrument}: {refused}"),
            _ => tracing::warn!("{from} told the {instrument} '{shown}': {refused}"),
        }
        self.bench().last_error = Some(format!("{instrument}: {refused} (from {from})"));
    }

    pub(crate) fn name_session(&self, instrument: Instrument, session: u32, name: &str) {
        self.bench().name_session(instrument, session, name);
    }

    pub(crate) fn forget_session(&self, instrument: Instrument, session: u32) {
        self.bench().forget_session(instrument, session);
    }

    pub(crate) fn clear_session(&self, session: u32) {
        self.bench().clear_session(session);
        self.shared.changed.notify_waiters();
    }

    pub(crate) fn status_byte(&self) -> u8 {
        self.bench().status_byte()
    }
}
