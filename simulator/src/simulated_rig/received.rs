//! What the instruments hear, from whom, and what is told of what they refuse.

use std::time::Duration;

use rig::transcript::Said;
use scpi::ParseError;

use crate::simulated_instruments::{Heard, When};
use crate::simulated_rig::{Instrument, SimulatedRig};

impl SimulatedRig {
    /// Lets an instrument hear one message, and says what it answers and how long that takes in the caller's time.
    pub fn hear(&self, instrument: Instrument, line: &str) -> (Option<String>, Duration) {
        let heard = self.hear_from(instrument, 0, line, When::AtOnce);
        (heard.text, heard.wait)
    }

    /// As [`SimulatedRig::hear`], from a session with an output queue of its own.
    pub(crate) fn hear_from(
        &self,
        instrument: Instrument,
        session: u32,
        line: &str,
        when: When,
    ) -> Heard {
        self.apply_due_faults();
        let mut heard = {
            let mut bench = self.bench();
            let at = bench.now();
            let heard = bench.hear(instrument, session, line, when);
            self.record_line(
                &mut bench,
                instrument,
                session,
                at,
                Said::Sent(line.to_owned()),
            );
            if let Some(reply) = &heard.text {
                let said = Said::Received(reply.clone());
                self.record_line(&mut bench, instrument, session, at + heard.wait, said);
            }
            heard
        };
        if let Some(refused) = heard.refused.take() {
            self.tell_refused(instrument, session, line, refused);
        }
        self.shared.changed.notify_waiters();
        heard
    }

    /// Lets happen what was due by now.
    pub(crate) fn catch_up(&self) {
        self.apply_due_faults();
        self.bench().catch_up();
    }

    /// The mainframe's reply that was to be made later, now that its time is over.
    pub(crate) fn fetch(&self, session: u32) -> Option<String> {
        self.apply_due_faults();
        let text = {
            let mut bench = self.bench();
            let text = bench.fetch(session);
            if let Some(reply) = &text {
                let (at, said) = (bench.now(), Said::Received(reply.clone()));
                self.record_line(&mut bench, Instrument::Mainframe, session, at, said);
            }
            text
        };
        self.shared.changed.notify_waiters();
        text
    }

    /// Queues an error that arose outside of any message of a session. The board answers even so.
    pub(crate) fn refuse(
        &self,
        instrument: Instrument,
        session: u32,
        refusal: ParseError,
    ) -> Option<String> {
        let reply = self.bench().refuse(instrument, session, refusal);
        self.tell_refused(instrument, session, "", refusal.to_string());
        reply
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

    /// What ends a line on the source's serial port.
    pub(crate) fn serial_terminator(&self) -> &'static str {
        self.bench().source.serial_terminator()
    }

    pub(crate) fn status_byte(&self) -> u8 {
        self.bench().status_byte()
    }
}
