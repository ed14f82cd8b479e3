//! State shared by all connections of a core channel: the lock, and the abort handles of links.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicU32;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;
use tokio::time::{Instant, timeout_at};

use crate::server::device::Device;
use crate::server::link::{Aborter, Fault};

/// State shared by all connections.
#[derive(Debug)]
pub(super) struct Port<D> {
    pub(super) device: D,
    pub(super) number: u16,
    pub(super) next_link: AtomicU32,
    lock: Mutex<Option<u32>>,
    unlocked: Notify,
    aborters: Mutex<BTreeMap<u32, Aborter>>,
}

impl<D: Device> Port<D> {
    pub(super) fn new(device: D, number: u16) -> Self {
        Self {
            device,
            number,
            next_link: AtomicU32::new(1),
            lock: Mutex::default(),
            unlocked: Notify::new(),
            aborters: Mutex::default(),
        }
    }

    pub(super) fn owner(&self) -> MutexGuard<'_, Option<u32>> {
        self.lock.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn aborters(&self) -> MutexGuard<'_, BTreeMap<u32, Aborter>> {
        self.aborters.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn release(&self, link: u32) -> bool {
        let mut owner = self.owner();
        let held = *owner == Some(link);
        if held {
            *owner = None;
            self.unlocked.notify_waiters();
        }
        held
    }

    /// Waits until no other link holds the lock, and acquires it if `take` is set.
    ///
    /// # Errors
    /// [`Fault::LockedByAnother`] at the deadline, or at once without `wait`.
    pub(super) async fn pass(
        &self,
        link: u32,
        take: bool,
        wait: bool,
        deadline: Instant,
    ) -> Result<(), Fault> {
        loop {
            let unlocked = self.unlocked.notified();
            {
                let mut owner = self.owner();
                if owner.is_none_or(|owner| owner == link) {
                    if take {
                        *owner = Some(link);
                    }
                    return Ok(());
                }
            }
            if !wait || timeout_at(deadline, unlocked).await.is_err() {
                return Err(Fault::LockedByAnother);
            }
        }
    }
}
