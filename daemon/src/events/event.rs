//! Events, and changes of objects on the bus.

use std::sync::Arc;

use chrono::{DateTime, Utc};
use dbus::FrameSummary;
use survey::printable;

use crate::events::kind::EventKind;

/// Something that happened to the daemon, its rig or a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Event {
    pub at: DateTime<Utc>,
    pub kind: EventKind,
    /// A sentence for people, without control characters.
    pub text: String,
    /// Id of the session that it happened to; `None` for an event of the daemon.
    pub session: Option<String>,
}

impl Event {
    /// An event with this text; control characters are escaped.
    pub(crate) fn new(
        at: DateTime<Utc>,
        kind: EventKind,
        text: &str,
        session: Option<&str>,
    ) -> Self {
        Self {
            at,
            kind,
            text: printable(text).into_owned(),
            session: session.map(str::to_owned),
        }
    }
}

/// Sent to every connection of the bus. Sessions are named by their id.
#[derive(Debug, Clone)]
pub(crate) enum BusEvent {
    SessionAdded(String),
    SessionChanged(String),
    SessionRemoved(String),
    FrameDone(Arc<FrameDone>),
    /// State, active session, baseline or error of the daemon.
    Daemon,
    /// State of the instruments.
    Instruments,
    /// The set of instruments, or the presence of a simulated sheet, may have changed.
    ObjectsChanged,
    Happened(Event),
    /// Each bus connection is to be checked by a ping.
    Heartbeats,
    /// Progress of a self-test.
    TestProgress {
        done: u64,
        total: u64,
        what: String,
    },
}

/// A durable frame, as its signal reports it.
#[derive(Debug)]
pub(crate) struct FrameDone {
    /// Id of its session.
    pub session: String,
    pub sequence: u64,
    /// Nanoseconds since 1970 UTC.
    pub wall_ns: i64,
    pub summary: FrameSummary,
}
