//! Lead resistance: the wires between the source and the relays.
//!
//! It acts only in the source's loop, where it counts towards compliance; because of the four-wire connection it does
//! not change readings (fact sheet, section 2.2). 10 m of 0.14 mm2 copper are 1.2 ohm.

use std::time::Duration;

use survey::{Ohms, Relay};

use super::bounds::parameters;
use super::{Effect, Effects, OnWires, RelayContact, SheetResponse};

parameters! {
    /// Resistance of the source's wires.
    LeadResistanceSettings {
        /// Resistance of each of the two wires, ohm.
        ohm = 1.2, in [0.0, 1e6], "ohm";
    }
}

impl Effect for LeadResistanceSettings {
    fn predict(&self, _response: &dyn SheetResponse) -> f64 {
        // no reading changes: below compliance the current does not depend on the resistance
        0.0
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.wires.push(Box::new(self.clone()));
    }
}

impl OnWires for LeadResistanceSettings {
    fn act(&mut self, _relay: Relay, _closures: u64, _at: Duration, _contact: &mut RelayContact) {}

    fn loop_resistance(&self) -> Ohms {
        Ohms(2.0 * self.ohm)
    }
}
