//! Carries news to every connection without waiting for any.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::mpsc;

use crate::recording::session_status::{Published, SessionStatus};
use crate::session::controller::Happening;

/// News that may wait for one connection; beyond it news is lost for that one, which will soon be found frozen.
const QUEUE: usize = 256;

/// Something to be said aloud.
#[derive(Debug, Clone)]
pub(crate) enum BusEvent {
    SessionAdded(Arc<SessionStatus>),
    SessionChanged(Arc<SessionStatus>),
    SessionRemoved(String),
    FrameDone(Arc<SessionStatus>, Arc<Published>),
    /// State, active session, baseline or error of the daemon.
    Daemon,
    /// State of the instruments.
    Instruments,
    /// Which instruments there are, and whether there is a simulated sheet, may have changed.
    ObjectsChanged,
    /// Something happened to the rig, or to a session by it.
    Happened(Happening),
    /// Whether the bus is still there is asked of each.
    Heartbeats,
    /// How far a self-test is.
    TestProgress {
        done: u64,
        total: u64,
        what: String,
    },
}

/// Everybody who carries news on.
#[derive(Debug, Default)]
pub(crate) struct Broadcast {
    receivers: Mutex<Vec<mpsc::Sender<BusEvent>>>,
}

impl Broadcast {
    /// Somebody who wants to hear; dropped when the receiver is.
    pub(crate) fn listen(&self) -> mpsc::Receiver<BusEvent> {
        let (receiver, news) = mpsc::channel(QUEUE);
        self.lock().push(receiver);
        news
    }

    /// Tells everybody; never waits.
    pub(crate) fn say(&self, event: &BusEvent) {
        self.lock().retain(|receiver| {
            !matches!(
                receiver.try_send(event.clone()),
                Err(mpsc::error::TrySendError::Closed(_))
            )
        });
    }

    /// Waits until everybody has heard everything, or half a second.
    pub(crate) async fn farewell(&self) {
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
