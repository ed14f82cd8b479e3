//! The commands of the 6221 as values, and their grammar in both directions. No SCPI text stands anywhere else.
//!
//! Chapters as in the fact sheet, section 4.

use std::fmt;
use std::str::FromStr;
use std::sync::LazyLock;

use scpi::{Argument, Call, Common, ParseError, Pattern, Unit, parse_message};
use survey::{Amps, Volts};

use crate::range::{LARGEST_CURRENT, LARGEST_LIMIT, RANGES, SMALLEST_LIMIT};

/// What a numeric query asks for: `?`, `? MIN`, `? MAX`, `? DEF`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Ask {
    /// The value as it is.
    Now,
    /// The smallest that can be set.
    Min,
    /// The largest that can be set.
    Max,
    /// The value after `*RST`.
    Def,
}

/// What the inner shield of the triax output is joined to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Shield {
    /// Output low (after `*RST`).
    OutputLow,
    /// The guard.
    Guard,
}

/// How fast the output responds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Speed {
    /// Settles within 2 to 90 us.
    Fast,
    /// Settles within 100 us, for inductive loads.
    Slow,
}

/// A group of status registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StatusGroup {
    /// Interlock, compliance, buffer.
    Measurement,
    /// Sweeps and triggers.
    Operation,
    /// Power and calibration.
    Questionable,
}

/// One command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// A common command.
    Common(Common),
    /// Set the level.
    SetLevel(Amps),
    /// Read the level.
    Level(Ask),
    /// Set the smallest fixed range that holds this current.
    SetRange(Amps),
    /// Read the range.
    Range(Ask),
    /// Let the range follow the level, or not.
    SetAutorange(bool),
    /// Read whether the range follows the level.
    Autorange,
    /// Set the voltage limit.
    SetCompliance(Volts),
    /// Read the voltage limit.
    Compliance(Ask),
    /// Switch the analogue filter.
    SetFilter(bool),
    /// Read the analogue filter.
    Filter,
    /// Set the level to 0 and the output off.
    ClearSource,
    /// Switch the output.
    SetOutput(bool),
    /// Read the output.
    Output,
    /// Join the inner shield.
    SetShield(Shield),
    /// Read what the inner shield is joined to.
    Shield,
    /// Join output low to earth, or let it float.
    SetLowToEarth(bool),
    /// Read whether output low is joined to earth.
    LowToEarth,
    /// Set the speed of response.
    SetSpeed(Speed),
    /// Read the speed of response.
    Speed,
    /// Read the interlock: 1 closed, 0 open (the header's name says the opposite).
    Interlock,
    /// Read a group's events and clear them.
    Events(StatusGroup),
    /// Read a group's conditions.
    Conditions(StatusGroup),
    /// Choose which of a group's events are summed up.
    SetEnable(StatusGroup, u16),
    /// Read which of a group's events are summed up.
    Enable(StatusGroup),
    /// Zero the enables of all groups.
    PresetStatus,
    /// Take the oldest error.
    NextError,
    /// Forget all errors.
    ClearErrors,
    /// Read the year of the SCPI standard kept.
    Version,
}

/// Compliance in the measurement registers, bit 3 (fact sheet, section 5).
pub(crate) const COMPLIANCE_BIT: u8 = 3;
/// Open interlock in the measurement registers, bit 1.
pub(crate) const INTERLOCK_BIT: u8 = 1;

const SHIELDS: [(&str, Shield); 2] = [("OLOW", Shield::OutputLow), ("GUARd", Shield::Guard)];
const SPEEDS: [(&str, Speed); 2] = [("FAST", Speed::Fast), ("SLOW", Speed::Slow)];

type Hearer = fn(&Call) -> Result<Command, ParseError>;

/// Headers in the manual's notation with what they mean. A row whose notation ends with `?` is for queries, one without
/// for settings.
const GRAMMAR: &[(&str, Hearer)] = &[
    ("[SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]", |call| {
        current(call).map(Command::SetLevel)
    }),
    (
        "[SOURce]:CURRent[:LEVel][:IMMediate][:AMPLitude]?",
        |call| ask(call).map(Command::Level),
    ),
    ("[SOURce]:CURRent:RANGe", |call| {
        range(call).map(Command::SetRange)
    }),
    ("[SOURce]:CURRent:RANGe?", |call| {
        ask(call).map(Command::Range)
    }),
    ("[SOURce]:CURRent:RANGe:AUTO", |call| {
        boolean(call).map(Command::SetAutorange)
    }),
    ("[SOURce]:CURRent:RANGe:AUTO?", |call| {
        plain(call, Command::Autorange)
    }),
    ("[SOURce]:CURRent:COMPliance", |call| {
        limit(call).map(Command::SetCompliance)
    }),
    ("[SOURce]:CURRent:COMPliance?", |call| {
        ask(call).map(Command::Compliance)
    }),
    ("[SOURce]:CURRent:FILTer[:STATe]", |call| {
        boolean(call).map(Command::SetFilter)
    }),
    ("[SOURce]:CURRent:FILTer[:STATe]?", |call| {
        plain(call, Command::Filter)
    }),
    ("[SOURce]:CLEar[:IMMediate]", |call| {
        plain(call, Command::ClearSource)
    }),
    ("OUTPut[:STATe]", |call| {
        boolean(call).map(Command::SetOutput)
    }),
    ("OUTPut[:STATe]?", |call| plain(call, Command::Output)),
    ("OUTPut:ISHield", |call| {
        let [shield] = call.exactly()?;
        shield.choice(&SHIELDS).map(Command::SetShield)
    }),
    ("OUTPut:ISHield?", |call| plain(call, Command::Shield)),
    ("OUTPut:LTEarth", |call| {
        boolean(call).map(Command::SetLowToEarth)
    }),
    ("OUTPut:LTEarth?", |call| plain(call, Command::LowToEarth)),
    ("OUTPut:RESPonse", |call| {
        let [speed] = call.exactly()?;
        speed.choice(&SPEEDS).map(Command::SetSpeed)
    }),
    ("OUTPut:RESPonse?", |call| plain(call, Command::Speed)),
    ("OUTPut:INTerlock:TRIPped?", |call| {
        plain(call, Command::Interlock)
    }),
    ("STATus:PRESet", |call| plain(call, Command::PresetStatus)),
    ("SYSTem:ERRor[:NEXT]?", |call| {
        plain(call, Command::NextError)
    }),
    ("STATus:QUEue[:NEXT]?", |call| {
        plain(call, Command::NextError)
    }),
    ("STATus:QUEue:CLEar", |call| {
        plain(call, Command::ClearErrors)
    }),
    ("SYSTem:CLEar", |call| plain(call, Command::ClearErrors)),
    ("SYSTem:VERSion?", |call| plain(call, Command::Version)),
];

/// The grammar, its notation read once.
static PATTERNS: LazyLock<Vec<(Pattern, bool, Hearer)>> = LazyLock::new(|| {
    GRAMMAR
        .iter()
        .map(|(notation, hear)| (Pattern::new(notation), notation.ends_with('?'), *hear))
        .collect()
});

const GROUPS: [(&str, StatusGroup); 3] = [
    ("MEASurement", StatusGroup::Measurement),
    ("OPERation", StatusGroup::Operation),
    ("QUEStionable", StatusGroup::Questionable),
];

impl Command {
    /// Reads one unit of a message.
    ///
    /// # Errors
    /// -113 for a header that is not one of these, and what the arguments deserve.
    pub fn of(call: &Call) -> Result<Self, ParseError> {
        if let Some(common) = Common::of(call) {
            return common.map(Command::Common);
        }
        for (pattern, query, hear) in PATTERNS.iter() {
            if call.query == *query && pattern.matches(call) {
                return hear(call);
            }
        }
        for (name, group) in GROUPS {
            let is = |tail: &str| call.is(&format!("STATus:{name}{tail}"));
            if call.query && is("[:EVENt]") {
                return plain(call, Command::Events(group));
            }
            if call.query && is(":CONDition") {
                return plain(call, Command::Conditions(group));
            }
            if is(":ENABle") {
                if call.query {
                    return plain(call, Command::Enable(group));
                }
                let [mask] = call.exactly()?;
                // The limits are those of u16.
                let mask = mask.integer(0, 65535)? as u16;
                return Ok(Command::SetEnable(group, mask));
            }
        }
        Err(ParseError::UndefinedHeader)
    }

    /// Whether an answer comes back.
    pub fn is_query(self) -> bool {
        match self {
            Command::Common(common) => common.is_query(),
            Command::Level(_)
            | Command::Range(_)
            | Command::Autorange
            | Command::Compliance(_)
            | Command::Filter
            | Command::Output
            | Command::Shield
            | Command::LowToEarth
            | Command::Speed
            | Command::Interlock
            | Command::Events(_)
            | Command::Conditions(_)
            | Command::Enable(_)
            | Command::NextError
            | Command::Version => true,
            Command::SetLevel(_)
            | Command::SetRange(_)
            | Command::SetAutorange(_)
            | Command::SetCompliance(_)
            | Command::SetFilter(_)
            | Command::ClearSource
            | Command::SetOutput(_)
            | Command::SetShield(_)
            | Command::SetLowToEarth(_)
            | Command::SetSpeed(_)
            | Command::SetEnable(..)
            | Command::PresetStatus
            | Command::ClearErrors => false,
        }
    }
}

fn plain(call: &Call, command: Command) -> Result<Command, ParseError> {
    call.exactly::<0>().map(|_| command)
}

fn boolean(call: &Call) -> Result<bool, ParseError> {
    call.exactly::<1>().and_then(|[value]| value.boolean())
}

fn current(call: &Call) -> Result<Amps, ParseError> {
    let [value] = call.exactly()?;
    let most = LARGEST_CURRENT.0;
    value
        .number(Unit::Ampere)?
        .within(-most, most, 0.0)
        .map(Amps)
}

fn range(call: &Call) -> Result<Amps, ParseError> {
    let [value] = call.exactly()?;
    let most = LARGEST_CURRENT.0;
    match value.number(Unit::Ampere)? {
        scpi::Numeric::Min => Ok(RANGES[0].full_scale),
        scpi::Numeric::Max | scpi::Numeric::Def => Ok(RANGES[RANGES.len() - 1].full_scale),
        value => value.within(-most, most, most).map(Amps),
    }
}

fn limit(call: &Call) -> Result<Volts, ParseError> {
    let [value] = call.exactly()?;
    value
        .number(Unit::Volt)?
        .within(SMALLEST_LIMIT.0, LARGEST_LIMIT.0, 10.0)
        .map(Volts)
}

fn ask(call: &Call) -> Result<Ask, ParseError> {
    const ASKS: [(&str, Ask); 3] = [
        ("MINimum", Ask::Min),
        ("MAXimum", Ask::Max),
        ("DEFault", Ask::Def),
    ];
    call.at_most_one()?
        .map_or(Ok(Ask::Now), |which: &Argument| which.choice(&ASKS))
}

/// The short form of the notation that stands for a value.
fn word<T: Copy + PartialEq>(choices: &[(&'static str, T)], value: T) -> String {
    choices
        .iter()
        .filter(|(_, candidate)| *candidate == value)
        .flat_map(|(notation, _)| notation.chars())
        .filter(|c| !c.is_ascii_lowercase())
        .collect()
}

impl fmt::Display for Ask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Ask::Now => "?",
            Ask::Min => "? MIN",
            Ask::Max => "? MAX",
            Ask::Def => "? DEF",
        })
    }
}

impl fmt::Display for Shield {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&word(&SHIELDS, *self))
    }
}

impl fmt::Display for Speed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&word(&SPEEDS, *self))
    }
}

impl fmt::Display for StatusGroup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&word(&GROUPS, *self))
    }
}

/// Writes the command in short form from the root, without a leading colon. Numbers are written with the fewest digits
/// that read back to the same bits.
impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bit = |on: &bool| u8::from(*on);
        match self {
            Command::Common(common) => common.fmt(f),
            Command::SetLevel(Amps(level)) => write!(f, "SOUR:CURR {level:E}"),
            Command::Level(ask) => write!(f, "SOUR:CURR{ask}"),
            Command::SetRange(Amps(level)) => write!(f, "SOUR:CURR:RANG {level:E}"),
            Command::Range(ask) => write!(f, "SOUR:CURR:RANG{ask}"),
            Command::SetAutorange(on) => write!(f, "SOUR:CURR:RANG:AUTO {}", bit(on)),
            Command::Autorange => f.write_str("SOUR:CURR:RANG:AUTO?"),
            Command::SetCompliance(Volts(limit)) => write!(f, "SOUR:CURR:COMP {limit:E}"),
            Command::Compliance(ask) => write!(f, "SOUR:CURR:COMP{ask}"),
            Command::SetFilter(on) => write!(f, "SOUR:CURR:FILT {}", bit(on)),
            Command::Filter => f.write_str("SOUR:CURR:FILT?"),
            Command::ClearSource => f.write_str("SOUR:CLE"),
            Command::SetOutput(on) => write!(f, "OUTP {}", bit(on)),
            Command::Output => f.write_str("OUTP?"),
            Command::SetShield(shield) => write!(f, "OUTP:ISH {shield}"),
            Command::Shield => f.write_str("OUTP:ISH?"),
            Command::SetLowToEarth(on) => write!(f, "OUTP:LTE {}", bit(on)),
            Command::LowToEarth => f.write_str("OUTP:LTE?"),
            Command::SetSpeed(speed) => write!(f, "OUTP:RESP {speed}"),
            Command::Speed => f.write_str("OUTP:RESP?"),
            Command::Interlock => f.write_str("OUTP:INT:TRIP?"),
            Command::Events(group) => write!(f, "STAT:{group}?"),
            Command::Conditions(group) => write!(f, "STAT:{group}:COND?"),
            Command::SetEnable(group, mask) => write!(f, "STAT:{group}:ENAB {mask}"),
            Command::Enable(group) => write!(f, "STAT:{group}:ENAB?"),
            Command::PresetStatus => f.write_str("STAT:PRES"),
            Command::NextError => f.write_str("SYST:ERR?"),
            Command::ClearErrors => f.write_str("STAT:QUE:CLE"),
            Command::Version => f.write_str("SYST:VERS?"),
        }
    }
}

impl FromStr for Command {
    type Err = ParseError;

    /// Reads a message of exactly one command.
    fn from_str(text: &str) -> Result<Self, ParseError> {
        match parse_message(text).as_slice() {
            [call] => call.as_ref().map_err(|refusal| *refusal).and_then(Self::of),
            _ => Err(ParseError::Syntax),
        }
    }
}

/// Commands sent in one segment, each from the root: `SOUR:CURR 1E-3;:SOUR:CURR?;:SYST:ERR?`.
#[derive(Debug, Clone, Copy)]
pub struct Message<'a>(pub &'a [Command]);

impl fmt::Display for Message<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, command) in self.0.iter().enumerate() {
            match (k, command) {
                (0, _) => {}
                (_, Command::Common(_)) => f.write_str(";")?,
                _ => f.write_str(";:")?,
            }
            command.fmt(f)?;
        }
        Ok(())
    }
}
