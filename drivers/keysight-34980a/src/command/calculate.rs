//! Computations on readings: scaling, limits with their alarms, statistics. Sources: corrections of 2026-11-22 of the
//! fact sheet; help pages CALCulate:SCALe, CALCulate:LIMit, CALCulate:AVERage, OUTPut:ALARm, SYSTem:ALARm.

use std::fmt;

use scpi::{ChannelList, Numeric, ParseError, Unit, quote};

use super::grammar::{Table, before_channels, limit, list, only_channels, value_and_channels};
use super::{Channels, OnOff, QueryList, TrailingList, word};

/// A limit of a channel's readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Limit {
    /// Readings below it raise an alarm.
    Lower,
    /// Readings above it raise an alarm.
    Upper,
}

/// A setting of scaling: scaled reading = gain x reading + offset.
#[derive(Debug, Clone, PartialEq)]
pub enum Scaling {
    /// The gain.
    Gain(f64),
    /// The offset.
    Offset(f64),
    /// The unit of scaled readings, at most three characters.
    Unit(String),
    /// Whether readings are scaled.
    State(bool),
}

/// A setting of scaling without its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScalingQuantity {
    /// See [`Scaling::Gain`].
    Gain,
    /// See [`Scaling::Offset`].
    Offset,
    /// See [`Scaling::Unit`].
    Unit,
    /// See [`Scaling::State`].
    State,
}

/// A statistic of a channel's readings since the start of the scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Statistic {
    /// The smallest reading.
    Minimum,
    /// Date and time of the smallest reading.
    MinimumTime,
    /// The largest reading.
    Maximum,
    /// Date and time of the largest reading.
    MaximumTime,
    /// The mean.
    Average,
    /// Difference of the largest and the smallest reading.
    PeakToPeak,
    /// The number of readings.
    Count,
}

/// Scaling, limits, alarms, statistics; without a channel list those of the internal voltmeter.
#[derive(Debug, Clone, PartialEq)]
pub enum Calculate {
    /// Change a setting of scaling.
    SetScaling(Scaling, Channels),
    /// Read a setting of scaling.
    Scaling(ScalingQuantity, Channels),
    /// Set a limit.
    SetLimit(Limit, Numeric, ChannelList),
    /// Read a limit, or the smallest or largest that can be set.
    Limit(Limit, Option<Numeric>, ChannelList),
    /// Switch the comparison of readings with a limit.
    SetLimitState(Limit, bool, ChannelList),
    /// Read whether readings are compared with a limit.
    LimitState(Limit, ChannelList),
    /// Read a statistic.
    Statistic(Statistic, Channels),
    /// Clear the statistics.
    ClearStatistics(Channels),
    /// Assign channels to one of the alarms 1 to 4.
    SetAlarmSource(u8, ChannelList),
    /// Read the channels that were assigned to an alarm.
    AlarmSource(u8),
    /// Read the oldest alarm and remove it.
    NextAlarm,
}

const LIMITS: [(&str, Limit); 2] = [("LOWer", Limit::Lower), ("UPPer", Limit::Upper)];

const SCALINGS: [(&str, ScalingQuantity); 4] = [
    ("GAIN", ScalingQuantity::Gain),
    ("OFFSet", ScalingQuantity::Offset),
    ("UNIT", ScalingQuantity::Unit),
    ("STATe", ScalingQuantity::State),
];

const STATISTICS: [(&str, Statistic); 7] = [
    ("MINimum", Statistic::Minimum),
    ("MINimum:TIME", Statistic::MinimumTime),
    ("MAXimum", Statistic::Maximum),
    ("MAXimum:TIME", Statistic::MaximumTime),
    ("AVERage", Statistic::Average),
    ("PTPeak", Statistic::PeakToPeak),
    ("COUNt", Statistic::Count),
];

/// Largest gain and offset; also the magnitude of the limits of a channel for which none were set.
pub(crate) const LARGEST: f64 = 1e15;
/// Longest unit of scaled readings.
const LONGEST_UNIT: usize = 3;

pub(super) fn rows(table: &mut Table) {
    use Calculate as C;
    for (name, quantity) in SCALINGS {
        let notation = format!("CALCulate:SCALe:{name}");
        table.add(&notation, move |call| {
            let (value, channels) = value_and_channels(call)?;
            let number = |def| value.number(Unit::None)?.within(-LARGEST, LARGEST, def);
            let scaling = match quantity {
                ScalingQuantity::Gain => Scaling::Gain(number(1.0)?),
                ScalingQuantity::Offset => Scaling::Offset(number(0.0)?),
                ScalingQuantity::Unit => Scaling::Unit(unit(value.string()?)?),
                ScalingQuantity::State => Scaling::State(value.boolean()?),
            };
            Ok(C::SetScaling(scaling, channels))
        });
        table.add(&format!("{notation}?"), move |call| {
            only_channels(call).map(|channels| C::Scaling(quantity, channels))
        });
    }
    for (name, which) in LIMITS {
        let notation = format!("CALCulate:LIMit:{name}");
        table.add(&notation, move |call| {
            let [value, channels] = call.exactly()?;
            let value = value.number(Unit::None)?;
            Ok(C::SetLimit(which, value, channels.channels()?))
        });
        table.add(&format!("{notation}?"), move |call| {
            let (values, channels) = before_channels(call)?;
            if values.len() > 1 {
                return Err(ParseError::ParameterNotAllowed);
            }
            let channels = channels.ok_or(ParseError::MissingParameter)?;
            Ok(C::Limit(which, limit(values.first())?, channels))
        });
        table.add(&format!("{notation}:STATe"), move |call| {
            let [on, channels] = call.exactly()?;
            Ok(C::SetLimitState(which, on.boolean()?, channels.channels()?))
        });
        table.add(&format!("{notation}:STATe?"), move |call| {
            list(call).map(|channels| C::LimitState(which, channels))
        });
    }
    for (name, statistic) in STATISTICS {
        table.add(&format!("CALCulate:AVERage:{name}?"), move |call| {
            only_channels(call).map(|channels| C::Statistic(statistic, channels))
        });
    }
    table.add("CALCulate:AVERage:CLEar", |call| {
        only_channels(call).map(C::ClearStatistics)
    });
    for alarm in 1..=4 {
        let notation = format!("OUTPut:ALARm{alarm}:SOURce");
        table.add(&notation, move |call| {
            list(call).map(|channels| C::SetAlarmSource(alarm, channels))
        });
        table.plain(&format!("{notation}?"), C::AlarmSource(alarm));
    }
    table.plain("SYSTem:ALARm?", C::NextAlarm);
}

/// A unit of scaled readings: letters, digits, underscore, blank, `#`.
fn unit(text: &str) -> Result<String, ParseError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || "_ #".contains(c);
    match text.len() <= LONGEST_UNIT && text.chars().all(allowed) {
        true => Ok(text.to_owned()),
        false => Err(ParseError::IllegalParameter),
    }
}

impl Scaling {
    fn quantity(&self) -> ScalingQuantity {
        match self {
            Self::Gain(_) => ScalingQuantity::Gain,
            Self::Offset(_) => ScalingQuantity::Offset,
            Self::Unit(_) => ScalingQuantity::Unit,
            Self::State(_) => ScalingQuantity::State,
        }
    }
}

impl fmt::Display for Scaling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gain(value) | Self::Offset(value) => write!(f, "{value:E}"),
            Self::Unit(unit) => f.write_str(&quote(unit)),
            Self::State(on) => write!(f, "{}", OnOff(*on)),
        }
    }
}

impl fmt::Display for Calculate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scale = |quantity| format!("CALC:SCAL:{}", word(&SCALINGS, quantity));
        let limit = |which| format!("CALC:LIM:{}", word(&LIMITS, which));
        match self {
            Self::SetScaling(scaling, list) => {
                let header = scale(scaling.quantity());
                write!(f, "{header} {scaling}{}", TrailingList(list))
            }
            Self::Scaling(quantity, list) => write!(f, "{}?{}", scale(*quantity), QueryList(list)),
            Self::SetLimit(which, value, list) => write!(f, "{} {value},{list}", limit(*which)),
            Self::Limit(which, None, list) => write!(f, "{}? {list}", limit(*which)),
            Self::Limit(which, Some(end), list) => write!(f, "{}? {end},{list}", limit(*which)),
            Self::SetLimitState(which, on, list) => {
                write!(f, "{}:STAT {},{list}", limit(*which), OnOff(*on))
            }
            Self::LimitState(which, list) => write!(f, "{}:STAT? {list}", limit(*which)),
            Self::Statistic(statistic, list) => {
                let name = word(&STATISTICS, *statistic);
                write!(f, "CALC:AVER:{name}?{}", QueryList(list))
            }
            Self::ClearStatistics(list) => write!(f, "CALC:AVER:CLE{}", QueryList(list)),
            Self::SetAlarmSource(alarm, list) => write!(f, "OUTP:ALAR{alarm}:SOUR {list}"),
            Self::AlarmSource(alarm) => write!(f, "OUTP:ALAR{alarm}:SOUR?"),
            Self::NextAlarm => f.write_str("SYST:ALAR?"),
        }
    }
}
