//! The values that a setting takes, and their text form.

use scpi::{Argument, Numeric, ParseError, Unit, format_nr3};

/// Decimals of a number read back: `1.000000E-06` (fact sheet, section 3).
pub(crate) const DECIMALS: usize = 6;

/// The values that a parameter takes. Every value is an `f64`: the number in base units, [`f64::INFINITY`] for INF, 0
/// or 1 for a switch, the index of the word for a choice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kind {
    /// A real number, read back in exponent form.
    Real {
        /// Unit that may follow the number.
        unit: Unit,
        /// Smallest, largest and reset value.
        limits: [f64; 3],
        /// Whether INF is allowed.
        endless: bool,
    },
    /// A whole number.
    Whole {
        /// Smallest, largest and reset value.
        limits: [f64; 3],
        /// Whether INF is allowed.
        endless: bool,
    },
    /// On or off, with its reset value.
    Switch(bool),
    /// One of these words; the first is the reset value.
    Choice(&'static [&'static str]),
}

impl Kind {
    /// Reads an argument.
    ///
    /// # Errors
    /// -222 outside the limits, -224 for an unknown word, or the error for an argument of another type.
    pub fn read(self, argument: &Argument) -> Result<f64, ParseError> {
        let number = |unit, [min, max, def]: [f64; 3], endless| match argument.number(unit)? {
            Numeric::Infinity if endless => Ok(f64::INFINITY),
            Numeric::Def => Ok(def),
            value => value.within(min, max, def),
        };
        match self {
            Kind::Real {
                unit,
                limits,
                endless,
            } => match argument.number(unit)? {
                // A limit is read back with six decimals, and that text must be accepted as a setting.
                Numeric::Value(value) if reads_back_as(limits[1], value) => Ok(limits[1]),
                Numeric::Value(value) if reads_back_as(limits[0], value) => Ok(limits[0]),
                _ => number(unit, limits, endless),
            },
            Kind::Whole { limits, endless } => number(Unit::None, limits, endless).map(f64::round),
            Kind::Switch(_) => argument.boolean().map(|on| f64::from(u8::from(on))),
            Kind::Choice(words) => {
                let places: Vec<(&str, f64)> =
                    words.iter().copied().zip((0u8..).map(f64::from)).collect();
                argument.choice(&places)
            }
        }
    }

    /// The value in the instrument's reply.
    pub(crate) fn read_back(self, value: f64) -> String {
        match self {
            Kind::Real { .. } => format_nr3(value, DECIMALS),
            Kind::Whole { .. } if value.is_infinite() => format_nr3(value, DECIMALS),
            Kind::Whole { .. } | Kind::Switch(_) => format!("{value:.0}"),
            // the value of a choice is an index of its words
            Kind::Choice(words) => short(words[value as usize]),
        }
    }

    /// The value in a client's command: the fewest digits that parse to the same bits.
    pub(crate) fn written(self, value: f64) -> String {
        match self {
            Kind::Real { .. } | Kind::Whole { .. } if value.is_infinite() => "INF".to_owned(),
            Kind::Real { .. } => format!("{value:E}"),
            Kind::Whole { .. } | Kind::Switch(_) | Kind::Choice(_) => self.read_back(value),
        }
    }

    /// The value after `*RST`.
    pub fn reset_value(self) -> f64 {
        match self {
            Kind::Real {
                limits: [.., def], ..
            }
            | Kind::Whole {
                limits: [.., def], ..
            } => def,
            Kind::Switch(on) => f64::from(u8::from(on)),
            Kind::Choice(_) => 0.0,
        }
    }

    /// Whether queries with MIN, MAX and DEF are allowed.
    pub(crate) fn is_number(self) -> bool {
        matches!(self, Kind::Real { .. } | Kind::Whole { .. })
    }
}

/// Whether a value equals a limit rounded to the decimals of a reply.
fn reads_back_as(limit: f64, value: f64) -> bool {
    format_nr3(limit, DECIMALS).parse() == Ok(value)
}

/// A notation in short form from the root: `[SOURce]:WAVE:DURation:TIME` gives `SOUR:WAVE:DUR:TIME`. Optional nodes are
/// left out, except a leading one.
pub(crate) fn short(notation: &str) -> String {
    let mut written = String::new();
    let mut left_out = false;
    for (at, c) in notation.char_indices() {
        match c {
            '[' => left_out = at > 0,
            ']' => left_out = false,
            c if left_out || c.is_ascii_lowercase() => {}
            c => written.push(c),
        }
    }
    written
}
