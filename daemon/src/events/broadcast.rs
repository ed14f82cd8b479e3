//! The queues of the connections to the bus; sending waits for none of them.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::mpsc;

use crate::events::event::BusEvent;

/// Events that may wait for one connection; beyond it they are lost for that one, which will soon be found frozen.
const QUEUE: usize = 256;

/// The queue of every connection.
#[derive(Debug, Default)]
pub(crate) struct Broadcast {
    receivers: Mutex<Vec<mpsc::Sender<BusEvent>>>,
}

impl Broadcast {
    /// A queue for one more connection; it ends when the receiver is dropped.
    pub(crate) fn subscribe(&self) -> mpsc::Receiver<BusEvent> {
        let (receiver, events) = mpsc::channel(QUEUE);
        self.lock().push(receiver);
        events
    }

    /// Sends to every connection; never waits.
    pub(crate) fn send(&self, event: &BusEvent) {
        self.lock().retain(|receiver| {
            !matches!(
                receiver.try_send(event.clone()),
                Err(mpsc::error::TrySendError::Closed(_))
            )
        });
    }

    /// Waits until every queue is empty, or half a second.
    pub(crate) async fn flush(&self) {
        for _ in 0..50 {
            if self
                .lock()
                .iter()
                .all(|receiver| receiver.capacity() == QUEUE || receiver.is_closed())
            {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<mpsc::Sender<BusEvent>>> {
        self.receivers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}
