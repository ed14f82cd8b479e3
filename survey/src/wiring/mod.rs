//! Which relays join which pair of electrodes to the source and to the voltmeter.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::{Dipole, Electrode};

mod error;
mod maps;
mod transition;

pub use error::WiringError;
pub use maps::OwnWiring;
pub use transition::Transition;

/// The number of a switch as its instrument counts: slot x 1000 + channel on a mainframe (`1042`),
/// pole x 100 + electrode number on a multiplexer board (poles 1 = I+, 2 = I-, 3 = V+, 4 = V-).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Relay(pub u32);

impl fmt::Display for Relay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// How the voltmeter gets at the pairs.
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

/// The relays of a rig, per pair, with the rules that follow from them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wiring {
    /// What a person calls it: `34924A pairs`, `34932A matrix`, `gpio board`.
    pub name: String,
    /// Number of electrodes of the ring.
    pub electrodes: usize,
    /// How the voltmeter gets at the pairs.
    pub sensing: Sensing,
    /// How the current moves to the next pair.
    pub transition: Transition,
    /// Relays that join a pair to the source; all of a pair's relays carry its current.
    pub inject: Vec<(Dipole, Vec<Relay>)>,
    /// Relays that join a pair to the voltmeter.
    pub measure: Vec<(Dipole, Vec<Relay>)>,
    /// Relays closed once before the first reading (a matrix row to the voltmeter's bus) and opened at the end.
    pub bus: Vec<Relay>,
}

impl Wiring {
    /// Pairs on one 34924A (or 34922A) in a slot: measuring pair k on channel k of bank 1, scanned by the voltmeter;
    /// injecting pair k on channel 35 + k of bank 2. Two to 35 electrodes.
    ///
    /// # Errors
    /// A slot outside 1 to 8, or more pairs than a bank has.
    pub fn pairs_34924a(slot: u32, electrodes: usize) -> Result<Self, WiringError> {
        let name = format!("34924A pairs in slot {slot}");
        check_size(&name, slot, electrodes, 35)?;
        let pairs = |first: u32| {
            (0..electrodes)
                .map(|k| {
                    (
                        Dipole::adjacent(k, electrodes),
                        vec![Relay(slot * 1000 + first + k as u32)],
                    )
                })
                .collect()
        };
        Ok(Self {
            electrodes,
            sensing: Sensing::Scan,
            transition: Transition::Overlap,
            inject: pairs(36),
            measure: pairs(1),
            bus: Vec::new(),
            name,
        })
    }

    /// Pairs on one 34932A as a 4 x 32 matrix: row 1 (columns 1 to 16) and row 5 (17 to 32) to the voltmeter through
    /// relay 921, rows 2 and 6 to the source. One reading a message.
    ///
    /// # Errors
    /// A slot outside 1 to 8, or more than 32 electrodes.
    pub fn matrix_34932a(slot: u32, electrodes: usize) -> Result<Self, WiringError> {
        let name = format!("34932A matrix in slot {slot}");
        check_size(&name, slot, electrodes, 32)?;
        let pairs = |upper: u32, lower: u32| {
            (0..electrodes)
                .map(|k| {
                    let (row, column) = if k < 16 {
                        (upper, k + 1)
                    } else {
                        (lower, k - 15)
                    };
                    let relay = Relay(slot * 1000 + row * 100 + column as u32);
                    (Dipole::adjacent(k, electrodes), vec![relay])
                })
                .collect()
        };
        Ok(Self {
            electrodes,
            sensing: Sensing::Single,
            transition: Transition::Overlap,
            inject: pairs(2, 6),
            measure: pairs(1, 5),
            bus: vec![Relay(slot * 1000 + 921)],
            name,
        })
    }

    /// The multiplexer board: four poles (1 = I+, 2 = I-, 3 = V+, 4 = V-), any electrode on each. The current is taken
    /// to 0 A before a pole moves.
    ///
    /// # Errors
    /// More than 32 electrodes: two 16-way chips a pole.
    pub fn gpio_board(electrodes: usize) -> Result<Self, WiringError> {
        let name = "gpio board".to_owned();
        check_size(&name, 1, electrodes, 32)?;
        let pairs = |plus: u32, minus: u32| {
            (0..electrodes)
                .map(|k| {
                    let pair = Dipole::adjacent(k, electrodes);
                    let relay = |pole: u32, electrode: Electrode| {
                        Relay(pole * 100 + electrode.number() as u32)
                    };
                    (pair, vec![relay(plus, pair.plus), relay(minus, pair.minus)])
                })
                .collect()
        };
        Ok(Self {
            electrodes,
            sensing: Sensing::Single,
            transition: Transition::Break,
            inject: pairs(1, 2),
            measure: pairs(3, 4),
            bus: Vec::new(),
            name,
        })
    }

    /// The same with the readings of an injection chained in one message, where the switch is the mainframe whose
    /// voltmeter reads; a scan stays a scan.
    #[must_use]
    pub fn chained(mut self) -> Self {
        if self.sensing == Sensing::Single {
            self.sensing = Sensing::Chain;
        }
        self
    }

    /// The same with the pairs of a protocol, where each electrode has relays of its own: two a pair, the first to its
    /// plus, the second to its minus. A wiring of pairs stays as it is wired.
    #[must_use]
    pub fn joining(mut self, protocol: &crate::Protocol) -> Self {
        let asked = protocol.measurements();
        let drives = protocol.drives();
        let mut senses: Vec<Dipole> = Vec::new();
        for question in asked {
            if !senses.contains(&question.sense) {
                senses.push(question.sense);
            }
        }
        senses.sort_unstable();
        for (pairs, wanted) in [(&mut self.inject, drives), (&mut self.measure, senses)] {
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
                *pairs = joined;
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
            let mut seen: BTreeMap<&[Relay], Dipole> = BTreeMap::new();
            for (pair, relays) in pairs {
                if let Some(first) = seen.insert(relays, *pair) {
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

    /// Every relay that carries the source's current, each once, ascending: all must be open before it is first on.
    pub fn injecting_relays(&self) -> Vec<Relay> {
        distinct(self.inject.iter().flat_map(|(_, relays)| relays))
    }

    /// Every relay that leads to the voltmeter, in the order of the pairs, each once.
    pub fn measuring_relays(&self) -> Vec<Relay> {
        distinct(self.measure.iter().flat_map(|(_, relays)| relays))
    }
}

fn check_size(wiring: &str, slot: u32, electrodes: usize, most: usize) -> Result<(), WiringError> {
    if !(1..=8).contains(&slot) {
        return Err(WiringError::Slot {
            wiring: wiring.to_owned(),
            slot,
        });
    }
    if electrodes > most {
        return Err(WiringError::TooMany {
            wiring: wiring.to_owned(),
            electrodes,
            most,
        });
    }
    Ok(())
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
    use super::*;

    #[test]
    fn the_maps_of_the_fact_sheet() {
        let pairs = Wiring::pairs_34924a(1, 26).unwrap();
        assert_eq!(
            pairs.injecting(Dipole::adjacent(0, 26)),
            Some(&[Relay(1036)][..])
        );
        assert_eq!(
            pairs.injecting(Dipole::adjacent(25, 26)),
            Some(&[Relay(1061)][..])
        );
        assert_eq!(
            pairs.measuring(Dipole::adjacent(25, 26)),
            Some(&[Relay(1026)][..])
        );
        let matrix = Wiring::matrix_34932a(2, 26).unwrap();
        assert_eq!(
            matrix.injecting(Dipole::adjacent(15, 26)),
            Some(&[Relay(2216)][..])
        );
        assert_eq!(
            matrix.injecting(Dipole::adjacent(16, 26)),
            Some(&[Relay(2601)][..])
        );
        assert_eq!(
            matrix.measuring(Dipole::adjacent(16, 26)),
            Some(&[Relay(2501)][..])
        );
        let board = Wiring::gpio_board(26).unwrap();
        assert_eq!(
            board.injecting(Dipole::adjacent(25, 26)),
            Some(&[Relay(126), Relay(201)][..])
        );
        for wiring in [pairs, matrix, board] {
            wiring.check().unwrap();
        }
    }

    #[test]
    fn a_wiring_that_would_short_the_source_is_refused() {
        let mut wiring = Wiring::pairs_34924a(1, 26).unwrap();
        wiring.inject[1].1 = wiring.inject[0].1.clone();
        assert!(matches!(wiring.check(), Err(WiringError::Shorted { .. })));
        let mut wiring = Wiring::pairs_34924a(1, 26).unwrap();
        wiring.inject[1].1 = vec![Relay(1003)];
        let refusal = wiring.check().unwrap_err();
        assert!(refusal.to_string().contains("relay 1003"), "{refusal}");
    }
}
