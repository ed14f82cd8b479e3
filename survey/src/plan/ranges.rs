//! A range for each reading, planned from its expected value.

use std::collections::BTreeMap;

use super::{Plan, Step};
use crate::{Dipole, Measurement, Relay, Volts};

/// The available ranges, and the margin for each reading.
#[derive(Debug, Clone, PartialEq)]
pub struct RangeRule {
    /// The voltmeter's ranges, ascending.
    pub available: Vec<Volts>,
    /// A range must hold the expected value times this margin: 1.5 allows for a press that raises a reading by half
    /// (the voltmeter also reads up to 20 % over its range).
    pub margin: f64,
}

impl RangeRule {
    /// The smallest range that holds an expected reading with its margin; the largest range if none does.
    pub fn choose(&self, expected: Volts) -> Option<Volts> {
        self.available
            .iter()
            .find(|range| range.0 >= self.margin * expected.0.abs())
            .or(self.available.last())
            .copied()
    }

    /// The next larger range; `None` from the largest.
    pub fn next(&self, range: Volts) -> Option<Volts> {
        self.available
            .iter()
            .find(|larger| larger.0 > range.0 * (1.0 + 1e-9))
            .copied()
    }
}

/// Planned noise of one reading, V: the voltmeter's resolution taken as its standard deviation, over all readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// Root of the mean square.
    pub rms: Volts,
    /// Median.
    pub median: Volts,
    /// The noise if no reading had a range of its own.
    pub fixed: Volts,
}

impl Step {
    /// The ranges of the step's readings, each with its reading's place in the frame (none outside the protocol) and
    /// with its pair, if the step has it.
    fn ranged(&mut self) -> Vec<(Option<usize>, Option<Dipole>, &mut Option<Volts>)> {
        match self {
            Self::Scan { channels } => channels
                .iter_mut()
                .map(|one| (one.reading, Some(one.sense), &mut one.range))
                .collect(),
            Self::Chain { routes } => routes
                .iter_mut()
                .map(|one| (Some(one.reading), Some(one.sense), &mut one.range))
                .collect(),
            Self::Read { reading, range } => vec![(Some(*reading), None, range)],
            _ => Vec::new(),
        }
    }
}

impl Plan {
    /// Gives every reading the range that it needs, including scanned readings outside the protocol. A range without an
    /// expected value is kept.
    #[must_use]
    pub fn with_ranges(
        mut self,
        rule: &RangeRule,
        expected: impl Fn(Measurement) -> Option<Volts>,
    ) -> Self {
        let measurements = self.protocol.measurements();
        let mut driven: Option<Dipole> = None;
        for step in &mut self.steps {
            if let Step::Break { drive, .. } | Step::Overlap { drive, .. } = step {
                driven = Some(*drive);
            }
            for (reading, sense, range) in step.ranged() {
                let measurement = match sense {
                    Some(sense) => driven.map(|drive| Measurement { drive, sense }),
                    None => reading.and_then(|reading| measurements.get(reading).copied()),
                };
                let chosen = measurement.and_then(|one| rule.choose(expected(one)?));
                *range = chosen.or(*range);
            }
        }
        self
    }

    /// The range of each reading in the frame's order; `None` for the session's range.
    pub fn ranges(&self) -> Vec<Option<Volts>> {
        let mut ranges = vec![None; self.protocol.len()];
        for (reading, range) in self.steps.iter().flat_map(Step::readings) {
            if let Some(place) = ranges.get_mut(reading) {
                *place = range;
            }
        }
        ranges
    }

    /// Whether readings have ranges of their own.
    pub fn has_ranges(&self) -> bool {
        self.ranges().iter().any(Option::is_some)
    }

    /// Gives these readings the next larger range. Returns those that could be widened, with their new range.
    pub fn widen(&mut self, rule: &RangeRule, overloaded: &[usize]) -> Vec<(usize, Volts)> {
        let wider: BTreeMap<usize, Volts> = self
            .ranges()
            .into_iter()
            .enumerate()
            .filter(|(reading, _)| overloaded.contains(reading))
            .filter_map(|(reading, range)| Some((reading, rule.next(range?)?)))
            .collect();
        for (reading, _, range) in self.steps.iter_mut().flat_map(Step::ranged) {
            if let Some(wide) = reading.and_then(|reading| wider.get(&reading)) {
                *range = Some(*wide);
            }
        }
        wider.into_iter().collect()
    }

    /// Number of range commands in a frame: a channel's range is set only if it changes.
    pub fn range_changes(&self) -> usize {
        let mut set: BTreeMap<Option<Relay>, Option<Volts>> = BTreeMap::new();
        let mut changes = 0;
        let mut look = |place: Option<Relay>, range: Option<Volts>| {
            if range.is_some() && set.insert(place, range) != Some(range) {
                changes += 1;
            }
        };
        for step in &self.steps {
            match step {
                Step::Scan { channels } => {
                    for channel in channels {
                        look(Some(channel.relay), channel.range);
                    }
                }
                Step::Chain { routes } => routes.iter().for_each(|route| look(None, route.range)),
                Step::Read { range, .. } => look(None, *range),
                _ => {}
            }
        }
        changes
    }

    /// Noise of a reading with the planned ranges. `fraction`: resolution of the voltmeter as a fraction of its range;
    /// `otherwise`: the range of readings without their own; `averages`: readings averaged to one.
    pub fn resolution(&self, fraction: f64, otherwise: Volts, averages: u32) -> Resolution {
        let both_ways = if self.reversal { 2.0 } else { 1.0 };
        let root = (f64::from(averages.max(1)) * both_ways).sqrt();
        let scale = fraction / root;
        let mut noise: Vec<f64> = self
            .ranges()
            .into_iter()
            .map(|range| scale * range.unwrap_or(otherwise).0)
            .collect();
        noise.sort_by(f64::total_cmp);
        let mean_square = noise.iter().map(|one| one * one).sum::<f64>() / noise.len() as f64;
        Resolution {
            rms: Volts(mean_square.sqrt()),
            median: Volts(noise[noise.len() / 2]),
            fixed: Volts(fraction * otherwise.0 / root),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::wiring::examples;
    use crate::{Amps, Protocol, Wiring};

    fn rule() -> RangeRule {
        RangeRule {
            available: [0.1, 1.0, 10.0].map(Volts).to_vec(),
            margin: 1.5,
        }
    }

    /// Expected voltages: 6.5 V across the driven pair, 0.5 V across pairs next to it, 2 mV elsewhere.
    fn expected(measurement: Measurement) -> Option<Volts> {
        Some(Volts(match measurement.drive.touches(measurement.sense) {
            true if measurement.drive == measurement.sense => -6.5,
            true => 0.5,
            false => 2e-3,
        }))
    }

    fn plan(wiring: &Wiring) -> Plan {
        let protocol = Protocol::sheffield(wiring.electrodes).unwrap();
        let plan = Plan::new(&protocol, wiring, Amps(1e-3), Volts(10.0), Duration::ZERO).unwrap();
        plan.with_ranges(&rule(), expected)
    }

    #[test]
    fn driven_and_neighbouring_pairs_have_ranges_of_their_own() {
        let plan = plan(&examples::pairs(26));
        assert!(plan.ranges().iter().all(|range| *range == Some(Volts(0.1))));
        let Some(Step::Scan { channels }) = plan.steps.iter().find(|step| step.reads()) else {
            panic!("a scan");
        };
        let range = |at: usize| channels[at].range.unwrap().0;
        assert_eq!(
            [range(0), range(1), range(2), range(25)],
            [10.0, 1.0, 0.1, 1.0]
        );
        // 26 at first, then the four pairs at the moving edge of each of 25 injections
        assert_eq!(plan.range_changes(), 26 + 25 * 4);
        assert_eq!(plan.counts().range_changes, 126);
        let noise = plan.resolution(3e-6, Volts(1.0), 1);
        assert!((noise.rms.0 - 3e-7).abs() < 1e-18, "{noise:?}");
    }

    #[test]
    fn an_overload_gets_the_next_larger_range_and_the_largest_stays() {
        let mut plan = plan(&examples::matrix(8).chained());
        assert_eq!(plan.widen(&rule(), &[3]), [(3, Volts(1.0))]);
        assert_eq!(plan.widen(&rule(), &[3]), [(3, Volts(10.0))]);
        assert_eq!(plan.widen(&rule(), &[3]), []);
        assert_eq!(plan.ranges()[3], Some(Volts(10.0)));
        assert_eq!(plan.ranges()[2], Some(Volts(0.1)));
    }

    #[test]
    fn half_frame_scans_only_its_readings() {
        let protocol = Protocol::new(26, crate::half(crate::sheffield(26)).collect()).unwrap();
        let wiring = examples::pairs(26);
        let plan = Plan::new(&protocol, &wiring, Amps(1e-3), Volts(10.0), Duration::ZERO).unwrap();
        let counts = plan.counts();
        assert_eq!(counts.readings, 299);
        // the first two injections need all their readings and are scanned whole, with 3 extra readings each; the
        // others are not
        assert_eq!(counts.extra_readings, 2 * 3, "{counts:?}");
    }

    #[test]
    fn single_electrodes_serve_any_pattern_and_wired_pairs_do_not() {
        let protocol = Protocol::new(26, crate::skip(26, 3).collect()).unwrap();
        let made = |wiring: Wiring| {
            let wiring = wiring.joining(&protocol);
            Plan::new(&protocol, &wiring, Amps(1e-3), Volts(4.0), Duration::ZERO)
        };
        let board = made(examples::board(26)).unwrap();
        assert_eq!(board.counts().readings, protocol.len());
        let refusal = made(examples::pairs(26)).unwrap_err();
        assert!(
            refusal.to_string().contains("cannot join pair 1-5"),
            "{refusal}"
        );
    }
}
