//! Settings of the simulator.

use std::time::Duration;

/// Values that the manual leaves open or that differ from unit to unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings6221 {
    /// Serial number in `*IDN?`.
    pub serial: String,
    /// Firmware in `*IDN?`.
    pub firmware: String,
    /// Time a message takes (fact sheet, section 7: assumed).
    pub command_time: Duration,
    /// Time a change of range takes (fact sheet, section 7: assumed).
    pub range_time: Duration,
    /// Time from the opening of the interlock to output off (fact sheet, section 7: not known).
    pub interlock_time: Duration,
    /// Entries of the error queue (fact sheet, section 6: assumed).
    pub queue_depth: usize,
}

impl Default for Settings6221 {
    fn default() -> Self {
        Self {
            serial: "1234567".to_owned(),
            firmware: "D04".to_owned(),
            command_time: Duration::from_millis(5),
            range_time: Duration::from_millis(10),
            interlock_time: Duration::ZERO,
            queue_depth: 10,
        }
    }
}
