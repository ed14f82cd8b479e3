//! How the daemon is observed: what is trouble, and who is told.

use serde::{Deserialize, Serialize};

/// From when on something is trouble; `tactus status` goes by it, too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct NotifySection {
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
}

impl Default for NotifySection {
    fn default() -> Self {
        Self {
            disk_days: 14.0,
            relay_life: 0.9,
            baseline_days: 30.0,
            no_frame_periods: 5.0,
            no_frame_s: 10.0,
        }
    }
}
