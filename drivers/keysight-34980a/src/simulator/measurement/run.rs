//! A running measurement: sweeps through a list of channels, each reading at its own instant.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use survey::Relay;

use crate::command::{Function, Limit, Range};
use crate::simulator::measurement::computation::{Limits, Mark, Scale};
use crate::simulator::measurement::functions::{FunctionSettings, dc_volts};
use crate::simulator::measurement::memory::{Memory, Stored};
use crate::simulator::relays::{Relays, ScanRelays};
use crate::simulator::{
    CURRENT_OVERLOAD, RESISTANCE_OVERLOAD, TEMPERATURE_OVERLOAD, VOLTAGE_OVERLOAD, Wires,
};

/// One reading of a sweep: of a channel, or without a channel of the bare voltmeter.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScanEntry {
    pub(crate) channel: Option<Relay>,
    pub(crate) measured: Measured,
    pub(crate) period: Duration,
    pub(crate) nplc: f64,
    /// Whether this is a further sample of the same channel; its relays then stay as they are.
    pub(crate) again: bool,
    pub(crate) scale: Scale,
    pub(crate) limits: Limits,
    /// The alarm of the limits, 1 to 4.
    pub(crate) alarm: u8,
}

/// The measured quantity.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Measured {
    /// DC volts on a range.
    Volts(Range),
    /// Another function.
    Other(FunctionSettings),
}

impl Measured {
    fn mark(&self) -> Mark {
        Mark::Function(match self {
            Self::Volts(_) => Function::DcVolts.mark(),
            Self::Other(settings) => settings.mark(),
        })
    }

    pub(crate) fn four_wire(&self) -> bool {
        matches!(self, Self::Other(settings) if settings.four_wire())
    }

    /// The bit of an overload in the questionable register.
    fn overload(&self) -> u8 {
        match self {
            Self::Volts(_) => VOLTAGE_OVERLOAD,
            Self::Other(settings) => match settings.function {
                Function::DcCurrent | Function::AcCurrent => CURRENT_OVERLOAD,
                Function::Resistance | Function::FourWire => RESISTANCE_OVERLOAD,
                Function::Temperature => TEMPERATURE_OVERLOAD,
                _ => VOLTAGE_OVERLOAD,
            },
        }
    }
}

/// The event that starts a sweep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum SweepStart {
    /// The end of the previous sweep.
    Continuous,
    /// This time after the start of the previous sweep.
    Timer(Duration),
    /// A trigger.
    Triggered,
}

#[derive(Debug, Clone, Copy)]
enum Phase {
    /// The channel with this index is connected at this time.
    Due(usize, Duration),
    /// The channel was connected at this time, and its reading is being taken.
    Measuring(usize, Duration, ScanRelays),
    /// Waiting for a trigger.
    Waiting,
}

/// Events for the status registers.
#[derive(Debug, Clone, Default)]
pub(crate) struct StatusEvents {
    pub(crate) measured: bool,
    /// Bits of the questionable register.
    pub(crate) overload: BTreeSet<u8>,
    pub(crate) threshold: bool,
    /// Readings that crossed a limit, with the numbers of their alarms.
    pub(crate) alarms: Vec<(Stored, u8)>,
}

#[derive(Debug)]
pub(crate) struct Run {
    entries: Vec<ScanEntry>,
    start: Duration,
    pace: SweepStart,
    /// Number of sweeps; `None`: until the measurement is stopped.
    sweeps: Option<u32>,
    done: u32,
    phase: Phase,
    /// The limits that the channels' last readings exceed.
    exceeded: BTreeMap<Relay, Limit>,
}

impl Run {
    /// A measurement that begins now. `entries` must not be empty.
    pub(crate) fn new(
        entries: Vec<ScanEntry>,
        pace: SweepStart,
        sweeps: Option<u32>,
        now: Duration,
    ) -> Self {
        Self {
            entries,
            start: now,
            pace,
            sweeps,
            done: 0,
            exceeded: BTreeMap::new(),
            phase: match pace {
                SweepStart::Triggered => Phase::Waiting,
                SweepStart::Continuous | SweepStart::Timer(_) => Phase::Due(0, now),
            },
        }
    }

    pub(crate) fn start(&self) -> Duration {
        self.start
    }

    pub(crate) fn is_waiting(&self) -> bool {
        matches!(self.phase, Phase::Waiting)
    }

    /// Receives a trigger, if one is awaited.
    pub(crate) fn trigger(&mut self, now: Duration) -> bool {
        let waits = self.is_waiting();
        if waits {
            // a trigger of another session may arrive before the start of the measurement by the instrument's clock
            self.phase = Phase::Due(0, now.max(self.start));
        }
        waits
    }

    /// Time of the next action.
    pub(crate) fn due(&self) -> Option<Duration> {
        match self.phase {
            Phase::Due(_, at) => Some(at),
            Phase::Measuring(index, since, _) => Some(since + self.entries[index].period),
            Phase::Waiting => None,
        }
    }

    fn sweep_time(&self) -> Duration {
        self.entries.iter().map(|entry| entry.period).sum()
    }

    /// Start of the next sweep after one that ended at this time.
    fn next_sweep(&self, ended: Duration, done: u32) -> Duration {
        match self.pace {
            SweepStart::Timer(timer) => ended.max(self.start + timer * done),
            SweepStart::Continuous | SweepStart::Triggered => ended,
        }
    }

    /// End of the measurement, if it can be foreseen; for a triggered one the end of the present sweep.
    pub(crate) fn ends_at(&self) -> Option<Duration> {
        let (index, from) = match self.phase {
            Phase::Due(index, at) => (index, at),
            Phase::Measuring(index, since, _) => (index, since),
            Phase::Waiting => return None,
        };
        let rest: Duration = self.entries[index..].iter().map(|entry| entry.period).sum();
        let ended = from + rest;
        if self.pace == SweepStart::Triggered {
            return Some(ended);
        }
        let after = self.sweeps?.saturating_sub(self.done + 1);
        if after == 0 {
            return Some(ended);
        }
        // sweeps follow one another without a gap or by the timer, whichever takes longer
        let second = self.next_sweep(ended, self.done + 1);
        let in_a_row = second + self.sweep_time() * (after - 1);
        Some(self.next_sweep(in_a_row, self.done + after) + self.sweep_time())
    }

    /// Executes everything that is due up to this time; returns whether the measurement has ended.
    pub(crate) fn advance(
        &mut self,
        to: Duration,
        relays: &mut Relays,
        wires: &mut dyn Wires,
        memory: &mut Memory,
        noticed: &mut StatusEvents,
    ) -> bool {
        loop {
            match self.phase {
                Phase::Waiting => return false,
                Phase::Due(_, at) if at > to => return false,
                Phase::Due(index, at) => {
                    let at = if index == 0 {
                        self.skip(at, to, relays, wires, memory)
                    } else {
                        at
                    };
                    if at > to {
                        self.phase = Phase::Due(index, at);
                        return false;
                    }
                    let entry = &self.entries[index];
                    let joined = match entry.channel {
                        Some(channel) => relays.join_to_bus(channel, entry.measured.four_wire()),
                        None => ScanRelays::default(),
                    };
                    if joined[0].is_some() {
                        relays.tell(at, wires);
                    }
                    self.phase = Phase::Measuring(index, at, joined);
                }
                Phase::Measuring(index, since, joined) => {
                    let entry = self.entries[index];
                    let at = since + entry.period;
                    if at > to {
                        return false;
                    }
                    let value = measure(&entry, at, wires);
                    if value.is_infinite() {
                        noticed.overload.insert(entry.measured.overload());
                    }
                    let (value, mark) = entry.scale.applied(value, entry.measured.mark());
                    let reading = Stored {
                        value,
                        mark,
                        since: at.saturating_sub(self.start),
                        at,
                        channel: entry.channel,
                        exceeded: entry.limits.exceeded(value),
                    };
                    if self.crosses(&reading) {
                        noticed.alarms.push((reading, entry.alarm));
                    }
                    memory.push(reading);
                    if self.entries.get(index + 1).is_some_and(|next| next.again) {
                        self.phase = Phase::Measuring(index + 1, at, joined);
                        continue;
                    }
                    relays.unjoin(joined);
                    self.phase = Phase::Due(index + 1, at);
                    if index + 1 == self.entries.len() {
                        if joined[0].is_some() {
                            relays.tell(at, wires);
                        }
                        self.done = self.done.saturating_add(1);
                        if self.sweeps == Some(self.done) {
                            return true;
                        }
                        self.phase = match self.pace {
                            SweepStart::Triggered => Phase::Waiting,
                            _ => Phase::Due(0, self.next_sweep(at, self.done)),
                        };
                    }
                }
            }
        }
    }

    /// Whether a reading exceeds a limit that the channel's last reading did not exceed.
    fn crosses(&mut self, reading: &Stored) -> bool {
        let Some(channel) = reading.channel else {
            return false;
        };
        let before = match reading.exceeded {
            Some(limit) => self.exceeded.insert(channel, limit),
            None => self.exceeded.remove(&channel),
        };
        reading.exceeded.is_some() && before != reading.exceeded
    }

    /// Skips sweeps whose readings would be overwritten before they could be read. After a long time without calls,
    /// only about as many sweeps are measured as the memory holds. Returns the start of the next sweep to be measured.
    ///
    /// Number and times of sweeps, number of readings in memory, overflow and closures of relays are those of a scan
    /// without skipped sweeps. Noise is drawn for measured readings only, and only these count for limits, overloads
    /// and statistics: the same calls at the same times give the same bits, but an additional call in between may give
    /// other bits. The first sweep is never skipped, so that a reading that exceeds a limit from the beginning raises
    /// its alarm in it.
    fn skip(
        &mut self,
        at: Duration,
        to: Duration,
        relays: &mut Relays,
        wires: &mut dyn Wires,
        memory: &mut Memory,
    ) -> Duration {
        let step = match self.pace {
            SweepStart::Timer(timer) => timer.max(self.sweep_time()),
            SweepStart::Continuous => self.sweep_time(),
            SweepStart::Triggered => return at,
        };
        let left = self.sweeps.map_or(u32::MAX, |sweeps| sweeps - self.done);
        let in_time = (to - at).as_nanos() / step.as_nanos().max(1);
        let ahead = u32::try_from(in_time).unwrap_or(u32::MAX).min(left);
        let fill = u32::try_from(memory.most() / self.entries.len() + 2).unwrap_or(u32::MAX);
        let skipped = ahead.saturating_sub(fill);
        let next = at + step * skipped;
        if skipped > 0 {
            self.done = self.done.saturating_add(skipped);
            let mut before = ScanRelays::default();
            for entry in self.entries.iter().filter(|entry| !entry.again) {
                let Some(channel) = entry.channel else {
                    continue;
                };
                let joined = relays.of_reading(channel, entry.measured.four_wire());
                relays.count_skipped(joined, skipped);
                // a relay that the reading before also needs does not move
                let moved = joined.into_iter().flatten();
                let moved = moved.filter(|relay| !before.contains(&Some(*relay)));
                wires.skipped(&moved.collect::<Vec<_>>(), skipped, next);
                before = joined;
            }
        }
        next
    }

    /// Opens the relays that a reading has closed.
    pub(crate) fn stop(&mut self, at: Duration, relays: &mut Relays, wires: &mut dyn Wires) {
        if let Phase::Measuring(_, _, joined) = self.phase {
            relays.unjoin(joined);
            relays.tell(at, wires);
        }
    }
}

/// One reading; infinite, with its sign, for an overload.
fn measure(entry: &ScanEntry, at: Duration, wires: &mut dyn Wires) -> f64 {
    match entry.measured {
        Measured::Volts(range) => dc_volts(range, entry.channel, entry.nplc, at, wires),
        Measured::Other(settings) => settings.reading(entry.channel, entry.nplc, at, wires),
    }
}
