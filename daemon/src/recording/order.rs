//! The messages of the recorder's queue.

use chrono::{DateTime, Utc};
use survey::Frame;

use crate::events::event::Event;

/// Most frames waiting for the disk; then acquisition waits.
pub(crate) const QUEUE: usize = 16;

/// A message to the recorder.
#[derive(Debug)]
pub(crate) enum Order {
    Frame(Box<Frame>),
    /// Write an event to the record; it has been reported.
    Event(Event),
    /// A map that was late is ready.
    MapReady,
    /// Check that the file is still at its path.
    LookAtPlace,
    Close {
        at: DateTime<Utc>,
        reason: String,
    },
    /// Like [`Order::Close`], but the session is resumed by the next daemon.
    Leave {
        at: DateTime<Utc>,
        reason: String,
    },
}
