//! The messages of the recorder's queue.

use chrono::{DateTime, Utc};
use imaging::tracking::TrackingOrder;
use survey::Frame;
use tokio::sync::oneshot;

use crate::events::event::Event;

/// Maximum number of messages in the queue; if it is full, acquisition waits.
pub(crate) const QUEUE: usize = 16;

/// A message to the recorder.
#[derive(Debug)]
pub(crate) enum RecorderMessage {
    Frame(Box<Frame>),
    /// Write an event to the record; it has been reported.
    Event(Event),
    /// An operator's order to the tracked baseline. The reply is the number of the first frame to which it applies, or
    /// why it cannot be carried out.
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
