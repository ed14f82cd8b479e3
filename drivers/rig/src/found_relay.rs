//! Relays whose state differs from the expected one, with the electrodes that they connect.

use std::fmt;

use survey::{Dipole, Relay};

/// A relay whose state differs from the expected one, with its pairs of electrodes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoundRelay {
    /// The relay.
    pub relay: Relay,
    /// The pairs that the relay connects to the source.
    pub pairs: Vec<Dipole>,
}

impl fmt::Display for FoundRelay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut electrodes: Vec<usize> = Vec::new();
        for pair in &self.pairs {
            electrodes.extend([pair.plus.number(), pair.minus.number()]);
        }
        electrodes.sort_unstable();
        electrodes.dedup();
        let numbers: Vec<String> = electrodes.iter().map(usize::to_string).collect();
        let many = if numbers.len() == 1 { "" } else { "s" };
        write!(
            f,
            "{} (electrode{many} {})",
            self.relay,
            numbers.join(" and ")
        )
    }
}

/// Relays with their electrodes, for people: `1036 (electrodes 1 and 2)`.
pub fn name_relays(relays: &[FoundRelay]) -> String {
    let each: Vec<String> = relays.iter().map(FoundRelay::to_string).collect();
    each.join(", ")
}
