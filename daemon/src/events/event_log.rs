//! The one way of an event: to the journal at a limited rate, to the bus, and to the daemon log where it belongs to no
//! session. Its recorder writes the events of a session to the record.

use std::path::PathBuf;
use std::sync::Arc;

use tokio::sync::mpsc;

use crate::events::broadcast::Broadcast;
use crate::events::daemon_log::DaemonLogWriter;
use crate::events::event::{BusEvent, Event};
use crate::events::rate_limit::RateLimit;

/// Reports events; clones report to the same destinations. Nothing waits.
#[derive(Debug, Clone)]
pub(crate) struct EventLog(Arc<Destinations>);

#[derive(Debug)]
struct Destinations {
    journal: RateLimit,
    daemon_log: DaemonLogWriter,
    bus: Broadcast,
}

impl EventLog {
    /// The daemon log lies in `directory`.
    pub(crate) fn new(directory: PathBuf) -> Self {
        Self(Arc::new(Destinations {
            journal: RateLimit::default(),
            daemon_log: DaemonLogWriter::new(directory),
            bus: Broadcast::default(),
        }))
    }

    /// To the journal, the bus, and the daemon log where the event belongs to no session.
    pub(crate) fn report(&self, event: Event) {
        let session = event.session.as_deref();
        self.0.journal.log(event.kind, session, &event.text);
        if session.is_none() {
            self.0.daemon_log.note(&event);
        }
        self.0.bus.send(&BusEvent::Happened(event));
    }

    /// To the bus alone.
    pub(crate) fn publish(&self, event: &BusEvent) {
        self.0.bus.send(event);
    }

    /// To the journal alone, at a limited rate: what clients cause.
    pub(crate) fn journal(&self, kind: &'static str, text: &str) {
        self.0.journal.log(kind, None, text);
    }

    /// What is sent to the bus from now on; ends when the receiver is dropped.
    pub(crate) fn subscribe(&self) -> mpsc::Receiver<BusEvent> {
        self.0.bus.subscribe()
    }

    /// Writes to the journal what was left out and is due; called now and then.
    pub(crate) fn catch_up(&self) {
        self.0.journal.catch_up();
    }

    /// Waits until every connection has what was sent and the daemon log is on disk, but not long.
    pub(crate) async fn close(&self) {
        self.0.bus.flush().await;
        self.0.daemon_log.close().await;
    }
}
