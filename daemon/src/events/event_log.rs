//! Reports an event: to the journal at a limited rate, to the bus, and to the daemon log if it belongs to no session.
//! Events of a session are written to the record by its recorder.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::mpsc::{self, error::TrySendError};

use crate::events::daemon_log::DaemonLogWriter;
use crate::events::event::{BusEvent, Event};
use crate::events::kind::EventKind;
use crate::events::rate_limit::RateLimit;
use crate::locked::locked;

/// Maximum number of events that wait for one connection. It loses further events, and is soon closed as unresponsive.
const QUEUE: usize = 256;
/// Number of checks on shutdown whether every queue is empty, and the time between them.
const FLUSH_CHECKS: usize = 50;
const FLUSH_CHECK_INTERVAL: Duration = Duration::from_millis(10);

/// Reports events; clones report to the same destinations. No call blocks.
#[derive(Debug, Clone)]
pub(crate) struct EventLog(Arc<Destinations>);

#[derive(Debug)]
struct Destinations {
    journal: RateLimit,
    daemon_log: DaemonLogWriter,
    /// The queue of every connection to the bus.
    connections: Mutex<Vec<mpsc::Sender<BusEvent>>>,
}

impl EventLog {
    /// An event log whose daemon log is in `directory`.
    pub(crate) fn new(directory: PathBuf) -> Self {
        Self(Arc::new(Destinations {
            journal: RateLimit::default(),
            daemon_log: DaemonLogWriter::new(directory),
            connections: Mutex::default(),
        }))
    }

    /// Reports an event to the journal, the bus, and, if it belongs to no session, to the daemon log.
    pub(crate) fn report(&self, event: Event) {
        let session = event.session.as_deref();
        self.0.journal.log(event.kind, session, &event.text);
        if session.is_none() {
            self.0.daemon_log.note(&event);
        }
        self.publish(&BusEvent::Happened(event));
    }

    /// Sends an event to the bus only. A connection whose queue is full loses the event.
    pub(crate) fn publish(&self, event: &BusEvent) {
        locked(&self.0.connections).retain(|connection| {
            !matches!(
                connection.try_send(event.clone()),
                Err(TrySendError::Closed(_))
            )
        });
    }

    /// Writes to the journal only, at a limited rate: for events that clients cause.
    pub(crate) fn journal(&self, kind: EventKind, text: &str) {
        self.0.journal.log(kind, None, text);
    }

    /// Subscribes one more connection to the events from now on, until the receiver is dropped.
    pub(crate) fn subscribe(&self) -> mpsc::Receiver<BusEvent> {
        let (connection, events) = mpsc::channel(QUEUE);
        locked(&self.0.connections).push(connection);
        events
    }

    /// Writes due summaries of suppressed messages to the journal; called periodically.
    pub(crate) fn catch_up(&self) {
        self.0.journal.catch_up();
    }

    /// Waits until every connection has received its events and the daemon log is on disk, for a limited time.
    pub(crate) async fn close(&self) {
        for _ in 0..FLUSH_CHECKS {
            let sent = |connection: &mpsc::Sender<BusEvent>| {
                connection.capacity() == QUEUE || connection.is_closed()
            };
            if locked(&self.0.connections).iter().all(sent) {
                break;
            }
            tokio::time::sleep(FLUSH_CHECK_INTERVAL).await;
        }
        self.0.daemon_log.close().await;
    }
}
