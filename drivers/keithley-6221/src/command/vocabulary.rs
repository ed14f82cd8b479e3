//! The enumerations in the arguments of commands.

use std::fmt;

#[cfg(feature = "simulator")]
use crate::kind::Kind;
use crate::kind::short;

/// An enumeration, the table of its words in the manual's notation, and its `Display`, which writes the short form.
macro_rules! vocabulary {
    ($(#[$about:meta])* $name:ident as $table:ident { $($(#[$of:meta])* $variant:ident = $word:literal,)+ }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[$of])* $variant,)+
        }

        pub(super) const $table: [(&str, $name); [$($word),+].len()] =
            [$(($word, $name::$variant)),+];

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&short(match self {
                    $($name::$variant => $word,)+
                }))
            }
        }
    };
}

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
    /// The reply to a query with MIN, MAX or DEF; `now` otherwise. Switches and choices have only a present value and a
    /// reset value.
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

vocabulary! {
    /// The connection of the inner shield of the triax output.
    Shield as SHIELDS {
        /// Output low (after `*RST`).
        OutputLow = "OLOW",
        /// The guard.
        Guard = "GUARd",
    }
}

vocabulary! {
    /// How fast the output responds.
    Speed as SPEEDS {
        /// Settles within 2 to 90 us.
        Fast = "FAST",
        /// Settles within 100 us, for inductive loads.
        Slow = "SLOW",
    }
}

vocabulary! {
    /// A group of status registers.
    StatusGroup as GROUPS {
        /// Interlock, compliance, buffer.
        Measurement = "MEASurement",
        /// Sweeps and triggers.
        Operation = "OPERation",
        /// Power and calibration.
        Questionable = "QUEStionable",
    }
}

/// A list of values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum List {
    /// Levels of a list sweep, A.
    Levels,
    /// Duration of each point of a list sweep, s.
    Delays,
    /// Voltage limit at each point of a list sweep, V.
    Limits,
    /// An arbitrary wave, as fractions of its amplitude.
    Wave,
}

vocabulary! {
    /// A mode that measures with a 2182A.
    DeltaMode as MODES {
        /// Delta.
        Delta = "DELTa",
        /// Differential conductance.
        Conductance = "DCONductance",
        /// Pulse delta.
        Pulse = "PDELta",
    }
}

vocabulary! {
    /// An address of the network port.
    Address as ADDRESSES {
        /// The instrument's own.
        Own = "ADDRess",
        /// The mask of its network.
        Mask = "MASK",
        /// The gateway.
        Gateway = "GATeway",
    }
}

vocabulary! {
    /// An element of a stored reading.
    Element as ELEMENTS {
        /// The reading.
        Reading = "READing",
        /// The time stamp of the reading.
        Stamp = "TSTamp",
        /// The unit of the reading.
        Unit = "UNITs",
        /// The number of the reading.
        Number = "RNUMber",
        /// The level of the source.
        Source = "SOURce",
        /// Whether the source was in compliance.
        Compliance = "COMPliance",
        /// The average voltage.
        AverageVoltage = "AVOLtage",
    }
}

/// A line of the display.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Line {
    /// 20 characters.
    Upper,
    /// 32 characters.
    Lower,
}

vocabulary! {
    /// One of the two circuit boards.
    Board as BOARDS {
        /// The analogue one.
        Analogue = "ABOard",
        /// The digital one.
        Digital = "DBOard",
    }
}

pub(super) const ASKS: [(&str, Ask); 3] = [
    ("MINimum", Ask::Min),
    ("MAXimum", Ask::Max),
    ("DEFault", Ask::Def),
];
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
