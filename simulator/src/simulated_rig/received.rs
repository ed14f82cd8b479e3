//! Messages from clients to the instruments, and logging of refused ones.

use std::time::Duration;

use rig::transcript::EntryContent;
use scpi::ParseError;

use crate::instrument::Instrument;
use crate::simulated_instruments::{MessageOutcome, ReplyTiming};
use crate::simulated_rig::SimulatedRig;

/// The rig's own session.
const OWN_SESSION: u32 = 0;

impl SimulatedRig {
    /// Passes a message to an instrument; returns its reply and the time it takes for the caller.
    pub fn receive(&self, instrument: Instrument, line: &str) -> (Option<String>, Duration) {
        let received = self.receive_from(instrument, OWN_SESSION, line, ReplyTiming::AtOnce);
        (received.text, received.wait)
    }

    /// As [`SimulatedRig::receive`], from a session with an output queue of its own. A message of a session that has
    /// ended meanwhile is not executed, and has no reply.
    pub(crate) fn receive_from(
        &self,
        instrument: Instrument,
        session: u32,
        line: &str,
        timing: ReplyTiming,
    ) -> MessageOutcome {
        self.apply_due_faults();
        let mut received = {
            let mut instruments = self.instruments();
            if self.has_ended(session) {
                tracing::debug!(
                    "a message to the {instrument} is dropped: its client has disconnected"
                );
                return MessageOutcome::default();
            }
            let at = instruments.now();
            let received = instruments.receive(instrument, session, line, timing);
            self.record_line(
                &mut instruments,
                instrument,
                session,
                at,
                EntryContent::Sent(line.to_owned()),
            );
            if let Some(reply) = &received.text {
                let content = EntryContent::Received(reply.clone());
                self.record_line(
                    &mut instruments,
                    instrument,
                    session,
                    at + received.wait,
                    content,
                );
            }
            received
        };
        if let Some(refused) = received.refused.take() {
            self.report_refused(instrument, session, line, refused);
        }
        self.shared.changed.notify_waiters();
        received
    }

    /// Whether a client's session has ended; the rig's own never does. The result stays valid while the caller has
    /// locked the instruments, because the end of a session waits for them.
    fn has_ended(&self, session: u32) -> bool {
        session != OWN_SESSION && !self.clients().contains_key(&session)
    }

    /// Performs what is due; returns whether a session's postponed reply is there before its time.
    pub(crate) fn catch_up(&self, instrument: Instrument, session: u32) -> bool {
        self.apply_due_faults();
        let mut instruments = self.instruments();
        instruments.catch_up();
        instruments.has_reply(instrument, session)
    }

    /// An instrument's postponed reply, after its time.
    pub(crate) fn fetch(&self, instrument: Instrument, session: u32) -> Option<String> {
        self.apply_due_faults();
        let text = {
            let mut instruments = self.instruments();
            let text = instruments.fetch(instrument, session);
            if let Some(reply) = &text {
                let (at, content) = (instruments.now(), EntryContent::Received(reply.clone()));
                self.record_line(&mut instruments, instrument, session, at, content);
            }
            text
        };
        self.shared.changed.notify_waiters();
        text
    }

    /// Queues an error that does not belong to a message of a session. Only the board sends a reply.
    pub(crate) fn refuse(
        &self,
        instrument: Instrument,
        session: u32,
        refusal: ParseError,
    ) -> Option<String> {
        let reply = self.instruments().refuse(instrument, session, refusal);
        self.report_refused(instrument, session, "", refusal.to_string());
        reply
    }

    fn report_refused(&self, instrument: Instrument, session: u32, line: &str, refused: String) {
        let from = self
            .clients()
            .get(&session)
            .map_or_else(|| "the rig".to_owned(), |(_, address)| address.clone());
        // Escaped: untrusted text must not control a terminal.
        let shown: String = line.chars().take(80).flat_map(char::escape_debug).collect();
        match line {
            "" => tracing::warn!("{from} at the {instrument}: {refused}"),
            _ => tracing::warn!("{from} sent the {instrument} '{shown}': {refused}"),
        }
        self.instruments().last_error = Some(format!("{instrument}: {refused} (from {from})"));
    }

    pub(crate) fn name_session(&self, instrument: Instrument, session: u32, name: &str) {
        self.instruments().name_session(instrument, session, name);
    }

    pub(crate) fn forget_session(&self, instrument: Instrument, session: u32) {
        self.instruments().forget_session(instrument, session);
    }

    pub(crate) fn clear_session(&self, instrument: Instrument, session: u32) {
        let mut instruments = self.instruments();
        // A clear stops a measurement, which another client may have started after the end of this session.
        if !self.has_ended(session) {
            instruments.clear_session(instrument, session);
        }
        drop(instruments);
        self.shared.changed.notify_waiters();
    }

    /// The line end of the source's serial port.
    pub(crate) fn serial_terminator(&self) -> &'static str {
        self.instruments().source().serial_terminator()
    }

    pub(crate) fn status_byte(&self, instrument: Instrument) -> u8 {
        self.instruments().status_byte(instrument)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::client::ClientSession;
    use crate::{Pace, Profile, Scene};

    #[tokio::test]
    async fn messages_of_an_ended_session_are_not_executed() {
        let profile = Profile::default().at_pace(Pace::Instant);
        let rig = SimulatedRig::new(&profile, Scene::quiet()).unwrap();
        for (instrument, message) in [
            (Instrument::Source, "OUTP ON"),
            (Instrument::Mainframe, "ROUT:CLOS (@1036)"),
        ] {
            let client = ClientSession::register(&rig, instrument, "memory");
            let clients: Vec<u32> = rig.clients().keys().copied().collect();
            let [session] = clients[..] else {
                panic!("{clients:?}");
            };
            let from = |line| rig.receive_from(instrument, session, line, ReplyTiming::AtOnce);
            assert!(from("*IDN?").text.is_some());
            let before = rig.messages(instrument);
            // Its message waits for a thread while the connection is reset.
            drop(client);
            let outcome = from(message);
            assert_eq!((outcome.text, outcome.later), (None, false));
            assert!(from("*IDN?").text.is_none());
            assert_eq!(rig.messages(instrument), before);
        }
        assert!(!rig.source_output().0);
        assert!(rig.closed().is_empty());
    }

    #[tokio::test]
    async fn a_clear_of_an_ended_session_stops_no_measurement() {
        let profile = Profile::default().at_pace(Pace::Instant);
        let rig = SimulatedRig::new(&profile, Scene::quiet()).unwrap();
        let ask = |line| rig.receive(Instrument::Mainframe, line).0;
        ask("TRIG:SOUR BUS;:INIT");
        assert_eq!(ask("STAT:OPER:COND?").as_deref(), Some("+32"));
        rig.clear_session(Instrument::Mainframe, u32::MAX);
        assert_eq!(ask("STAT:OPER:COND?").as_deref(), Some("+32"));
        rig.clear_session(Instrument::Mainframe, OWN_SESSION);
        assert_eq!(ask("STAT:OPER:COND?").as_deref(), Some("+0"));
    }
}
