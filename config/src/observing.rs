//! Settings of alarms, notifications and metrics.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};

/// Thresholds of alarms; `tactus status` uses them too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NotifySection {
    /// Days until the disk is full.
    pub disk_days: f64,
    /// Used fraction of a relay's life.
    pub relay_life: f64,
    /// Age of the baseline, days.
    pub baseline_days: f64,
    /// Frame periods without a frame after which the alarm `no-frame` begins, but not before `no_frame_s`.
    pub no_frame_periods: f64,
    /// Shortest time without a frame after which the alarm `no-frame` begins, s.
    pub no_frame_s: f64,
    /// A program and its arguments, run for each message; empty runs none.
    pub command: Vec<String>,
    /// Timeout after which the command is killed, s.
    pub deadline_s: f64,
    /// Shortest time between two notifications of the same kind, s.
    pub again_s: f64,
}

impl NotifySection {
    /// The reset thresholds: an alarm that was raised at the configured thresholds is cleared only at these.
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

/// `[metrics]`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MetricsSection {
    /// Address and port, such as `127.0.0.1:9617`; with port 0 the system chooses a free port.
    pub listen: Option<String>,
    /// Whether other machines may connect.
    pub beyond_localhost: bool,
    /// Host names by which other machines may address this one, in addition to its address.
    pub names: Vec<String>,
}

impl MetricsSection {
    /// The address to listen on; `None` if metrics are off.
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
