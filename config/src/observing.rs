//! How the daemon is observed: what is trouble, and who is told.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

/// From when on something is trouble; `tactus status` goes by it, too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NotifySection {
    /// Days until the disk is full.
    pub disk_days: f64,
    /// Part of a relay's life that is used.
    pub relay_life: f64,
    /// Age of the baseline, days.
    pub baseline_days: f64,
    /// Times the period that pass without a frame, but at least `no_frame_s`.
    pub no_frame_periods: f64,
    /// s
    pub no_frame_s: f64,
    /// A program and its arguments, run for each message; empty runs none.
    pub command: Vec<String>,
    /// The command is killed after so long, s.
    pub deadline_s: f64,
    /// A kind of trouble is told of at most so often, s.
    pub again_s: f64,
}

impl NotifySection {
    /// Limits by which a trouble goes on that has begun by the narrower ones.
    pub fn wider(&self) -> Self {
        Self {
            disk_days: 1.1 * self.disk_days,
            relay_life: 0.99 * self.relay_life,
            baseline_days: 0.99 * self.baseline_days,
            no_frame_periods: 0.5 * self.no_frame_periods,
            no_frame_s: 0.5 * self.no_frame_s,
            ..self.clone()
        }
    }
}

/// Numbers for whoever scrapes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MetricsSection {
    /// `127.0.0.1:9617`; port 0 is any that is free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub listen: Option<String>,
    /// Whether other machines may scrape.
    pub beyond_localhost: bool,
    /// Names under which they know this machine, where they do not ask by its address.
    pub names: Vec<String>,
}

impl MetricsSection {
    /// Where to listen; `None` where nobody may scrape.
    pub fn address(&self) -> Option<SocketAddr> {
        self.listen.as_ref()?.parse().ok()
    }
}

impl Default for NotifySection {
    fn default() -> Self {
        Self {
            disk_days: 14.0,
            relay_life: 0.9,
            baseline_days: 30.0,
            no_frame_periods: 5.0,
            no_frame_s: 10.0,
            command: Vec::new(),
            deadline_s: 10.0,
            again_s: 3600.0,
        }
    }
}
