//! How the daemon is: counters, signs of life, health and its alarms, metrics, notifications, the daily summary. Nothing
//! here can hold a frame back.
//! The values are collected, and the monitors run, by `session`.

pub(crate) mod alarm;
pub(crate) mod counters;
pub(crate) mod daily_summary;
pub(crate) mod disk;
pub(crate) mod health;
pub(crate) mod heartbeat;
pub(crate) mod metrics;
pub(crate) mod notification;
mod relay_life;

use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::instruments::relay_wear::Wear;

pub(crate) use crate::monitoring::counters::Counters;
pub(crate) use crate::monitoring::disk::Disk;
pub(crate) use crate::monitoring::relay_life::RelayLife;

/// What the controller keeps for the monitors.
#[derive(Debug)]
pub(crate) struct Observed {
    pub counters: Arc<Counters>,
    pub disk: Arc<Disk>,
    /// What was read last; `None` before the first time.
    relays: Mutex<Option<RelayLife>>,
    /// Where metrics are served.
    metrics: Mutex<Option<SocketAddr>>,
}

impl Observed {
    pub(crate) fn new(clock: rig::SystemClock) -> Self {
        Self {
            counters: Arc::new(Counters::new(clock)),
            disk: Arc::default(),
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

    /// Metrics are served there from now on.
    pub(crate) fn set_metrics(&self, address: Option<SocketAddr>) {
        *self.metrics.lock().unwrap_or_else(PoisonError::into_inner) = address;
    }
}
