//! A range for every reading, planned from what it is expected to be.

use std::collections::BTreeMap;

use super::{Plan, Step};
use crate::{Dipole, Measurement, Relay, Volts};

/// Which ranges there are, and how much room a reading is given in its own.
#[derive(Debug, Clone, PartialEq)]
pub struct RangeRule {
    /// The voltmeter's ranges, ascending.
    pub available: Vec<Volts>,
    /// A range must hold so many times what is expected: 1.5 leaves room for a press that raises a reading by half
    /// (and the voltmeter's own fifth beyond its range).
    pub margin: f64,
}

impl RangeRule {
    /// The smallest range that holds an expected reading with its margin; the largest there is where none does.
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

/// Noise of one reading as planned, V: resolution of the voltmeter taken as its standard deviation, over readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Resolution {
    /// Root of the mean square.
    pub rms: Volts,
    /// Half of the readings have less.
    pub median: Volts,
}

impl Plan {
    /// Gives every reading the range that it needs, scanned ones that the protocol does not ask included. Where
    /// nothing is expected the session's one range stays.
    #[must_use]
    pub fn with_ranges(
        mut self,
        rule: &RangeRule,
        expected: impl Fn(Measurement) -> Option<Volts>,
    ) -> Self {
        let choose = |drive, sense| rule.choose(expected(Measurement { drive, sense })?);
        let measurements = self.protocol.measurements();
        let mut driven: Option<Dipole> = None;
        for step in &mut self.steps {
            match step {
                Step::Break { drive, .. } | Step::Overlap { drive, .. } => driven = Some(*drive),
                Step::Scan { channels } => {
                    for channel in channels {
                        channel.range = driven.and_then(|drive| choose(drive, channel.sense));
                    }
                }
                Step::Chain { routes } => {
                    for route in routes {
                        route.range = driven.and_then(|drive| choose(drive, route.sense));
                    }
                }
                Step::Read { reading, range } => {
                    *range = measurements
                        .get(*reading)
                        .and_then(|asked| choose(asked.drive, asked.sense));
                }
                _ => {}
            }
        }
        self
    }

    /// The range of each reading in the frame's order; `None` where it is the session's one range.
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

    /// Gives these readings the next larger range. Returns those that could be helped, with their new range.
    pub fn widen(&mut self, rule: &RangeRule, overloaded: &[usize]) -> Vec<(usize, Volts)> {
        let wider: BTreeMap<usize, Volts> = self
            .ranges()
            .into_iter()
            .enumerate()
            .filter(|(reading, _)| overloaded.contains(reading))
            .filter_map(|(reading, range)| Some((reading, rule.next(range?)?)))
            .collect();
        for step in &mut self.steps {
            match step {
                Step::Scan { channels } => {
                    for channel in channels {
                        if let Some(range) = channel.reading.and_then(|at| wider.get(&at)) {
                            channel.range = Some(*range);
                        }
                    }
                }
                Step::Chain { routes } => {
                    for route in routes {
                        if let Some(range) = wider.get(&route.reading) {
                            route.range = Some(*range);
                        }
                    }
                }
                Step::Read { reading, range } => {
                    if let Some(wide) = wider.get(reading) {
                        *range = Some(*wide);
                    }
                }
                _ => {}
            }
        }
        wider.into_iter().collect()
    }

    /// How many times a channel's range is set on the way: only where it differs from what the channel had.
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

    /// Noise of a reading with the ranges as planned. `fraction`: resolution of the voltmeter as a part of its range;
    /// `otherwise`: the range of readings without one of their own; `averages`: readings averaged to one.
    pub fn resolution(&self, fraction: f64, otherwise: Volts, averages: u32) -> Resolution {
        let both_ways = if self.reversal { 2.0 } else { 1.0 };
        let scale = fraction / (f64::from(averages.max(1)) * both_ways).sqrt();
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
        }
    }
}
