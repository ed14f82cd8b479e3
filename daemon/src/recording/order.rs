//! What the recorder is asked to do: the messages of its queue.

use chrono::{DateTime, Utc};
use survey::Frame;

use crate::events::event::Event;

/// Frames that may wait for the disk before acquisition does.
pub(crate) const QUEUE: usize = 16;

/// A message to the recorder.
#[derive(Debug)]
pub(crate) enum Order {
    Frame(Box<Frame>),
    /// To be written to the record; it has been reported.
    Event(Event),
    /// A map that was late is ready.
    MapReady,
    /// It is time to look whether the file is still in its place.
    LookAtPlace,
    Close {
        at: DateTime<Utc>,
        reason: String,
    },
    /// As [`Order::Close`], but the session goes on with the next daemon.
    Leave {
        at: DateTime<Utc>,
        reason: String,
    },
}
