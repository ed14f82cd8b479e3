//! What the manual leaves open, and what is said back.

use std::time::Duration;

/// What the manual leaves open or the maker stamps on each unit.
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
    /// From the interlock's opening to the output going off (fact sheet, section 7: not known).
    pub interlock_time: Duration,
    /// Entries of the error queue (fact sheet, section 6: assumed).
    pub queue_depth: usize,
    /// Whether the network port serves one client at a time (fact sheet, section 1: assumed). The simulator knows no
    /// connections; whoever serves it keeps to this.
    pub one_client: bool,
    /// How long the network port stays taken after a client that vanished (fact sheet, section 1: not known). For
    /// whoever serves the simulator, as well.
    pub slot_held: Duration,
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
            one_client: true,
            slot_held: Duration::ZERO,
        }
    }
}

/// What the instrument does about a message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// The reply without its terminator; `None` when nothing was asked, or nothing that has an answer.
    pub text: Option<String>,
    /// How long the instrument needs.
    pub busy: Duration,
}
