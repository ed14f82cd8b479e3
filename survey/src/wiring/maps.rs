//! Further maps of fact sheet 34980A section 8, and wirings told relay by relay.

use super::{Relay, Sensing, Wiring, WiringError, check_size};
use crate::{Dipole, Electrode, Transition};

/// A wiring that somebody wrote down: relays of pair 1, pair 2, and so on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnWiring {
    /// What a person calls it.
    pub name: String,
    /// How the voltmeter gets at the pairs.
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
    /// Map M on a 34922A: the numbers of [`Wiring::pairs_34924a`] on armature relays, quieter and slower.
    ///
    /// # Errors
    /// As [`Wiring::pairs_34924a`].
    pub fn pairs_34922a(slot: u32, electrodes: usize) -> Result<Self, WiringError> {
        Ok(Self {
            name: format!("34922A pairs in slot {slot}"),
            ..Self::pairs_34924a(slot, electrodes)?
        })
    }

    /// Map F: measuring pair k on channel k of a 34925A, across both banks; injecting pair k on channel 35 + k, bank 2
    /// of a 34924A in another slot. Two to 35 electrodes.
    ///
    /// # Errors
    /// A slot outside 1 to 8, one slot for both modules, or more pairs than a bank has.
    pub fn fast_34925a(
        slot: u32,
        inject_slot: u32,
        electrodes: usize,
    ) -> Result<Self, WiringError> {
        let name = format!("34925A pairs in slot {slot}, injected by slot {inject_slot}");
        check_size(&name, slot, electrodes, 35)?;
        check_size(&name, inject_slot, electrodes, 35)?;
        if slot == inject_slot {
            return Err(WiringError::OneSlot { wiring: name, slot });
        }
        let measuring = Self::pairs_34924a(slot, electrodes)?;
        let injecting = Self::pairs_34924a(inject_slot, electrodes)?;
        Ok(Self {
            name,
            inject: injecting.inject,
            ..measuring
        })
    }

    /// Map Z: single electrodes on a 34934A as 4 x 128, rows I+ (101 up), I- (301), V+ (501), V- (701), the voltmeter
    /// at the rear connector. One reading a message. Up to 128 electrodes.
    ///
    /// # Errors
    /// A slot outside 1 to 8, or more than 128 electrodes.
    pub fn matrix_34934a(slot: u32, electrodes: usize) -> Result<Self, WiringError> {
        let name = format!("34934A matrix in slot {slot}");
        check_size(&name, slot, electrodes, 128)?;
        let pairs = |plus: u32, minus: u32| {
            (0..electrodes)
                .map(|k| {
                    let pair = Dipole::adjacent(k, electrodes);
                    let relay = |row: u32, electrode: Electrode| {
                        Relay(slot * 1000 + row * 100 + electrode.number() as u32)
                    };
                    (pair, vec![relay(plus, pair.plus), relay(minus, pair.minus)])
                })
                .collect()
        };
        Ok(Self {
            electrodes,
            sensing: Sensing::Single,
            transition: Transition::Overlap,
            inject: pairs(1, 3),
            measure: pairs(5, 7),
            bus: Vec::new(),
            name,
        })
    }

    /// A wiring written down by its owner; the ring has as many electrodes as there are pairs.
    ///
    /// # Errors
    /// Other numbers of injecting and measuring pairs, and whatever [`Wiring::check`] refuses.
    pub fn own(own: OwnWiring) -> Result<Self, WiringError> {
        let electrodes = own.inject.len();
        if own.measure.len() != electrodes {
            return Err(WiringError::Uneven {
                wiring: own.name,
                inject: electrodes,
                measure: own.measure.len(),
            });
        }
        let pairs = |relays: Vec<Vec<Relay>>| {
            let numbered = relays.into_iter().enumerate();
            numbered
                .map(|(k, relays)| (Dipole::adjacent(k, electrodes), relays))
                .collect()
        };
        let wiring = Self {
            name: own.name,
            electrodes,
            sensing: own.sensing,
            transition: own.transition,
            inject: pairs(own.inject),
            measure: pairs(own.measure),
            bus: own.bus,
        };
        wiring.check()?;
        Ok(wiring)
    }

    /// What a relay is for, in words: `joins electrodes 1 and 2 to the source`.
    pub fn purpose(&self, relay: Relay) -> String {
        let of = |pairs: &[(Dipole, Vec<Relay>)], to: &str| {
            let (pair, relays) = pairs.iter().find(|(_, relays)| relays.contains(&relay))?;
            // one relay of several is one pole: the first the plus electrode's, the second the minus electrode's
            Some(match relays.as_slice() {
                [plus, _] if *plus == relay => format!("joins electrode {} to {to}", pair.plus),
                [_, minus] if *minus == relay => format!("joins electrode {} to {to}", pair.minus),
                _ => format!("joins electrodes {} and {} to {to}", pair.plus, pair.minus),
            })
        };
        of(&self.inject, "the source")
            .or_else(|| of(&self.measure, "the voltmeter"))
            .unwrap_or_else(|| match self.bus.contains(&relay) {
                true => "joins the voltmeter to its bus".to_owned(),
                false => "is not part of this wiring".to_owned(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_z_and_f_of_the_fact_sheet() {
        let large = Wiring::matrix_34934a(1, 26).unwrap();
        let last = Dipole::adjacent(25, 26);
        assert_eq!(large.injecting(last), Some(&[Relay(1126), Relay(1301)][..]));
        assert_eq!(large.measuring(last), Some(&[Relay(1526), Relay(1701)][..]));
        let fast = Wiring::fast_34925a(1, 2, 26).unwrap();
        assert_eq!(fast.injecting(last), Some(&[Relay(2061)][..]));
        assert_eq!(fast.measuring(last), Some(&[Relay(1026)][..]));
        let quiet = Wiring::pairs_34922a(3, 26).unwrap();
        assert_eq!(quiet.injecting(last), Some(&[Relay(3061)][..]));
        for wiring in [large, fast, quiet] {
            wiring.check().unwrap();
        }
        let refusal = Wiring::fast_34925a(2, 2, 26).unwrap_err();
        assert!(refusal.to_string().contains("slot 2"), "{refusal}");
        assert!(Wiring::matrix_34934a(1, 129).is_err());
    }

    #[test]
    fn a_relay_says_what_it_is_for() {
        let pairs = Wiring::pairs_34924a(1, 26).unwrap();
        assert_eq!(
            pairs.purpose(Relay(1061)),
            "joins electrodes 26 and 1 to the source"
        );
        let large = Wiring::matrix_34934a(1, 26).unwrap();
        assert_eq!(
            large.purpose(Relay(1703)),
            "joins electrode 3 to the voltmeter"
        );
        assert_eq!(pairs.purpose(Relay(9)), "is not part of this wiring");
        let matrix = Wiring::matrix_34932a(1, 26).unwrap();
        assert_eq!(
            matrix.purpose(Relay(1921)),
            "joins the voltmeter to its bus"
        );
    }

    #[test]
    fn a_wiring_written_down_is_checked_as_the_others_are() {
        let own = |inject: Vec<Vec<Relay>>| OwnWiring {
            name: "mine".to_owned(),
            sensing: Sensing::Single,
            transition: Transition::Break,
            inject,
            measure: (1..=4).map(|k| vec![Relay(1100 + k)]).collect(),
            bus: vec![Relay(1921)],
        };
        let relays = |first: u32| (0..4).map(|k| vec![Relay(first + k)]).collect();
        let wiring = Wiring::own(own(relays(1201))).unwrap();
        assert_eq!(wiring.electrodes, 4);
        assert_eq!(
            wiring.injecting(Dipole::adjacent(3, 4)),
            Some(&[Relay(1204)][..])
        );
        let shared = Wiring::own(own(relays(1101))).unwrap_err();
        assert!(shared.to_string().contains("relay 1101"), "{shared}");
        let uneven = Wiring::own(own(vec![vec![Relay(1201)]])).unwrap_err();
        assert!(uneven.to_string().contains("1 injecting"), "{uneven}");
    }
}
