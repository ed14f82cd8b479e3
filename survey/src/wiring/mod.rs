//! Which relays join which pair of electrodes to the source and to the voltmeter.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Dipole, Electrode};

mod error;
#[cfg(test)]
pub(crate) mod examples;
mod relay_table;
mod transition;

pub use error::WiringError;
pub use relay_table::RelayTable;
pub use transition::Transition;

/// Number of a relay in its instrument's numbering, such as slot x 1000 + channel in a mainframe (`1042`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Relay(pub u32);

impl fmt::Display for Relay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// How the voltmeter is joined to the pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sensing {
    /// The voltmeter's own scan closes the measuring relays: one message, all pairs of an injection.
    Scan,
    /// The switch routes each pair, then the voltmeter reads once: one message a reading.
    Single,
    /// The mainframe routes and reads one pair after the other: one message, all pairs of an injection.
    Chain,
}

/// The relays of a rig for each pair, with the rules that follow from them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wiring {
    /// Display name, such as `gpio board`.
    pub name: String,
    /// Number of electrodes of the ring.
    pub electrodes: usize,
    /// How the voltmeter is joined to the pairs.
    pub sensing: Sensing,
    /// How the current moves to the next pair.
    pub transition: Transition,
    /// Relays that join a pair to the source; all of a pair's relays carry its current.
    pub inject: Vec<(Dipole, Vec<Relay>)>,
    /// Relays that join a pair to the voltmeter.
    pub measure: Vec<(Dipole, Vec<Relay>)>,
    /// Relays closed once before the first reading (a matrix row to the voltmeter's bus) and opened at the end.
    pub bus: Vec<Relay>,
    /// Pairs of the switch with a relay to the source that no pair of the protocol uses: a half frame never drives some
    /// electrodes. No step closes such a relay, but it is checked and opened with the others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unused_inject: Vec<(Dipole, Vec<Relay>)>,
    /// The same for relays to the voltmeter.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unused_measure: Vec<(Dipole, Vec<Relay>)>,
}

impl Wiring {
    /// The same wiring with the readings of an injection chained in one message, if switch and voltmeter are the same
    /// mainframe; a scan stays a scan.
    #[must_use]
    pub fn chained(mut self) -> Self {
        if self.sensing == Sensing::Single {
            self.sensing = Sensing::Chain;
        }
        self
    }

    /// The same wiring with the pairs of a protocol, if each electrode has its own relays: two for each pair, the first
    /// to its plus, the second to its minus electrode. Relays that are then in no pair are kept as unused. A wiring of
    /// fixed pairs is unchanged.
    #[must_use]
    pub fn joining(mut self, protocol: &crate::Protocol) -> Self {
        let measurements = protocol.measurements();
        let drives = protocol.drives();
        let mut senses: Vec<Dipole> = Vec::new();
        for measurement in measurements {
            if !senses.contains(&measurement.sense) {
                senses.push(measurement.sense);
            }
        }
        senses.sort_unstable();
        for (pairs, unused, wanted) in [
            (&mut self.inject, &mut self.unused_inject, drives),
            (&mut self.measure, &mut self.unused_measure, senses),
        ] {
            if !pairs.iter().all(|(_, relays)| relays.len() == 2) {
                continue;
            }
            let plus: BTreeMap<Electrode, Relay> = pairs
                .iter()
                .map(|(pair, relays)| (pair.plus, relays[0]))
                .collect();
            let minus: BTreeMap<Electrode, Relay> = pairs
                .iter()
                .map(|(pair, relays)| (pair.minus, relays[1]))
                .collect();
            let joined: Option<Vec<(Dipole, Vec<Relay>)>> = wanted
                .into_iter()
                .map(|pair| Some((pair, vec![*plus.get(&pair.plus)?, *minus.get(&pair.minus)?])))
                .collect();
            if let Some(joined) = joined {
                unused.extend(std::mem::replace(pairs, joined));
                let used = distinct(pairs.iter().flat_map(|(_, relays)| relays));
                unused.retain(|(_, relays)| relays.iter().any(|relay| !used.contains(relay)));
            }
        }
        self
    }

    /// Refuses a wiring whose relays would short the source or tie it to the voltmeter.
    ///
    /// # Errors
    /// The first fault found, naming relay and pairs.
    pub fn check(&self) -> Result<(), WiringError> {
        let wiring = || self.name.clone();
        for (pair, relays) in self.inject.iter().chain(&self.measure) {
            if pair.plus == pair.minus {
                return Err(WiringError::SameElectrode {
                    wiring: wiring(),
                    pair: *pair,
                });
            }
            if relays.is_empty() {
                return Err(WiringError::NoRelay {
                    wiring: wiring(),
                    pair: *pair,
                });
            }
            let mut earlier = BTreeSet::new();
            if let Some(relay) = relays.iter().find(|relay| !earlier.insert(**relay)) {
                return Err(WiringError::Repeated {
                    wiring: wiring(),
                    pair: *pair,
                    relay: *relay,
                });
            }
        }
        let injecting: BTreeMap<Relay, Dipole> = self
            .inject
            .iter()
            .flat_map(|(pair, relays)| relays.iter().map(move |relay| (*relay, *pair)))
            .collect();
        for (measure, relays) in &self.measure {
            for relay in relays.iter().chain(&self.bus) {
                if let Some(inject) = injecting.get(relay) {
                    return Err(WiringError::Shared {
                        wiring: wiring(),
                        relay: *relay,
                        inject: *inject,
                        measure: *measure,
                    });
                }
            }
        }
        for pairs in [&self.inject, &self.measure] {
            // the order does not matter: relays a,b and relays b,a close the same contacts
            let mut seen: BTreeMap<BTreeSet<Relay>, Dipole> = BTreeMap::new();
            for (pair, relays) in pairs {
                if let Some(first) = seen.insert(relays.iter().copied().collect(), *pair) {
                    return Err(WiringError::Shorted {
                        wiring: wiring(),
                        first,
                        second: *pair,
                        relays: relays
                            .iter()
                            .map(Relay::to_string)
                            .collect::<Vec<_>>()
                            .join(","),
                    });
                }
            }
        }
        Ok(())
    }

    /// The relays that join a pair to the source.
    pub fn injecting(&self, pair: Dipole) -> Option<&[Relay]> {
        find(&self.inject, pair)
    }

    /// The relays that join a pair to the voltmeter.
    pub fn measuring(&self, pair: Dipole) -> Option<&[Relay]> {
        find(&self.measure, pair)
    }

    /// Every relay that can carry the source's current, in the order of the pairs, each once, those of unused pairs
    /// last. All must be open before the source is switched on for the first time.
    pub fn injecting_relays(&self) -> Vec<Relay> {
        let pairs = self.inject.iter().chain(&self.unused_inject);
        distinct(pairs.flat_map(|(_, relays)| relays))
    }

    /// Every relay that leads to the voltmeter in a frame, in the order of the pairs, each once.
    pub fn measuring_relays(&self) -> Vec<Relay> {
        distinct(self.measure.iter().flat_map(|(_, relays)| relays))
    }

    /// Every relay, those that can carry the source's current first, unused ones included.
    pub fn relays(&self) -> Vec<Relay> {
        let mut relays = self.injecting_relays();
        let measure = self.measure.iter().chain(&self.unused_measure);
        relays.extend(distinct(measure.flat_map(|(_, relays)| relays)));
        relays.extend(&self.bus);
        relays
    }

    /// The channels of the voltmeter's own scan, in the order of the pairs; none if it does not scan.
    pub fn scanned_channels(&self) -> Vec<Relay> {
        match self.sensing {
            Sensing::Scan => self.measuring_relays(),
            Sensing::Single | Sensing::Chain => Vec::new(),
        }
    }
}

fn find(pairs: &[(Dipole, Vec<Relay>)], pair: Dipole) -> Option<&[Relay]> {
    pairs
        .iter()
        .find(|(wired, _)| *wired == pair)
        .map(|(_, relays)| relays.as_slice())
}

fn distinct<'a>(relays: impl Iterator<Item = &'a Relay>) -> Vec<Relay> {
    let mut distinct = Vec::new();
    for relay in relays {
        if !distinct.contains(relay) {
            distinct.push(*relay);
        }
    }
    distinct
}

#[cfg(test)]
mod tests {
    use super::examples::{board, pairs};
    use super::*;

    #[test]
    fn a_wiring_that_would_short_the_source_is_refused() {
        let mut wiring = pairs(26);
        wiring.inject[1].1 = wiring.inject[0].1.clone();
        assert!(matches!(wiring.check(), Err(WiringError::Shorted { .. })));
        let mut wiring = pairs(26);
        wiring.inject[1].1 = vec![Relay(1003)];
        let refusal = wiring.check().unwrap_err();
        assert!(refusal.to_string().contains("relay 1003"), "{refusal}");
    }

    #[test]
    fn pairs_with_the_same_relays_in_another_order_are_refused() {
        let mut wiring = board(8);
        let (first, relays) = wiring.measure[2].clone();
        let second = wiring.measure[5].0;
        wiring.measure[5].1 = relays.iter().rev().copied().collect();
        let refusal = wiring.check().unwrap_err().to_string();
        let named = format!("pairs {first} and {second} are both given relays 404,303");
        assert!(refusal.contains(&named), "{refusal}");
    }

    #[test]
    fn relay_given_twice_to_one_pair_is_refused() {
        for side in ["source", "voltmeter"] {
            let mut wiring = board(8);
            let pairs = match side {
                "source" => &mut wiring.inject,
                _ => &mut wiring.measure,
            };
            pairs[2].1[1] = pairs[2].1[0];
            let (pair, relay) = (pairs[2].0, pairs[2].1[0]);
            let refusal = wiring.check().unwrap_err().to_string();
            let named = format!("pair {pair} is given relay {relay} twice");
            assert!(refusal.contains(&named), "{side}: {refusal}");
        }
    }

    #[test]
    fn relays_that_a_half_frame_leaves_out_are_kept() {
        let sorted = |mut relays: Vec<Relay>| {
            relays.sort_unstable();
            relays
        };
        let whole = board(8);
        let half = crate::half(crate::sheffield(8)).collect();
        let half = whole
            .clone()
            .joining(&crate::Protocol::new(8, half).unwrap());
        assert!(half.inject.len() < 8 && half.measure.len() < 8);
        assert_eq!(sorted(half.relays()), sorted(whole.relays()));
        assert_eq!(
            sorted(half.injecting_relays()),
            sorted(whole.injecting_relays())
        );
        assert_eq!(half.purpose(Relay(108)), "joins electrode 8 to the source");
        assert!(half.measuring_relays().len() < whole.measuring_relays().len());
        let again = half.joining(&crate::Protocol::sheffield(8).unwrap());
        assert_eq!(sorted(again.relays()), sorted(whole.relays()));
    }
}
