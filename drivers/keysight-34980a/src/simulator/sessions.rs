//! Sessions of several clients, and the exclusive lock (sections 1 and 10).

use std::collections::BTreeMap;
use std::time::Duration;

use scpi::{Common, ParseError};

use super::{Simulator34980a, Wires};
use crate::command::{Command, Functions, Measure, System};

/// A client's connection, numbered by the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
pub struct Session(pub u32);

#[derive(Debug, Default)]
pub(crate) struct Sessions {
    names: BTreeMap<Session, String>,
    /// Time until which each session is busy with its last message.
    busy: BTreeMap<Session, Duration>,
    /// The session that holds the lock, and the number of requests to release.
    lock: Option<(Session, u32)>,
}

impl Sessions {
    /// The start of execution of a message: after the end of the session's previous message.
    pub(crate) fn start_execution(&self, session: Session, at: Duration) -> Duration {
        self.busy.get(&session).map_or(at, |busy| at.max(*busy))
    }

    pub(crate) fn keep_busy(&mut self, session: Session, until: Duration) {
        self.busy.insert(session, until);
    }

    pub(crate) fn free(&mut self, session: Session) {
        self.busy.remove(&session);
    }

    pub(crate) fn is_locked(&self) -> bool {
        self.lock.is_some()
    }

    /// Whether another session's lock forbids a command: queries of the state are allowed, changes and measurements are
    /// not.
    pub(crate) fn forbids(&self, session: Session, query: bool, command: &Command) -> bool {
        if self.lock.is_none_or(|(owner, _)| owner == session) {
            return false;
        }
        match command {
            Command::Common(common) => matches!(common, Common::Reset | Common::Trigger),
            Command::Measure(measure) => {
                !query
                    || matches!(
                        measure,
                        Measure::Read(_)
                            | Measure::Volts { .. }
                            | Measure::ReadAndErase(_)
                            | Measure::Remove(_)
                    )
            }
            // without effect: the session has no lock to release
            Command::System(System::ReleaseLock) => false,
            Command::Functions(Functions::Measure(..)) => true,
            Command::Route(_)
            | Command::Sense(_)
            | Command::Functions(_)
            | Command::Calculate(_)
            | Command::System(_) => !query,
        }
    }

    pub(crate) fn request_lock(&mut self, session: Session) -> bool {
        match &mut self.lock {
            None => self.lock = Some((session, 1)),
            Some((owner, requests)) if *owner == session => *requests = requests.saturating_add(1),
            Some(_) => return false,
        }
        true
    }

    pub(crate) fn release_lock(&mut self, session: Session) {
        match &mut self.lock {
            Some((owner, requests)) if *owner == session && *requests > 1 => *requests -= 1,
            Some((owner, _)) if *owner == session => self.lock = None,
            _ => {}
        }
    }

    /// The session's name in the reply to `SYST:LOCK:NAME?`.
    pub(crate) fn name(&self, session: Session) -> String {
        let named = self.names.get(&session).cloned();
        named.unwrap_or_else(|| format!("LAN{}", session.0 + 1))
    }

    pub(crate) fn owner(&self) -> String {
        match self.lock {
            Some((owner, _)) => self.name(owner),
            None => "NONE".to_owned(),
        }
    }
}

impl Simulator34980a {
    /// Sets a session's name in the reply to `SYST:LOCK:NAME?`: `GPIB`, `USB`, `VXI11`, or `LAN` and an address.
    pub fn name_session(&mut self, session: Session, name: impl Into<String>) {
        self.sessions.names.insert(session, name.into());
    }

    /// Ends a session; its lock is released.
    pub fn end_session(&mut self, session: Session) {
        self.sessions.names.remove(&session);
        self.sessions.busy.remove(&session);
        self.forget_deferred(session);
        if self
            .sessions
            .lock
            .is_some_and(|(owner, _)| owner == session)
        {
            self.sessions.lock = None;
        }
    }

    /// A device clear of a session: cancels the operations that its last message waits for, and stops a running
    /// measurement. Settings, status and error queue stay.
    pub fn clear_session(&mut self, session: Session, at: Duration, wires: &mut dyn Wires) {
        self.sessions.busy.remove(&session);
        self.forget_deferred(session);
        self.pass(at, wires);
        self.stop_measuring(at, wires);
        self.notice(at);
    }

    /// The status byte of a serial poll, at any time. Its message-available bit is 0; the session's server sets it.
    pub fn status_byte(&self) -> u8 {
        self.status.status_byte(!self.errors.is_empty(), false)
    }

    /// Reports a fault of a session's connection: a message arrived before the reply was read (-410), a read without a
    /// query (-420), or both buffers were full (-430).
    pub fn fault_of_session(&mut self, fault: ParseError) {
        self.fail(fault.into());
    }
}
