//! How the daemon is, told to whoever asks: nothing here can hold a frame back.
//!
//! - **tally**: what has been counted since the daemon began, over all its sessions
//! - **health**: all that tells whether it is well, in one struct; **troubles**: what is not as it should be
//! - **disk**: what is free and how long that lasts; **relay life**: what was read of wear, carried on frame by frame

mod disk;
mod health;
mod relay_life;
mod tally;

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::care::Wear;

pub(crate) use disk::Disk;
pub(crate) use relay_life::RelayLife;
pub(crate) use tally::Tally;

/// What the keeper holds for its observers.
#[derive(Debug)]
pub(crate) struct Observed {
    pub tally: Arc<Tally>,
    pub disk: Arc<Disk>,
    /// What was read last; `None` before the first time.
    relays: Mutex<Option<RelayLife>>,
}

impl Observed {
    pub(crate) fn new(clock: rig::SystemClock) -> Self {
        Self {
            tally: Arc::new(Tally::new(clock)),
            disk: Arc::default(),
            relays: Mutex::new(None),
        }
    }

    /// The relay that will be worn out first, as it was when the counters were read.
    pub(crate) fn relays(&self) -> Option<RelayLife> {
        let known = self.relays.lock().unwrap_or_else(PoisonError::into_inner);
        known.clone()
    }

    /// The counters of the relays have been read.
    pub(crate) fn set_relays(&self, wear: &[Wear], period: Duration) {
        let frames = tally::read(&self.tally.acquired);
        let worst = RelayLife::worst(wear, period, frames);
        *self.relays.lock().unwrap_or_else(PoisonError::into_inner) = worst;
    }
}
