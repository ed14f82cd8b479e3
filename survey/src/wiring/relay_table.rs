//! Wirings given as a table of relays, and the purpose of each relay.

use super::{Relay, Sensing, Wiring, WiringError};
use crate::{Dipole, Transition};

/// A wiring as a table: the relays of pair 1, pair 2, and so on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RelayTable {
    /// Display name.
    pub name: String,
    /// How the voltmeter is joined to the pairs.
    pub sensing: Sensing,
    /// How the current moves to the next pair.
    pub transition: Transition,
    /// Relays that join pair k to the source, from pair 1.
    pub inject: Vec<Vec<Relay>>,
    /// Relays that join pair k to the voltmeter, from pair 1.
    pub measure: Vec<Vec<Relay>>,
    /// Relays closed for the whole frame.
    pub bus: Vec<Relay>,
}

impl Wiring {
    /// A wiring from a table; the ring has as many electrodes as there are pairs.
    ///
    /// # Errors
    /// The numbers of injecting and measuring pairs differ, or [`Wiring::check`] refuses the wiring.
    pub fn from_table(table: RelayTable) -> Result<Self, WiringError> {
        let electrodes = table.inject.len();
        if table.measure.len() != electrodes {
            return Err(WiringError::Uneven {
                wiring: table.name,
                inject: electrodes,
                measure: table.measure.len(),
            });
        }
        let pairs = |relays: Vec<Vec<Relay>>| {
            let numbered = relays.into_iter().enumerate();
            numbered
                .map(|(k, relays)| (Dipole::adjacent(k, electrodes), relays))
                .collect()
        };
        let wiring = Self {
            name: table.name,
            electrodes,
            sensing: table.sensing,
            transition: table.transition,
            inject: pairs(table.inject),
            measure: pairs(table.measure),
            bus: table.bus,
            unused_inject: Vec::new(),
            unused_measure: Vec::new(),
        };
        wiring.check()?;
        Ok(wiring)
    }

    /// What a relay is for, in words: `joins electrodes 1 and 2 to the source`.
    pub fn purpose(&self, relay: Relay) -> String {
        let of = |pairs: &[(Dipole, Vec<Relay>)], to: &str| {
            let (pair, relays) = pairs.iter().find(|(_, relays)| relays.contains(&relay))?;
            // a relay that is one of several is one pole: the first for the plus electrode, the second for the minus
            // electrode
            Some(match relays.as_slice() {
                [plus, _] if *plus == relay => format!("joins electrode {} to {to}", pair.plus),
                [_, minus] if *minus == relay => format!("joins electrode {} to {to}", pair.minus),
                _ => format!("joins electrodes {} and {} to {to}", pair.plus, pair.minus),
            })
        };
        of(&self.inject, "the source")
            .or_else(|| of(&self.measure, "the voltmeter"))
            .or_else(|| of(&self.unused_inject, "the source"))
            .or_else(|| of(&self.unused_measure, "the voltmeter"))
            .unwrap_or_else(|| match self.bus.contains(&relay) {
                true => "joins the voltmeter to its bus".to_owned(),
                false => "is not part of this wiring".to_owned(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wiring::examples;

    #[test]
    fn a_relay_has_its_purpose() {
        let pairs = examples::pairs(26);
        assert_eq!(
            pairs.purpose(Relay(1061)),
            "joins electrodes 26 and 1 to the source"
        );
        let large = examples::board(26);
        assert_eq!(
            large.purpose(Relay(403)),
            "joins electrode 3 to the voltmeter"
        );
        assert_eq!(pairs.purpose(Relay(9)), "is not part of this wiring");
        let matrix = examples::matrix(26);
        assert_eq!(
            matrix.purpose(Relay(1921)),
            "joins the voltmeter to its bus"
        );
    }

    #[test]
    fn a_wiring_written_down_is_checked_as_the_others_are() {
        let own = |inject: Vec<Vec<Relay>>| RelayTable {
            name: "mine".to_owned(),
            sensing: Sensing::Single,
            transition: Transition::Break,
            inject,
            measure: (1..=4).map(|k| vec![Relay(1100 + k)]).collect(),
            bus: vec![Relay(1921)],
        };
        let relays = |first: u32| (0..4).map(|k| vec![Relay(first + k)]).collect();
        let wiring = Wiring::from_table(own(relays(1201))).unwrap();
        assert_eq!(wiring.electrodes, 4);
        assert_eq!(
            wiring.injecting(Dipole::adjacent(3, 4)),
            Some(&[Relay(1204)][..])
        );
        let shared = Wiring::from_table(own(relays(1101))).unwrap_err();
        assert!(shared.to_string().contains("relay 1101"), "{shared}");
        let uneven = Wiring::from_table(own(vec![vec![Relay(1201)]])).unwrap_err();
        assert!(uneven.to_string().contains("1 injecting"), "{uneven}");
    }
}
