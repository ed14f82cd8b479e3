//! Counters, heartbeats, health and its problems, metrics, notifications, and the daily summary. Nothing here can delay
//! a frame. The values are collected, and the monitors run, by `session`.

pub(crate) mod built_in;
pub(crate) mod counters;
pub(crate) mod daily_summary;
pub(crate) mod disk;
pub(crate) mod health;
pub(crate) mod heartbeat;
pub(crate) mod metrics;
pub(crate) mod notices;
pub(crate) mod notification;
mod relay_life;
pub(crate) mod service_manager;

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use survey::Relay;

use crate::instruments::relay_wear::Wear;
use crate::locked::locked;

pub(crate) use crate::monitoring::counters::Counters;
pub(crate) use crate::monitoring::disk::Disk;
pub(crate) use crate::monitoring::relay_life::RelayLife;

/// What the remaining life of relays is projected with: the closures of each relay for a frame, and the frame period.
type ProjectedWith = (Vec<(Relay, f64)>, Duration);

/// Monitoring data kept by the controller.
#[derive(Debug)]
pub(crate) struct Observed {
    pub counters: Arc<Counters>,
    pub disk: Arc<Disk>,
    /// The last reading; `None` before the first.
    relays: Mutex<Option<RelayLife>>,
    projected: Mutex<Option<ProjectedWith>>,
    /// Address of the metrics endpoint.
    metrics: Mutex<Option<SocketAddr>>,
}

impl Observed {
    pub(crate) fn new(clock: rig::SystemClock) -> Self {
        Self {
            counters: Arc::new(Counters::new(clock)),
            disk: Arc::default(),
            relays: Mutex::new(None),
            projected: Mutex::new(None),
            metrics: Mutex::new(None),
        }
    }

    /// The relay with the shortest remaining life, at the time when the counters were read; `None` before.
    pub(crate) fn relays(&self) -> Option<RelayLife> {
        let identities = locked(&self.relays);
        identities.clone()
    }

    /// Whether the relay counters were last projected with these closures of each relay for a frame and this period.
    pub(crate) fn is_projected(&self, closures: &[(Relay, f64)], period: Duration) -> bool {
        let projected = locked(&self.projected);
        let now = projected.as_ref();
        now.is_some_and(|(last, of)| last == closures && *of == period)
    }

    /// Stores newly read relay counters, and what they were projected with.
    pub(crate) fn set_relays(&self, wear: &[Wear], closures: Vec<(Relay, f64)>, period: Duration) {
        *locked(&self.projected) = Some((closures, period));
        let frames = crate::monitoring::counters::read(&self.counters.acquired);
        let worst = RelayLife::worst(wear, period, frames);
        *locked(&self.relays) = worst;
    }

    /// Forgets the relay counters: they are those of other relays, or projected with another rating.
    pub(crate) fn forget_relays(&self) {
        *locked(&self.projected) = None;
        *locked(&self.relays) = None;
    }

    /// Address of the metrics endpoint; `None` without one.
    pub(crate) fn metrics(&self) -> Option<SocketAddr> {
        *locked(&self.metrics)
    }

    /// Sets the address of the metrics endpoint.
    pub(crate) fn set_metrics(&self, address: Option<SocketAddr>) {
        *locked(&self.metrics) = address;
    }
}
