//! Carries news to every connection without waiting for any.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::mpsc;

use crate::recording::session_status::{Live, Published};
use crate::session::controller::Happening;

/// News that may wait for one connection; beyond it news is lost for that one, which will soon be found frozen.
const QUEUE: usize = 256;

/// Something to be said aloud.
#[derive(Debug, Clone)]
pub(crate) enum Notice {
    SessionAdded(Arc<Live>),
    SessionChanged(Arc<Live>),
    SessionRemoved(String),
    FrameDone(Arc<Live>, Arc<Published>),
    /// State, active session, baseline or error of the daemon.
    Daemon,
    /// State of the instruments.
    Instruments,
    /// Which instruments there are, and whether there is a simulated sheet, may have changed.
    Furniture,
    /// Something happened to the rig, or to a session by it.
    Happened(Happening),
    /// Whether the bus is still there is asked of each.
    Pulse,
    /// How far a self-test is.
    TestProgress {
        done: u64,
        total: u64,
        what: String,
    },
}

/// Everybody who carries news on.
#[derive(Debug, Default)]
pub(crate) struct Herald {
    ears: Mutex<Vec<mpsc::Sender<Notice>>>,
}

impl Herald {
    /// Somebody who wants to hear; dropped when the receiver is.
    pub(crate) fn listen(&self) -> mpsc::Receiver<Notice> {
        let (ear, news) = mpsc::channel(QUEUE);
        self.lock().push(ear);
        news
    }

    /// Tells everybody; never waits.
    pub(crate) fn say(&self, notice: &Notice) {
        self.lock().retain(|ear| {
            !matches!(
                ear.try_send(notice.clone()),
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
                .all(|ear| ear.capacity() == QUEUE || ear.is_closed())
            {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<mpsc::Sender<Notice>>> {
        self.ears.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
