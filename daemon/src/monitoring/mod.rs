//! How the daemon is, told to whoever asks: nothing here can hold a frame back.
//!
//! - **tally**: what has been counted since the daemon began, over all its sessions
//! - **health**: all that tells whether it is well, in one struct; **troubles**: what is not as it should be
//! - **disk**: what is free and how long that lasts; **relay life**: what was read of wear, carried on frame by frame
//! - **aloud**: what the journal says, each kind once and then at a limited rate; **chronicle**: events of no session
//! - **alarm**: which troubles people are told of, and when; **notify**: the command that tells them
//! - **metrics** at a **scrape** door; **daily**: one line a day; **observer**: the task that does all of it

mod alarm;
mod counters;
mod daily_summary;
mod disk;
mod health;
pub(crate) mod heartbeat;
mod metrics;
mod metrics_listener;
mod notification;
mod observer;
mod relay_life;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::instruments::relay_wear::Wear;

pub(crate) use crate::events::daemon_log::DaemonLogWriter;
pub(crate) use crate::events::rate_limit::RateLimit;
pub(crate) use crate::monitoring::counters::Counters;
pub(crate) use crate::monitoring::disk::Disk;
pub(crate) use crate::monitoring::observer::observe;
pub(crate) use crate::monitoring::relay_life::RelayLife;

/// What the keeper holds for its observers.
#[derive(Debug)]
pub(crate) struct Observed {
    pub counters: Arc<Counters>,
    pub disk: Arc<Disk>,
    pub rate_limit: RateLimit,
    pub daemon_log: DaemonLogWriter,
    /// What was read last; `None` before the first time.
    relays: Mutex<Option<RelayLife>>,
    /// Where metrics are served.
    metrics: Mutex<Option<SocketAddr>>,
}

impl Observed {
    pub(crate) fn new(clock: rig::SystemClock, directory: PathBuf) -> Self {
        Self {
            counters: Arc::new(Counters::new(clock)),
            disk: Arc::default(),
            rate_limit: RateLimit::default(),
            daemon_log: DaemonLogWriter::new(directory),
            relays: Mutex::new(None),
            metrics: Mutex::new(None),
        }
    }

    /// The relay that will be worn out first, as it was when the counters were read.
    pub(crate) fn relays(&self) -> Option<RelayLife> {
        let identities = self.relays.lock().unwrap_or_else(PoisonError::into_inner);
        identities.clone()
    }

    /// The counters of the relays have been read.
    pub(crate) fn set_relays(&self, wear: &[Wear], period: Duration) {
        let frames = crate::monitoring::counters::read(&self.counters.acquired);
        let worst = RelayLife::worst(wear, period, frames);
        *self.relays.lock().unwrap_or_else(PoisonError::into_inner) = worst;
    }

    /// Where metrics are served; `None` where they are not.
    pub(crate) fn metrics(&self) -> Option<SocketAddr> {
        *self.metrics.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set_metrics(&self, address: Option<SocketAddr>) {
        *self.metrics.lock().unwrap_or_else(PoisonError::into_inner) = address;
    }
}
