//! Readings that reveal faults: relays that should be open, and which of two relays does not close.

use rig::{CurrentSource, Switch, Voltmeter};
use survey::{Amps, Relay};

use super::{Measured, Probe, ProbeError, Retry, Row, volts};
use crate::median::median;

impl<C: CurrentSource, W: Switch, V: Voltmeter> Probe<'_, '_, C, W, V> {
    /// Retries pairs that carry no current although their neighbours do, to find which of their two relays does not
    /// close.
    pub(super) async fn retry(&mut self, raw: &Measured) -> Result<Vec<Retry>, ProbeError> {
        let inject = &self.request.plan.wiring.inject;
        let n = inject.len();
        let mut retries = Vec::new();
        for (pair, (_, relays)) in inject.iter().enumerate() {
            let fails = |pair: usize| raw.rows[pair % n].compliance;
            let [plus, minus] = relays.as_slice() else {
                continue;
            };
            let other = (pair + 2) % n;
            if !fails(pair) || fails(pair + 1) || fails(pair + n - 1) || fails(other) {
                continue;
            }
            let [other_plus, other_minus] = inject[other].1.as_slice() else {
                continue;
            };
            for (relay, with) in [(*plus, *other_minus), (*minus, *other_plus)] {
                let row = self.inject(&[relay, with], Some(&vec![false; n])).await?;
                retries.push(Retry {
                    pair,
                    relay,
                    flows: !row.compliance,
                });
            }
        }
        Ok(retries)
    }

    /// Retries measuring pairs that read nothing at any injection, to find which of their two relays does not close.
    pub(super) async fn retry_meter(&mut self, raw: &Measured) -> Result<Vec<Retry>, ProbeError> {
        let wiring = &self.request.plan.wiring;
        let n = wiring.measure.len();
        let most = |pair: usize| {
            let read = raw.rows.iter().filter_map(|row| row.volts[pair]);
            read.fold(0.0_f64, |most, volts| most.max(volts.abs()))
        };
        let silent = 1e-3 * median((0..n).map(most)).unwrap_or(0.0);
        let mut retries = Vec::new();
        for (pair, (_, relays)) in wiring.measure.iter().enumerate() {
            let other = (pair + 2) % n;
            let drive = (pair + n / 2) % n;
            if most(pair) >= silent || most(other) < silent || raw.rows[drive].compliance {
                continue;
            }
            let ([plus, minus], [other_plus, other_minus]) =
                (relays.as_slice(), wiring.measure[other].1.as_slice())
            else {
                continue;
            };
            for (relay, with) in [(*plus, *other_minus), (*minus, *other_plus)] {
                let closed = [relay, with];
                self.close(&closed).await?;
                let driven = &wiring.inject[drive].1;
                let follows = self.reading_of_current(driven).await?;
                self.open(&closed).await?;
                retries.push(Retry {
                    pair,
                    relay,
                    flows: follows.is_some_and(|volts| volts.abs() > silent),
                });
            }
        }
        Ok(retries)
    }

    /// The voltmeter's reading minus that at 0 A, because a disconnected voltmeter may return any value.
    async fn reading_of_current(&mut self, driven: &[Relay]) -> Result<Option<f64>, ProbeError> {
        self.close(driven).await?;
        let still = volts(self.interruptible_read().await?);
        self.drive(self.request.plan.current).await?;
        tokio::time::sleep(self.request.settle).await;
        let read = volts(self.interruptible_read().await?);
        self.drive(Amps(0.0)).await?;
        self.open(driven).await?;
        Ok(read.zip(still).map(|(read, still)| read - still))
    }

    /// The voltmeter's reading of each injection with only these measuring relays closed.
    pub(super) async fn read_partly_closed(&mut self, closed: &[Relay]) -> Result<Row, ProbeError> {
        self.close(closed).await?;
        let mut row = Row::default();
        for (_, relays) in &self.request.plan.wiring.inject {
            row.volts.push(self.reading_of_current(relays).await?);
        }
        self.open(closed).await?;
        Ok(row)
    }
}

/// The relays to close for finding relays that should be open. If every pair has two relays: each side alone, on two
/// electrodes far apart. Otherwise, also if a wiring file mixes pairs of one and of two relays: none.
pub(super) fn partly_closed(pairs: &[(survey::Dipole, Vec<Relay>)]) -> Vec<Vec<Relay>> {
    let two: Option<Vec<[Relay; 2]>> = pairs
        .iter()
        .map(|(_, relays)| relays.as_slice().try_into().ok())
        .collect();
    match two.as_deref() {
        Some(pairs @ [first, ..]) => {
            let far = [first, &pairs[pairs.len() / 2]];
            let sides = [1, 0].into_iter();
            sides
                .flat_map(|side| far.map(|pair| vec![pair[side]]))
                .collect()
        }
        _ => vec![Vec::new()],
    }
}

#[cfg(test)]
mod tests {
    use survey::Dipole;

    use super::*;

    #[test]
    fn pairs_of_one_relay_and_of_two_are_tested_without_a_panic() {
        let pairs = |counts: [u32; 4]| -> Vec<(Dipole, Vec<Relay>)> {
            let each = counts.into_iter().zip([0_u32, 1, 2, 3]);
            each.map(|(count, k)| {
                let relays = (0..count).map(|side| Relay(100 * (side + 1) + k));
                (Dipole::adjacent(k as usize, 4), relays.collect())
            })
            .collect()
        };
        let each = [200, 202, 100, 102].map(|relay| vec![Relay(relay)]);
        assert_eq!(partly_closed(&pairs([2; 4])), each);
        for uneven in [[2, 2, 1, 2], [1; 4], [2, 1, 2, 2]] {
            assert_eq!(partly_closed(&pairs(uneven)), [Vec::<Relay>::new()]);
        }
        assert_eq!(partly_closed(&[]), [Vec::<Relay>::new()]);
    }
}
