//! Relays that stay closed.

use survey::Relay;

use crate::assessment::{Assessment, MIN_CORRELATION};
use crate::probe::PartlyClosed;

impl Assessment<'_> {
    /// Finds relays that stay closed: they cause a reading or a current where there should be none. Returns whether
    /// there are any.
    pub(super) fn stay_closed(&self, findings: &mut Vec<String>) -> bool {
        let before = findings.len();
        let mut say = |relay: Option<Relay>, kind: &str| {
            let text = match relay {
                Some(relay) => format!(
                    "relay {relay} stays closed: it {}",
                    self.wiring.purpose(relay)
                ),
                None => {
                    format!("a relay that {kind} stays closed; the readings do not show which one")
                }
            };
            if !findings.contains(&text) {
                findings.push(text);
            }
        };
        for partly_closed in self
            .raw
            .lone_sources
            .iter()
            .filter(|partly_closed| !partly_closed.row.compliance)
        {
            say(
                self.which(
                    partly_closed,
                    &self.wiring.inject,
                    |lone_pair, other, pair| {
                        Some(match lone_pair {
                            None => self.sheet.pair(other, pair),
                            Some(ends) => self.sheet.volts(ends(other), (pair, pair + 1)),
                        })
                    },
                ),
                "joins an electrode to the source",
            );
        }
        // the largest reading of a pair from its own injection
        let typical = self.sheet.pair(0, 0).abs() * self.current;
        for partly_closed in &self.raw.lone_meters {
            let seen = partly_closed
                .row
                .volts
                .iter()
                .flatten()
                .fold(0.0_f64, |most, volts| most.max(volts.abs()));
            if seen > 1e-2 * typical {
                say(
                    self.which(
                        partly_closed,
                        &self.wiring.measure,
                        |lone_pair, other, pair| {
                            Some(match lone_pair {
                                None => self.sheet.pair(pair, other),
                                Some(ends) => self.sheet.volts((pair, pair + 1), ends(other)),
                            })
                        },
                    ),
                    "joins an electrode to the voltmeter",
                );
            }
        }
        findings.len() > before
    }

    /// The relay whose pattern is most similar to the readings taken while it should have been open. `model` returns
    /// the expected voltage for a candidate (a pair, or the electrode on the other side of the lone relay) and a
    /// position in the row.
    pub(super) fn which(
        &self,
        partly_closed: &PartlyClosed,
        pairs: &[(survey::Dipole, Vec<Relay>)],
        model: impl Fn(Option<&dyn Fn(usize) -> (usize, usize)>, usize, usize) -> Option<f64>,
    ) -> Option<Relay> {
        let read = &partly_closed.row.volts;
        // if one relay of a pair is closed: its electrode, and its position in the pair (0 is the plus side)
        let side = partly_closed.closed.first().and_then(|closed| {
            pairs.iter().find_map(|(pair, relays)| {
                let place = relays.iter().position(|relay| relay == closed)?;
                Some((
                    if place == 0 {
                        pair.plus.0
                    } else {
                        pair.minus.0
                    },
                    place,
                ))
            })
        });
        let other_side = |electrode: usize, place: usize| {
            pairs.iter().find_map(|(pair, relays)| {
                let (end, relay) = match place {
                    0 => (pair.minus.0, *relays.get(1)?),
                    _ => (pair.plus.0, *relays.first()?),
                };
                (end == electrode).then_some(relay)
            })
        };
        let typical = self.sheet.pair(0, 0).abs() * self.current;
        if let Some((electrode, place)) = side
            && read
                .iter()
                .flatten()
                .all(|volts| volts.abs() < 1e-3 * typical)
        {
            // no voltage at all: source or voltmeter is shorted through the electrode of the lone relay
            return other_side(electrode, place);
        }
        let mut best: Option<(f64, Relay)> = None;
        for (candidate, pair) in pairs.iter().enumerate().take(self.n) {
            let relay = match side {
                None => *pair.1.first()?,
                Some((electrode, place)) => {
                    if electrode == candidate {
                        continue;
                    }
                    other_side(candidate, place)?
                }
            };
            let ends = side.map(|(electrode, place)| {
                move |other: usize| match place {
                    0 => (electrode, other),
                    _ => (other, electrode),
                }
            });
            let (mut shared, mut a, mut b) = (0.0, 0.0, 0.0);
            for (place, volts) in read.iter().enumerate() {
                let Some(volts) = volts else { continue };
                let partly_closed = ends
                    .as_ref()
                    .map(|ends| ends as &dyn Fn(usize) -> (usize, usize));
                let expected = model(partly_closed, candidate, place)?;
                shared += volts * expected;
                a += volts * volts;
                b += expected * expected;
            }
            let alike = shared / (a * b).sqrt();
            if alike.is_finite() && best.is_none_or(|(most, _)| alike > most) {
                best = Some((alike, relay));
            }
        }
        best.filter(|(alike, _)| *alike > MIN_CORRELATION)
            .map(|(_, relay)| relay)
    }
}
