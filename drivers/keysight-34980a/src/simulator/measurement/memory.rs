//! Readings in memory, and their text form (section 5).

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

use scpi::format_nr3_signed;
use survey::Relay;

use crate::command::Field;
use crate::simulator::calendar::Calendar;

/// One reading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stored {
    /// Infinite for an overload.
    pub(crate) value: f64,
    /// Its unit.
    pub(crate) mark: &'static str,
    /// Since the start of the scan.
    pub(crate) since: Duration,
    pub(crate) at: Duration,
    pub(crate) channel: Option<Relay>,
}

/// Readings in the order of their time. Those of a READ? are stored before their time has come.
#[derive(Debug)]
pub(crate) struct Memory {
    readings: VecDeque<Stored>,
    most: usize,
    overflown: bool,
    /// The last reading of each channel that was removed.
    taken: BTreeMap<Option<Relay>, Stored>,
}

impl Memory {
    pub(crate) fn new(most: usize) -> Self {
        Self {
            readings: VecDeque::new(),
            most: most.max(1),
            overflown: false,
            taken: BTreeMap::new(),
        }
    }

    /// Capacity.
    pub(crate) fn most(&self) -> usize {
        self.most
    }

    /// Adds a reading; a full memory drops the oldest.
    pub(crate) fn push(&mut self, reading: Stored) {
        if self.readings.len() == self.most {
            let oldest = self.readings.pop_front();
            self.taken
                .extend(oldest.map(|oldest| (oldest.channel, oldest)));
            self.overflown = true;
        }
        self.readings.push_back(reading);
    }

    pub(crate) fn clear(&mut self) {
        self.readings.clear();
        self.taken.clear();
        self.overflown = false;
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

    /// Removes the oldest readings, at most those that exist.
    pub(crate) fn take(&mut self, count: usize, now: Duration) -> Vec<Stored> {
        let count = count.min(self.points(now));
        let taken: Vec<Stored> = self.readings.drain(..count).collect();
        self.taken
            .extend(taken.iter().map(|reading| (reading.channel, *reading)));
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
                        text.push_str(reading.mark);
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
                    Field::Alarm => text.push_str(",0"),
                }
            }
        }
        text
    }
}
