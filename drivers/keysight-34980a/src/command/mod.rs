//! The commands of the 34980A as values, and their grammar in both directions. SCPI text of the 34980A is in this
//! module only.
//!
//! Chapters as in the fact sheet: switching and sequences (sections 4, 6), configuration (5), measuring and memory (5),
//! computations on readings (corrections), the mainframe and its status (1, 3, 7). Numbers are parsed to the values
//! that the instrument uses: a range to the smallest that holds the value, an integration time to the next available
//! one.

mod calculate;
mod function;
mod grammar;
mod headers;
mod measure;
mod route;
mod sense;
mod system;
#[cfg(test)]
mod tests;

use std::fmt;
use std::str::FromStr;

use scpi::{Call, ChannelList, Common, ParseError};

#[cfg(feature = "simulator")]
pub(crate) use calculate::LARGEST;
pub use calculate::{Calculate, Limit, Scaling, ScalingQuantity, Statistic};
pub use function::{Detail, Function, Functions, MeasurementRequest, SettingValue};
#[cfg(feature = "simulator")]
pub(crate) use function::{FREQUENCIES, ValueKind, value_kind};
pub(crate) use measure::MOST_SWEEPS;
pub use measure::{Field, Measure, TriggerSource};
#[cfg(feature = "simulator")]
pub(crate) use measure::{LONGEST_TIMER, LONGEST_TRIGGER_DELAY, MOST_SAMPLES, time_word};
pub use route::Route;
pub use sense::{HeaderForm, Quantity, Range, Sense, Setting};
#[cfg(feature = "simulator")]
pub(crate) use system::MEMORIES;
pub use system::{Protection, StatusGroup, System};

/// The channels of a setting; `None` for the internal voltmeter.
pub type Channels = Option<ChannelList>;

/// One command.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// A common command.
    Common(Common),
    /// Relays, scan list, sequences.
    Route(Route),
    /// Configuration of channels.
    Sense(Sense),
    /// Functions other than DC volts.
    Functions(Functions),
    /// Triggers, readings, memory, the format of readings.
    Measure(Measure),
    /// Scaling, limits, alarms, statistics of readings.
    Calculate(Calculate),
    /// Modules, errors, clock, lock, status.
    System(System),
}

impl Command {
    /// Parses one unit of a message.
    ///
    /// # Errors
    /// -113 for an unknown header, or the error of the arguments.
    pub fn of(call: &Call) -> Result<Self, ParseError> {
        match Common::of(call) {
            Some(common) => common.map(Self::Common),
            None => headers::read(call),
        }
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Common(common) => write!(f, "{common}"),
            Self::Route(route) => write!(f, "{route}"),
            Self::Sense(sense) => write!(f, "{sense}"),
            Self::Functions(functions) => write!(f, "{functions}"),
            Self::Measure(measure) => write!(f, "{measure}"),
            Self::Calculate(calculate) => write!(f, "{calculate}"),
            Self::System(system) => write!(f, "{system}"),
        }
    }
}

impl FromStr for Command {
    type Err = ParseError;

    /// Parses a message of one unit.
    fn from_str(text: &str) -> Result<Self, ParseError> {
        let mut calls = scpi::parse_message(text).into_iter();
        match (calls.next(), calls.next()) {
            (Some(call), None) => Self::of(&call?),
            _ => Err(ParseError::Syntax),
        }
    }
}

macro_rules! chapters {
    ($($chapter:ident)*) => { $(
        impl From<$chapter> for Command {
            fn from(command: $chapter) -> Self {
                Self::$chapter(command)
            }
        }
    )* };
}
chapters!(Common Route Sense Functions Measure Calculate System);

/// Commands that are sent in one segment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Message(pub Vec<Command>);

impl fmt::Display for Message {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&scpi::join_units(&self.0))
    }
}

/// Writes the channel list of a query after a blank; nothing without a list.
struct QueryList<'a>(&'a Channels);

impl fmt::Display for QueryList<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(channels) => write!(f, " {channels}"),
            None => Ok(()),
        }
    }
}

/// Writes the channel list of a setting after a comma; nothing without a list.
struct TrailingList<'a>(&'a Channels);

impl fmt::Display for TrailingList<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(channels) => write!(f, ",{channels}"),
            None => Ok(()),
        }
    }
}

/// Writes ON or OFF.
struct OnOff(bool);

impl fmt::Display for OnOff {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0 { "ON" } else { "OFF" })
    }
}

/// The short form of the notation of a value.
fn word<T: Copy + PartialEq>(choices: &[(&'static str, T)], value: T) -> String {
    choices
        .iter()
        .filter(|(_, candidate)| *candidate == value)
        .flat_map(|(notation, _)| notation.chars())
        .filter(|c| !c.is_ascii_lowercase())
        .collect()
}
