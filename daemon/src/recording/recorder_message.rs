//! The messages of the recorder's queue.

use chrono::{DateTime, Utc};
use imaging::tracking::TrackingOrder;
use survey::Frame;
use tokio::sync::oneshot;

use crate::events::event::Event;

/// Most frames waiting for the disk; then acquisition waits.
pub(crate) const QUEUE: usize = 16;

/// A message to the recorder.
#[derive(Debug)]
pub(crate) enum RecorderMessage {
    Frame(Box<Frame>),
    /// Write an event to the record; it has been reported.
    Event(Event),
    /// An order of a person to the tracked baseline; the reply is the number of the first frame that it is for, or why it cannot
    /// be carried out.
    Order {
        order: TrackingOrder,
        by: String,
        reply: oneshot::Sender<Result<u64, String>>,
    },
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
