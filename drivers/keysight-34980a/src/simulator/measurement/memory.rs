//! Readings in memory, their statistics, and their text form (section 5).

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use scpi::format_nr3_signed;
use survey::Relay;

use crate::command::{Field, Limit};
use crate::simulator::calendar::Calendar;
use crate::simulator::measurement::computation::Mark;

/// One reading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stored {
    /// The value; infinite for an overload.
    pub(crate) value: f64,
    /// The unit of the value.
    pub(crate) mark: Mark,
    /// Time since the start of the scan.
    pub(crate) since: Duration,
    pub(crate) at: Duration,
    pub(crate) channel: Option<Relay>,
    /// The limit that the reading exceeds.
    pub(crate) exceeded: Option<Limit>,
}

/// The statistics of at least one reading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Summary {
    pub(crate) least: Stored,
    pub(crate) most: Stored,
    pub(crate) count: u32,
    sum: f64,
}

impl Summary {
    pub(crate) fn mean(&self) -> f64 {
        self.sum / f64::from(self.count)
    }

    /// The statistics with one more reading.
    pub(crate) fn and(before: Option<Self>, reading: Stored) -> Self {
        let Some(before) = before else {
            return Self {
                least: reading,
                most: reading,
                count: 1,
                sum: reading.value,
            };
        };
        let mut both = Self {
            count: before.count.saturating_add(1),
            sum: before.sum + reading.value,
            ..before
        };
        if reading.value < both.least.value {
            both.least = reading;
        }
        if reading.value > both.most.value {
            both.most = reading;
        }
        both
    }
}

/// Readings in the order of their time. The readings of a READ? are stored ahead of their time.
#[derive(Debug)]
pub(crate) struct Memory {
    readings: VecDeque<Stored>,
    most: usize,
    overflown: bool,
    /// The last removed reading of each channel.
    taken: BTreeMap<Option<Relay>, Stored>,
    /// Statistics of the removed readings of each channel since the start of the measurement.
    removed: BTreeMap<Option<Relay>, Summary>,
    /// Readings up to this time do not belong to a channel's statistics.
    cleared: BTreeMap<Option<Relay>, Duration>,
}

impl Memory {
    pub(crate) fn new(most: usize) -> Self {
        Self {
            readings: VecDeque::new(),
            most: most.max(1),
            overflown: false,
            taken: BTreeMap::new(),
            removed: BTreeMap::new(),
            cleared: BTreeMap::new(),
        }
    }

    /// Capacity, readings.
    pub(crate) fn most(&self) -> usize {
        self.most
    }

    /// Adds a reading; if the memory is full, the oldest is dropped.
    pub(crate) fn push(&mut self, reading: Stored) {
        if self.readings.len() == self.most {
            if let Some(oldest) = self.readings.pop_front() {
                self.remember(oldest);
            }
            self.overflown = true;
        }
        self.readings.push_back(reading);
    }

    /// Removes all readings; the statistics stay.
    pub(crate) fn clear(&mut self) {
        for reading in std::mem::take(&mut self.readings) {
            self.remember(reading);
        }
        self.taken.clear();
        self.overflown = false;
    }

    /// Removes all readings and statistics, for a new measurement.
    pub(crate) fn restart(&mut self) {
        *self = Self::new(self.most);
    }

    fn remember(&mut self, reading: Stored) {
        self.taken.insert(reading.channel, reading);
        if self.counts(&reading) {
            let before = self.removed.get(&reading.channel).copied();
            let summary = Summary::and(before, reading);
            self.removed.insert(reading.channel, summary);
        }
    }

    fn counts(&self, reading: &Stored) -> bool {
        let cleared = self.cleared.get(&reading.channel);
        cleared.is_none_or(|cleared| reading.at > *cleared)
    }

    /// The statistics of a channel's readings up to this time; `None` without a reading.
    pub(crate) fn summary(&self, channel: Option<Relay>, now: Duration) -> Option<Summary> {
        let removed = self.removed.get(&channel).copied();
        let there = self.read(now);
        there
            .filter(|reading| reading.channel == channel && self.counts(reading))
            .fold(removed, |before, reading| {
                Some(Summary::and(before, *reading))
            })
    }

    /// Clears the statistics of a channel.
    pub(crate) fn clear_summary(&mut self, channel: Option<Relay>, now: Duration) {
        self.removed.remove(&channel);
        self.cleared.insert(channel, now);
    }

    pub(crate) fn is_overflown(&self) -> bool {
        self.overflown
    }

    /// Number of readings up to this time.
    pub(crate) fn points(&self, now: Duration) -> usize {
        self.readings.partition_point(|reading| reading.at <= now)
    }

    /// The readings up to this time.
    pub(crate) fn read(&self, now: Duration) -> impl Iterator<Item = &Stored> {
        self.readings.iter().take(self.points(now))
    }

    /// The last reading of a channel up to this time, even if it was removed since.
    pub(crate) fn last(&self, channel: Option<Relay>, now: Duration) -> Option<&Stored> {
        let there = self.readings.range(..self.points(now));
        let mut of_channel = there.rev().filter(|reading| reading.channel == channel);
        of_channel.next().or_else(|| self.taken.get(&channel))
    }

    /// Removes and returns up to `count` of the oldest readings.
    pub(crate) fn take(&mut self, count: usize, now: Duration) -> Vec<Stored> {
        let count = count.min(self.points(now));
        let taken: Vec<Stored> = self.readings.drain(..count).collect();
        for reading in &taken {
            self.remember(*reading);
        }
        taken
    }

    /// Drops the readings after this time.
    pub(crate) fn forget_after(&mut self, now: Duration) {
        self.readings.truncate(self.points(now));
    }
}

/// The fields that follow a reading's value.
#[derive(Debug, Clone, Default)]
pub(crate) struct ReadingFormat {
    pub(crate) fields: BTreeSet<Field>,
    pub(crate) absolute: bool,
}

impl ReadingFormat {
    /// Every field, with the time of day.
    pub(crate) fn whole() -> Self {
        Self {
            fields: [Field::Unit, Field::Time, Field::Channel, Field::Alarm].into(),
            absolute: true,
        }
    }

    /// Readings with their fields, all joined by commas.
    pub(crate) fn write<'a>(
        &self,
        readings: impl IntoIterator<Item = &'a Stored>,
        calendar: &Calendar,
    ) -> String {
        let mut text = String::new();
        for reading in readings {
            if !text.is_empty() {
                text.push(',');
            }
            text.push_str(&format_nr3_signed(reading.value, 8));
            for field in &self.fields {
                match field {
                    Field::Unit => {
                        text.push(' ');
                        text.push_str(reading.mark.text());
                    }
                    Field::Time if self.absolute => {
                        text.push(',');
                        text.push_str(&calendar.stamp(reading.at));
                    }
                    Field::Time => {
                        text.push_str(&format!(",{:013.3}", reading.since.as_secs_f64()));
                    }
                    Field::Channel => {
                        let number = reading.channel.map_or(0, |relay| relay.0);
                        text.push_str(&format!(",{number}"));
                    }
                    Field::Alarm => text.push_str(match reading.exceeded {
                        None => ",0",
                        Some(Limit::Lower) => ",1",
                        Some(Limit::Upper) => ",2",
                    }),
                }
            }
        }
        text
    }
}
