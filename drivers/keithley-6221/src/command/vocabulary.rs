//! The enumerations in the arguments of commands.

use std::fmt;

#[cfg(feature = "simulator")]
use crate::kind::Kind;
use crate::kind::short;

/// The form of a numeric query: `?`, `? MIN`, `? MAX`, `? DEF`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Ask {
    /// The present value.
    Now,
    /// The smallest that can be set.
    Min,
    /// The largest that can be set.
    Max,
    /// The value after `*RST`.
    Def,
}

#[cfg(feature = "simulator")]
impl Kind {
    /// The reply to a query with MIN, MAX or DEF; `now` otherwise. Switches and words have only a present value.
    pub(crate) fn queried(self, ask: Ask, now: f64) -> f64 {
        match (self, ask) {
            (_, Ask::Now) => now,
            (_, Ask::Def) => self.reset_value(),
            (Kind::Real { limits, .. } | Kind::Whole { limits, .. }, Ask::Min) => limits[0],
            (Kind::Real { limits, .. } | Kind::Whole { limits, .. }, Ask::Max) => limits[1],
            (Kind::Switch(_) | Kind::Choice(_), Ask::Min | Ask::Max) => now,
        }
    }
}

/// The connection of the inner shield of the triax output.
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

/// A list of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum List {
    /// Levels of a list sweep, A.
    Levels,
    /// Time on each point of a list sweep, s.
    Delays,
    /// Voltage limit on each point of a list sweep, V.
    Limits,
    /// An arbitrary wave, as fractions of its amplitude.
    Wave,
}

/// A mode that measures with a 2182A.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeltaMode {
    /// Delta.
    Delta,
    /// Differential conductance.
    Conductance,
    /// Pulse delta.
    Pulse,
}

/// An address of the network port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Address {
    /// The instrument's own.
    Own,
    /// The mask of its network.
    Mask,
    /// The gateway.
    Gateway,
}

/// An element of a stored reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Element {
    /// The reading.
    Reading,
    /// Its time stamp.
    Stamp,
    /// Its unit.
    Unit,
    /// Its number.
    Number,
    /// The level.
    Source,
    /// Whether the source was in compliance.
    Compliance,
    /// The average voltage.
    AverageVoltage,
}

/// A line of the display.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Line {
    /// 20 characters.
    Upper,
    /// 32 characters.
    Lower,
}

/// One of the two circuit boards.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Board {
    /// The analogue one.
    Analogue,
    /// The digital one.
    Digital,
}

pub(super) const ASKS: [(&str, Ask); 3] = [
    ("MINimum", Ask::Min),
    ("MAXimum", Ask::Max),
    ("DEFault", Ask::Def),
];
pub(super) const SHIELDS: [(&str, Shield); 2] =
    [("OLOW", Shield::OutputLow), ("GUARd", Shield::Guard)];
pub(super) const SPEEDS: [(&str, Speed); 2] = [("FAST", Speed::Fast), ("SLOW", Speed::Slow)];
pub(super) const GROUPS: [(&str, StatusGroup); 3] = [
    ("MEASurement", StatusGroup::Measurement),
    ("OPERation", StatusGroup::Operation),
    ("QUEStionable", StatusGroup::Questionable),
];
pub(super) const MODES: [(&str, DeltaMode); 3] = [
    ("DELTa", DeltaMode::Delta),
    ("DCONductance", DeltaMode::Conductance),
    ("PDELta", DeltaMode::Pulse),
];
pub(super) const ADDRESSES: [(&str, Address); 3] = [
    ("ADDRess", Address::Own),
    ("MASK", Address::Mask),
    ("GATeway", Address::Gateway),
];
pub(super) const ELEMENTS: [(&str, Element); 7] = [
    ("READing", Element::Reading),
    ("TSTamp", Element::Stamp),
    ("UNITs", Element::Unit),
    ("RNUMber", Element::Number),
    ("SOURce", Element::Source),
    ("COMPliance", Element::Compliance),
    ("AVOLtage", Element::AverageVoltage),
];
pub(super) const BOARDS: [(&str, Board); 2] =
    [("ABOard", Board::Analogue), ("DBOard", Board::Digital)];
/// Header and length of each line of the display (622x reference manual, DISPlay subsystem \[K\]).
pub(super) const LINES: [(&str, Line, usize); 2] = [
    ("DISPlay[:WINDow]", Line::Upper, 20),
    ("DISPlay:WINDow2", Line::Lower, 32),
];
/// Headers of the lists: for setting the values, and for appending values.
pub(super) const LISTS: [(&str, &str, List); 4] = [
    (
        "[SOURce]:LIST:CURRent",
        "[SOURce]:LIST:CURRent:APPend",
        List::Levels,
    ),
    (
        "[SOURce]:LIST:DELay",
        "[SOURce]:LIST:DELay:APPend",
        List::Delays,
    ),
    (
        "[SOURce]:LIST:COMPliance",
        "[SOURce]:LIST:COMPliance:APPend",
        List::Limits,
    ),
    (
        "[SOURce]:WAVE:ARBitrary:DATA",
        "[SOURce]:WAVE:ARBitrary:APPend",
        List::Wave,
    ),
];

impl Element {
    /// The elements after `*RST`.
    pub const DEFAULT: [Element; 2] = [Element::Reading, Element::Stamp];
}

/// The short form of the notation of a value.
pub(super) fn word<T: Copy + PartialEq>(choices: &[(&'static str, T)], value: T) -> String {
    choices
        .iter()
        .find(|(_, candidate)| *candidate == value)
        .map(|(notation, _)| short(notation))
        .unwrap_or_default()
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

impl fmt::Display for DeltaMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&word(&MODES, *self))
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&word(&ADDRESSES, *self))
    }
}

impl fmt::Display for Element {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&word(&ELEMENTS, *self))
    }
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&word(&BOARDS, *self))
    }
}
