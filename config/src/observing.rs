//! Settings of alarms, notifications and metrics.

use std::net::SocketAddr;

use serde::{Deserialize, Serialize};
use survey::Bounds::{Above, Within};
use survey::LONGEST_S;

use crate::bounds::DAYS;
use crate::section::section;

section! {
    /// Thresholds of alarms; `tactus status` uses them too.
    NotifySection, "notify" {
        /// Days until the disk is full.
        disk_days: f64 = 14.0, in DAYS;
        /// Used fraction of a relay's life.
        relay_life: f64 = 0.9, in Above(0.0, 1.0);
        /// Age of the baseline, days.
        baseline_days: f64 = 30.0, in DAYS;
        /// Frame periods without a frame after which the alarm `no-frame` begins, but not before `no_frame_s`.
        // at least one period, because a frame may take that long
        no_frame_periods: f64 = 5.0, in Within(1.0, 1e6);
        /// Shortest time without a frame after which the alarm `no-frame` begins, s.
        no_frame_s: f64 = 10.0, in Above(0.0, LONGEST_S);
        /// A program and its arguments, run for each message; empty runs none.
        command: Vec<String>;
        /// Timeout after which the command is killed, s.
        deadline_s: f64 = 10.0, in Above(0.0, 600.0);
        /// Shortest time between two notifications of the same kind, s.
        again_s: f64 = 3600.0, in Above(0.0, LONGEST_S);
    }
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
