//! The messages of the recorder's queue.

use chrono::{DateTime, Utc};
use survey::Frame;

use crate::events::event::Event;

/// Most frames waiting for the disk; then acquisition waits.
pub(crate) const QUEUE: usize = 16;

/// A message to the recorder.
#[derive(Debug)]
pub(crate) enum RecorderMessage {
    Frame(Box<Frame>),
    /// Write an event to the record; it has been reported.
    Event(Event),
    /// A map that was late is ready.
    MapReady,
    /// Check that the file is still at its path.
    CheckFile,
    Close {
        at: DateTime<Utc>,
        reason: String,
    },
    /// Like [`RecorderMessage::Close`], but the session is resumed by the next daemon.
    Leave {
        at: DateTime<Utc>,
        reason: String,
    },
}
