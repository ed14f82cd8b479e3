//! Triggers, measurements, memory, and the format of a reading: fact sheet section 5.

use std::fmt;

use scpi::{Numeric, Unit};

use super::grammar::{Table, limit, only_channels};
use super::sense::{volts, write_volts};
use super::{Channels, OnOff, QueryList, Range, word};

/// The event that starts a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TriggerSource {
    /// No event: a sweep starts at once.
    Immediate,
    /// `*TRG`.
    Bus,
    /// A pulse at the rear connector.
    External,
    /// The timer.
    Timer,
    /// An alarm, 1 to 4, of a monitored channel. The simulator monitors no channel, so the sweep waits.
    Alarm(u8),
}

/// A field that may follow a reading's value, in the order of the reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Field {
    /// The unit, for example ` VDC`.
    Unit,
    /// Time of the reading.
    Time,
    /// Channel number.
    Channel,
    /// Number of the alarm.
    Alarm,
}

/// Triggers, readings, memory, the format of readings.
#[derive(Debug, Clone, PartialEq)]
pub enum Measure {
    /// Measure and return all readings; a channel list replaces the scan list for this measurement.
    Read(Channels),
    /// Configure for DC volts as CONF does, measure and return all readings.
    Volts {
        /// Range.
        range: Range,
        /// Resolution, V.
        resolution: Option<Numeric>,
        /// The scan list.
        channels: Channels,
    },
    /// Measure into memory.
    Initiate,
    /// Return all readings in memory, at the end of the measurement.
    Fetch,
    /// Return the oldest readings in memory, at most this number, and erase them.
    ReadAndErase(Option<u32>),
    /// Return exactly this number of the oldest readings in memory, and erase them.
    Remove(u32),
    /// Read the number of readings in memory.
    Points,
    /// Read the last reading of a channel, or of the bare voltmeter, with all its fields (help: DATA:LAST?).
    Last(Channels),
    /// Set the threshold: the number of readings in memory at which an event bit is set.
    SetThreshold(u32),
    /// Read the threshold.
    Threshold,
    /// Stop measuring.
    Abort,
    /// Set the trigger source of sweeps.
    SetSource(TriggerSource),
    /// Read the trigger source.
    Source,
    /// Set the timer: the time from the start of one sweep to the start of the next, s.
    SetTimer(f64),
    /// Read the timer, or its smallest, largest or default value, s.
    Timer(Option<Numeric>),
    /// Set the number of sweeps of a measurement; `None`: until it is stopped.
    SetCount(Option<u32>),
    /// Read the number of sweeps, or its smallest, largest or default value.
    Count(Option<Numeric>),
    /// Set the number of samples: readings of a channel, or of the bare voltmeter, for each trigger (help:
    /// SAMPle:COUNt).
    SetSamples(u32),
    /// Read the number of samples, or its smallest, largest or default value.
    Samples(Option<Numeric>),
    /// Set the delay after a trigger for the bare voltmeter, s (help: TRIGger:DELay); `None`: automatic.
    SetTriggerDelay(Option<f64>),
    /// Read the delay after a trigger, or its smallest, largest or default value, s.
    TriggerDelay(Option<Numeric>),
    /// Read whether the delay after a trigger is automatic.
    TriggerDelayAuto,
    /// Set whether a field is appended to every reading.
    SetField(Field, bool),
    /// Read whether the field is appended.
    Field(Field),
    /// Stamp readings with the time of day (true), or with the time since the start of the scan.
    SetAbsoluteTime(bool),
    /// Read the type of time stamp.
    AbsoluteTime,
}

const SOURCES: [(&str, TriggerSource); 8] = [
    ("IMMediate", TriggerSource::Immediate),
    ("BUS", TriggerSource::Bus),
    ("EXTernal", TriggerSource::External),
    ("TIMer", TriggerSource::Timer),
    ("ALARm1", TriggerSource::Alarm(1)),
    ("ALARm2", TriggerSource::Alarm(2)),
    ("ALARm3", TriggerSource::Alarm(3)),
    ("ALARm4", TriggerSource::Alarm(4)),
];

const FIELDS: [(&str, Field); 4] = [
    ("UNIT", Field::Unit),
    ("TIME", Field::Time),
    ("CHANnel", Field::Channel),
    ("ALARm", Field::Alarm),
];

const TIMES: [(&str, bool); 2] = [("ABSolute", true), ("RELative", false)];

/// Longest time between sweeps, s.
pub(crate) const LONGEST_TIMER: f64 = 359_999.999;
/// Most sweeps that can be counted.
pub(crate) const MOST_SWEEPS: u32 = 50_000;
/// Most readings of a channel for each trigger (help: SAMPle:COUNt).
pub(crate) const MOST_SAMPLES: u32 = 500_000;
/// Longest delay after a trigger, s (help: TRIGger:DELay).
pub(crate) const LONGEST_TRIGGER_DELAY: f64 = 3600.0;
/// Upper limit for a number of readings in a query, more than any memory holds.
const MOST_READINGS: i64 = 1_000_000_000;

pub(super) fn rows(table: &mut Table) {
    use Measure as M;
    table.add("READ?", |call| only_channels(call).map(M::Read));
    table.add("MEASure[:SCALar]:VOLTage[:DC]?", |call| {
        let (range, resolution, channels) = volts(call)?;
        Ok(M::Volts {
            range,
            resolution,
            channels,
        })
    });
    table.plain("INITiate[:IMMediate]", M::Initiate);
    table.plain("FETCh?", M::Fetch);
    table.add("R?", |call| match call.at_most_one()? {
        None => Ok(M::ReadAndErase(None)),
        Some(most) => Ok(M::ReadAndErase(
            Some(most.integer(1, MOST_READINGS)? as u32),
        )),
    });
    table.add("DATA:REMove?", |call| {
        let [count] = call.exactly()?;
        Ok(M::Remove(count.integer(1, MOST_READINGS)? as u32))
    });
    table.plain("DATA:POINts?", M::Points);
    table.add("DATA:LAST?", |call| only_channels(call).map(M::Last));
    table.add("DATA:POINts:EVENt:THReshold", |call| {
        let [count] = call.exactly()?;
        Ok(M::SetThreshold(count.integer(1, MOST_READINGS)? as u32))
    });
    table.plain("DATA:POINts:EVENt:THReshold?", M::Threshold);
    table.plain("ABORt", M::Abort);
    table.add("TRIGger:SOURce", |call| {
        let [source] = call.exactly()?;
        source.choice(&SOURCES).map(M::SetSource)
    });
    table.plain("TRIGger:SOURce?", M::Source);
    table.add("TRIGger:TIMer", |call| {
        let [time] = call.exactly()?;
        let time = time
            .number(Unit::Second)?
            .within(0.0, LONGEST_TIMER, 10.0)?;
        // the instrument stores milliseconds
        Ok(M::SetTimer((time * 1e3).round() / 1e3))
    });
    table.add("TRIGger:TIMer?", |call| {
        limit(call.at_most_one()?).map(M::Timer)
    });
    table.add("TRIGger:COUNt", |call| {
        let [count] = call.exactly()?;
        Ok(M::SetCount(match count.number(Unit::None)? {
            Numeric::Infinity => None,
            Numeric::Def => Some(1),
            // The limits are those of u32.
            _ => Some(count.integer(1, MOST_SWEEPS.into())? as u32),
        }))
    });
    table.add("TRIGger:COUNt?", |call| {
        limit(call.at_most_one()?).map(M::Count)
    });
    table.add("SAMPle:COUNt", |call| {
        let [count] = call.exactly()?;
        Ok(M::SetSamples(match count.number(Unit::None)? {
            Numeric::Def => 1,
            // The limits are those of u32.
            _ => count.integer(1, MOST_SAMPLES.into())? as u32,
        }))
    });
    table.add("SAMPle:COUNt?", |call| {
        limit(call.at_most_one()?).map(M::Samples)
    });
    table.add("TRIGger:DELay", |call| {
        let [delay] = call.exactly()?;
        let delay = delay
            .number(Unit::Second)?
            .within(0.0, LONGEST_TRIGGER_DELAY, 0.0)?;
        // the instrument stores steps of 4 us
        Ok(M::SetTriggerDelay(Some((delay / 4e-6).round() * 4.0 / 1e6)))
    });
    table.add("TRIGger:DELay?", |call| {
        limit(call.at_most_one()?).map(M::TriggerDelay)
    });
    table.add("TRIGger:DELay:AUTO", |call| {
        let [on] = call.exactly()?;
        let delay = (!on.boolean()?).then_some(0.0);
        Ok(M::SetTriggerDelay(delay))
    });
    table.plain("TRIGger:DELay:AUTO?", M::TriggerDelayAuto);
    table.add("FORMat:READing:TIME:TYPE", |call| {
        let [choice] = call.exactly()?;
        choice.choice(&TIMES).map(M::SetAbsoluteTime)
    });
    table.plain("FORMat:READing:TIME:TYPE?", M::AbsoluteTime);
    for (name, field) in FIELDS {
        table.switch(&format!("FORMat:READing:{name}"), move |on| {
            M::SetField(field, on)
        });
        table.plain(&format!("FORMat:READing:{name}?"), M::Field(field));
    }
}

impl TriggerSource {
    /// The reply to `TRIG:SOUR?`.
    pub fn word(self) -> String {
        word(&SOURCES, self)
    }

    /// Whether a sweep waits for a trigger from outside the voltmeter.
    pub fn waits(self) -> bool {
        matches!(self, Self::Bus | Self::External | Self::Alarm(_))
    }
}

/// The reply to `FORM:READ:TIME:TYPE?`.
pub(crate) fn time_word(absolute: bool) -> String {
    word(&TIMES, absolute)
}

impl fmt::Display for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let limit = |limit: &Option<Numeric>| match limit {
            Some(limit) => format!(" {limit}"),
            None => String::new(),
        };
        match self {
            Self::Read(list) => write!(f, "READ?{}", QueryList(list)),
            Self::Volts {
                range,
                resolution,
                channels,
            } => {
                f.write_str("MEAS:VOLT:DC? ")?;
                write_volts(f, *range, *resolution, channels)
            }
            Self::Initiate => f.write_str("INIT"),
            Self::Fetch => f.write_str("FETC?"),
            Self::ReadAndErase(None) => f.write_str("R?"),
            Self::ReadAndErase(Some(most)) => write!(f, "R? {most}"),
            Self::Remove(count) => write!(f, "DATA:REM? {count}"),
            Self::Points => f.write_str("DATA:POIN?"),
            Self::Last(channel) => write!(f, "DATA:LAST?{}", QueryList(channel)),
            Self::SetThreshold(count) => write!(f, "DATA:POIN:EVEN:THR {count}"),
            Self::Threshold => f.write_str("DATA:POIN:EVEN:THR?"),
            Self::Abort => f.write_str("ABOR"),
            Self::SetSource(source) => write!(f, "TRIG:SOUR {}", source.word()),
            Self::Source => f.write_str("TRIG:SOUR?"),
            Self::SetTimer(time) => write!(f, "TRIG:TIM {time}"),
            Self::Timer(requested) => write!(f, "TRIG:TIM?{}", limit(requested)),
            Self::SetCount(Some(count)) => write!(f, "TRIG:COUN {count}"),
            Self::SetCount(None) => f.write_str("TRIG:COUN INF"),
            Self::Count(requested) => write!(f, "TRIG:COUN?{}", limit(requested)),
            Self::SetSamples(count) => write!(f, "SAMP:COUN {count}"),
            Self::Samples(requested) => write!(f, "SAMP:COUN?{}", limit(requested)),
            Self::SetTriggerDelay(Some(delay)) => write!(f, "TRIG:DEL {delay}"),
            Self::SetTriggerDelay(None) => f.write_str("TRIG:DEL:AUTO ON"),
            Self::TriggerDelay(requested) => write!(f, "TRIG:DEL?{}", limit(requested)),
            Self::TriggerDelayAuto => f.write_str("TRIG:DEL:AUTO?"),
            Self::SetField(field, shown) => {
                write!(f, "FORM:READ:{} {}", word(&FIELDS, *field), OnOff(*shown))
            }
            Self::Field(field) => write!(f, "FORM:READ:{}?", word(&FIELDS, *field)),
            Self::SetAbsoluteTime(absolute) => {
                write!(f, "FORM:READ:TIME:TYPE {}", time_word(*absolute))
            }
            Self::AbsoluteTime => f.write_str("FORM:READ:TIME:TYPE?"),
        }
    }
}
