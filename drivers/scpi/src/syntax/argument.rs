//! One argument of a call, and its typed readers.

use std::fmt;

use crate::reading::{INFINITY, NOT_A_NUMBER, format_block, quote};
use crate::{Answer, ChannelList, ParseError, Unit, parse_reading};

/// A numeric argument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Numeric {
    /// A finite number, in the base unit.
    Value(f64),
    /// MIN: the smallest allowed.
    Min,
    /// MAX: the largest allowed.
    Max,
    /// DEF: the value after `*RST`.
    Def,
    /// INF or 9.9E37.
    Infinity,
    /// NINF or -9.9E37.
    NegativeInfinity,
    /// NAN or 9.91E37.
    NotANumber,
}

/// The words for limits.
const LIMITS: [(&str, Numeric); 3] = [
    ("MINimum", Numeric::Min),
    ("MAXimum", Numeric::Max),
    ("DEFault", Numeric::Def),
];

impl Numeric {
    /// The value, with MIN, MAX and DEF replaced, if it lies between `min` and `max`.
    ///
    /// # Errors
    /// -222 for a value that is outside, infinite, or not a number.
    pub fn within(self, min: f64, max: f64, def: f64) -> Result<f64, ParseError> {
        let value = match self {
            Numeric::Value(value) => value,
            Numeric::Min => min,
            Numeric::Max => max,
            Numeric::Def => def,
            Numeric::Infinity | Numeric::NegativeInfinity | Numeric::NotANumber => f64::NAN,
        };
        if (min..=max).contains(&value) {
            Ok(value)
        } else {
            Err(ParseError::OutOfRange)
        }
    }
}

impl fmt::Display for Numeric {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            // The shortest text that reads back to the same bits.
            Numeric::Value(value) => write!(f, "{value:E}"),
            Numeric::Min => f.write_str("MIN"),
            Numeric::Max => f.write_str("MAX"),
            Numeric::Def => f.write_str("DEF"),
            Numeric::Infinity => f.write_str("INF"),
            Numeric::NegativeInfinity => f.write_str("NINF"),
            Numeric::NotANumber => f.write_str("NAN"),
        }
    }
}

/// One argument of a call, as it was written.
#[derive(Debug, Clone, PartialEq)]
pub enum Argument {
    /// A decimal or `#H`, `#Q`, `#B` number; `suffix` is its unit, as written.
    Number {
        /// The number before its unit is applied.
        value: f64,
        /// The unit, if one was written.
        suffix: Option<String>,
    },
    /// A word: `MIN`, `ON`, `OLOW`.
    Word(String),
    /// A string, without its quotes.
    Text(String),
    /// The content of a definite block.
    Block(Vec<u8>),
    /// An expression with its parentheses, such as a channel list.
    Expression(String),
}

impl Argument {
    /// Reads a number of this quantity, in its base unit.
    ///
    /// # Errors
    /// -131 and -138 for the unit, -148, -158, -168, -178 for another type.
    pub fn number(&self, unit: Unit) -> Result<Numeric, ParseError> {
        match self {
            Argument::Number { value, suffix } => {
                let value = match suffix {
                    Some(suffix) => unit.scale(*value, suffix)?,
                    None => *value,
                };
                if (value.abs() / NOT_A_NUMBER - 1.0).abs() < 1e-5 {
                    Ok(Numeric::NotANumber)
                } else if value >= INFINITY {
                    Ok(Numeric::Infinity)
                } else if value <= -INFINITY {
                    Ok(Numeric::NegativeInfinity)
                } else {
                    Ok(Numeric::Value(value))
                }
            }
            Argument::Word(word) => self.choice(&LIMITS).or_else(|_| match parse_reading(word) {
                Ok(Answer::Overload { negative: false }) => Ok(Numeric::Infinity),
                Ok(Answer::Overload { negative: true }) => Ok(Numeric::NegativeInfinity),
                Ok(Answer::NotANumber) => Ok(Numeric::NotANumber),
                Ok(Answer::Value(_)) | Err(_) => Err(ParseError::CharacterNotAllowed),
            }),
            other => Err(other.not_allowed()),
        }
    }

    /// Reads a plain number, rounded to the nearest integer (IEEE 488.2 section 7.7.2.4), between `min` and `max`.
    ///
    /// # Errors
    /// As [`Argument::number`], and -222 outside the limits.
    pub fn integer(&self, min: i64, max: i64) -> Result<i64, ParseError> {
        let rounded = match self.number(Unit::None)? {
            Numeric::Value(value) => value.round(),
            Numeric::Min => return Ok(min),
            Numeric::Max => return Ok(max),
            _ => return Err(ParseError::OutOfRange),
        };
        // Beyond 2^53 neighbouring integers have the same floating-point value; no limit is that large.
        if rounded.abs() > 9e15 || !(min..=max).contains(&(rounded as i64)) {
            return Err(ParseError::OutOfRange);
        }
        Ok(rounded as i64)
    }

    /// Reads a boolean: ON, OFF, or a number, which is true unless it rounds to 0 (SCPI-99 volume 1, section 7.3).
    ///
    /// # Errors
    /// -224 for another word, -138 for a number with a unit, -158, -168, -178 for another type.
    pub fn boolean(&self) -> Result<bool, ParseError> {
        match self {
            Argument::Number {
                value,
                suffix: None,
            } => Ok(value.round() != 0.0),
            Argument::Number { .. } => Err(ParseError::SuffixNotAllowed),
            Argument::Word(word) if word.eq_ignore_ascii_case("ON") => Ok(true),
            Argument::Word(word) if word.eq_ignore_ascii_case("OFF") => Ok(false),
            Argument::Word(_) => Err(ParseError::IllegalParameter),
            other => Err(other.not_allowed()),
        }
    }

    /// Reads one of a few words, each given in the notation of manuals (`GUARd`).
    ///
    /// # Errors
    /// -224 for another word, -128, -158, -168, -178 for another type.
    pub fn choice<T: Copy>(&self, choices: &[(&str, T)]) -> Result<T, ParseError> {
        let word = self.word()?;
        choices
            .iter()
            .find(|(notation, _)| {
                let short: String = notation
                    .chars()
                    .filter(|c| !c.is_ascii_lowercase())
                    .collect();
                word.eq_ignore_ascii_case(notation) || word.eq_ignore_ascii_case(&short)
            })
            .map(|(_, chosen)| *chosen)
            .ok_or(ParseError::IllegalParameter)
    }

    /// Reads a word as written.
    ///
    /// # Errors
    /// -128, -158, -168, -178 for another type.
    pub fn word(&self) -> Result<&str, ParseError> {
        match self {
            Argument::Word(word) => Ok(word),
            other => Err(other.not_allowed()),
        }
    }

    /// Reads a string, without its quotes.
    ///
    /// # Errors
    /// -128, -148, -168, -178 for another type.
    pub fn string(&self) -> Result<&str, ParseError> {
        match self {
            Argument::Text(text) => Ok(text),
            other => Err(other.not_allowed()),
        }
    }

    /// Reads a definite block.
    ///
    /// # Errors
    /// -128, -148, -158, -178 for another type.
    pub fn block(&self) -> Result<&[u8], ParseError> {
        match self {
            Argument::Block(data) => Ok(data),
            other => Err(other.not_allowed()),
        }
    }

    /// Reads a channel list `(@1001,1003:1010)`.
    ///
    /// # Errors
    /// -171 for another expression, -128, -148, -158, -168 for another type.
    pub fn channels(&self) -> Result<ChannelList, ParseError> {
        match self {
            Argument::Expression(text) => text.parse(),
            other => Err(other.not_allowed()),
        }
    }

    /// The error for this type of argument where another type is required.
    fn not_allowed(&self) -> ParseError {
        match self {
            Argument::Number { .. } => ParseError::NumericNotAllowed,
            Argument::Word(_) => ParseError::CharacterNotAllowed,
            Argument::Text(_) => ParseError::StringNotAllowed,
            Argument::Block(_) => ParseError::BlockNotAllowed,
            Argument::Expression(_) => ParseError::ExpressionNotAllowed,
        }
    }
}

/// Writes the argument so that parsing gives the same value. A block with bytes that are not text is shown with
/// replacement characters; [`format_block`](crate::format_block) writes bytes.
impl fmt::Display for Argument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Argument::Number { value, suffix } => {
                write!(f, "{value:E}")?;
                match suffix {
                    Some(suffix) => write!(f, " {suffix}"),
                    None => Ok(()),
                }
            }
            Argument::Word(word) => f.write_str(word),
            Argument::Text(text) => f.write_str(&quote(text)),
            Argument::Block(data) => f.write_str(&String::from_utf8_lossy(&format_block(data))),
            Argument::Expression(text) => f.write_str(text),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::parse_message;
    use crate::syntax::argument::*;

    fn argument(text: &str) -> Argument {
        let call = parse_message(format!("X {text}")).remove(0).unwrap();
        call.arguments[0].clone()
    }

    #[test]
    fn words_stand_for_limits_and_infinities() {
        for (text, meant) in [
            ("min", Numeric::Min),
            ("MAXIMUM", Numeric::Max),
            ("Def", Numeric::Def),
            ("INF", Numeric::Infinity),
            ("NINF", Numeric::NegativeInfinity),
            ("nan", Numeric::NotANumber),
            ("9.9E37", Numeric::Infinity),
            ("-9.9e37", Numeric::NegativeInfinity),
            ("9.91E37", Numeric::NotANumber),
        ] {
            assert_eq!(argument(text).number(Unit::Volt), Ok(meant), "{text}");
        }
        assert_eq!(
            argument("MAXI").number(Unit::Volt),
            Err(ParseError::CharacterNotAllowed)
        );
        assert_eq!(
            Numeric::Infinity.within(0.0, 1.0, 0.0),
            Err(ParseError::OutOfRange)
        );
    }

    #[test]
    fn other_types_are_refused_by_their_own_number() {
        assert_eq!(
            argument("'ON'").boolean(),
            Err(ParseError::StringNotAllowed)
        );
        assert_eq!(argument("2").word(), Err(ParseError::NumericNotAllowed));
        assert_eq!(
            argument("(@1)").block(),
            Err(ParseError::ExpressionNotAllowed)
        );
        assert_eq!(argument("#11a").string(), Err(ParseError::BlockNotAllowed));
        assert_eq!(
            argument("MAYBE").boolean(),
            Err(ParseError::IllegalParameter)
        );
        assert_eq!(argument("0.4").boolean(), Ok(false));
    }

    #[test]
    fn integers_round_and_stay_in_their_limits() {
        assert_eq!(argument("31.6").integer(0, 255), Ok(32));
        assert_eq!(argument("#HFF").integer(0, 255), Ok(255));
        assert_eq!(argument("256").integer(0, 255), Err(ParseError::OutOfRange));
        assert_eq!(
            argument("1e30").integer(0, 255),
            Err(ParseError::OutOfRange)
        );
    }

    #[test]
    fn a_choice_takes_long_or_short_forms() {
        let shield = |text: &str| argument(text).choice(&[("OLOW", 1), ("GUARd", 2)]);
        assert_eq!(shield("olow"), Ok(1));
        assert_eq!(shield("guard"), Ok(2));
        assert_eq!(shield("guar"), Ok(2));
        assert_eq!(shield("gua"), Err(ParseError::IllegalParameter));
    }
}
