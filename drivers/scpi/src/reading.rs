//! The client's side: writes numbers, strings and blocks as text, and parses replies.

/// The value that SCPI uses for an infinite or overloaded value (SCPI-99 volume 1, section 7.2.1.4).
pub const INFINITY: f64 = 9.9e37;
/// The value that SCPI uses for "not a number" (SCPI-99 volume 1, section 7.2.1.5).
pub const NOT_A_NUMBER: f64 = 9.91e37;

/// One number of a reply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Answer {
    /// A finite number.
    Value(f64),
    /// 9.9E37: beyond the range, or infinite.
    Overload {
        /// Whether the value was negative.
        negative: bool,
    },
    /// 9.91E37: no value.
    NotANumber,
}

impl Answer {
    /// The value, if it is a finite number.
    pub fn value(self) -> Option<f64> {
        match self {
            Answer::Value(value) => Some(value),
            Answer::Overload { .. } | Answer::NotANumber => None,
        }
    }
}

/// A reply that does not have the expected form.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{text}' is not {expected}")]
pub struct ReplyError {
    /// The reply, shortened.
    pub text: String,
    /// The expected form, in words.
    pub expected: String,
}

impl ReplyError {
    /// Creates the error from the reply and a description of what was expected.
    pub fn new(text: &str, expected: impl Into<String>) -> Self {
        const MOST: usize = 60;
        let mut shown: String = text.chars().take(MOST).collect();
        if shown.len() < text.len() {
            shown.push_str("...");
        }
        Self {
            text: shown,
            expected: expected.into(),
        }
    }
}

/// Reads one number: NR1, NR2, NR3, or the words INF, NINF and NAN.
///
/// ```
/// use scpi::{Answer, parse_reading};
/// assert_eq!(parse_reading("+1.25000000E-03"), Ok(Answer::Value(1.25e-3)));
/// assert_eq!(parse_reading("-9.90000000E+37"), Ok(Answer::Overload { negative: true }));
/// assert!(parse_reading("1.2.3").is_err());
/// ```
///
/// # Errors
/// Anything else, the empty reply included.
pub fn parse_reading(text: &str) -> Result<Answer, ReplyError> {
    let trimmed = text.trim();
    let unsigned = trimmed.strip_prefix(['+', '-']).unwrap_or(trimmed);
    let negative = trimmed.starts_with('-');
    if unsigned.eq_ignore_ascii_case("INF") || unsigned.eq_ignore_ascii_case("INFINITY") {
        return Ok(Answer::Overload { negative });
    }
    if trimmed.eq_ignore_ascii_case("NINF") {
        return Ok(Answer::Overload { negative: true });
    }
    if unsigned.eq_ignore_ascii_case("NAN") {
        return Ok(Answer::NotANumber);
    }
    let value = plain_number(trimmed).ok_or_else(|| ReplyError::new(text, "a number"))?;
    Ok(classify(value))
}

/// Classifies a number as value, overload or not-a-number by the reserved magnitudes.
fn classify(value: f64) -> Answer {
    // A voltmeter with fewer digits may print 9.91E37 as 9.910000E+37: the comparison tolerates a difference in the
    // last digit.
    if (value.abs() / NOT_A_NUMBER - 1.0).abs() < 1e-5 {
        Answer::NotANumber
    } else if value.abs() >= INFINITY * (1.0 - 1e-6) {
        Answer::Overload {
            negative: value < 0.0,
        }
    } else {
        Answer::Value(value)
    }
}

/// A decimal number of IEEE 488.2 (NRf) and nothing else: Rust's own parser also accepts `inf`, `nan` and `infinity`.
pub(crate) fn plain_number(text: &str) -> Option<f64> {
    let numeric = |b: u8| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.' | b'e' | b'E');
    if !text.bytes().all(numeric) {
        return None;
    }
    text.parse().ok()
}

/// Reads a list of numbers joined by commas.
///
/// # Errors
/// The first item that is not a number; an empty list.
pub fn parse_readings(text: &str) -> Result<Vec<Answer>, ReplyError> {
    text.split(',').map(parse_reading).collect()
}

/// Reads an integer, with or without a plus sign.
///
/// # Errors
/// Anything else.
pub fn parse_integer(text: &str) -> Result<i64, ReplyError> {
    text.trim()
        .parse()
        .map_err(|_| ReplyError::new(text, "an integer"))
}

/// Reads a boolean: 0 or 1, with or without a plus sign.
///
/// # Errors
/// Anything else.
pub fn parse_boolean(text: &str) -> Result<bool, ReplyError> {
    let trimmed = text.trim();
    match trimmed.strip_prefix('+').unwrap_or(trimmed) {
        "0" => Ok(false),
        "1" => Ok(true),
        _ => Err(ReplyError::new(text, "0 or 1")),
    }
}

/// Writes a number as NR3, `1.000000E-06` for 6 decimals. An infinite value becomes 9.9E37 with its sign, NaN
/// becomes 9.91E37.
pub fn format_nr3(value: f64, decimals: usize) -> String {
    let reserved = if value.is_nan() {
        NOT_A_NUMBER
    } else if value.is_infinite() {
        INFINITY.copysign(value)
    } else {
        value
    };
    // Negative zero would print a sign that no instrument prints.
    let plain = format!("{:.*E}", decimals, reserved + 0.0);
    let (mantissa, exponent) = plain.split_once('E').unwrap_or((&plain, "0"));
    match exponent.strip_prefix('-') {
        Some(digits) => format!("{mantissa}E-{digits:0>2}"),
        None => format!("{mantissa}E+{exponent:0>2}"),
    }
}

/// Writes a number as NR3 with its sign always: `+1.25000000E-03` for 8 decimals.
pub fn format_nr3_signed(value: f64, decimals: usize) -> String {
    let plain = format_nr3(value, decimals);
    if plain.starts_with('-') {
        plain
    } else {
        format!("+{plain}")
    }
}

/// Writes a string in double quotes, quotes inside doubled.
pub fn quote(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}

/// Parses a string in double or single quotes; `None` if it is not quoted, or if a quote inside is not doubled.
pub fn unquote(text: &str) -> Option<String> {
    let mark = text.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    let inside = text.strip_prefix(mark)?.strip_suffix(mark)?;
    let doubled = [mark, mark].iter().collect::<String>();
    let single = mark.to_string();
    if inside.replace(&doubled, "").contains(mark) {
        return None;
    }
    Some(inside.replace(&doubled, &single))
}

/// Writes a definite block: `#214(@1001,1002)`.
///
/// ```
/// assert_eq!(scpi::format_block(b"(@1001,1002)"), b"#212(@1001,1002)");
/// ```
pub fn format_block(data: &[u8]) -> Vec<u8> {
    let length = data.len().to_string();
    let mut block = format!("#{}{length}", length.len()).into_bytes();
    block.extend_from_slice(data);
    block
}

/// Parses a reply that is one definite block.
///
/// # Errors
/// A reply that is not a block, or a block whose length and content disagree.
pub fn parse_block(reply: &[u8]) -> Result<&[u8], ReplyError> {
    let data = split_block(reply)
        .filter(|(_, rest)| rest.is_empty())
        .map(|(data, _)| data);
    data.ok_or_else(|| ReplyError::new(&String::from_utf8_lossy(reply), "a definite block"))
}

/// Splits a definite block off the front.
pub(crate) fn split_block(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let rest = bytes.strip_prefix(b"#")?;
    let (&digits, rest) = rest.split_first()?;
    let digits = match digits {
        b'1'..=b'9' => usize::from(digits - b'0'),
        _ => return None,
    };
    let (length, rest) = rest.split_at_checked(digits)?;
    if !length.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let length: usize = std::str::from_utf8(length).ok()?.parse().ok()?;
    rest.split_at_checked(length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_the_instruments_do() {
        assert_eq!(format_nr3(1e-6, 6), "1.000000E-06");
        assert_eq!(format_nr3(-0.105, 6), "-1.050000E-01");
        assert_eq!(format_nr3(0.0, 6), "0.000000E+00");
        assert_eq!(format_nr3(-0.0, 6), "0.000000E+00");
        assert_eq!(format_nr3(f64::INFINITY, 6), "9.900000E+37");
        assert_eq!(format_nr3_signed(f64::INFINITY, 8), "+9.90000000E+37");
        assert_eq!(format_nr3_signed(1e-300, 1), "+1.0E-300");
        assert_eq!(format_nr3_signed(f64::NAN, 8), "+9.91000000E+37");
    }

    #[test]
    fn what_is_beyond_the_range_is_never_a_number() {
        for text in ["9.9E37", "+9.90000000E+37", "INF", "1e40", "+9.900000E+37"] {
            assert_eq!(
                parse_reading(text),
                Ok(Answer::Overload { negative: false }),
                "{text}"
            );
        }
        for text in ["9.91E37", "+9.91000000E+37", "NAN", "-NaN"] {
            assert_eq!(parse_reading(text), Ok(Answer::NotANumber), "{text}");
        }
        assert_eq!(
            parse_readings("-INF,NINF,-9.9E+37").unwrap(),
            [Answer::Overload { negative: true }; 3]
        );
        assert!(parse_reading("1e400").unwrap().value().is_none());
    }

    #[test]
    fn what_is_no_reply_is_refused() {
        for text in [
            "", " ", "1,", "x", "1 V", "0x1", "infinite", "1e", "--1", "1_0",
        ] {
            assert!(parse_readings(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_value_has_at_most_one_sign() {
        for text in [
            "+-INF",
            "--INF",
            "++INFINITY",
            "+-NAN",
            "+NINF",
            "+-1",
            "++9.9E37",
        ] {
            assert!(parse_reading(text).is_err(), "{text}");
        }
        for text in ["++1", "++0", "+-1", "-1", "+", ""] {
            assert!(parse_boolean(text).is_err(), "{text}");
        }
        assert_eq!(
            ["0", "+0", "1", "+1"].map(parse_boolean),
            [Ok(false), Ok(false), Ok(true), Ok(true)]
        );
    }

    #[test]
    fn blocks_come_and_go() {
        assert_eq!(parse_block(b"#13(@)"), Ok(&b"(@)"[..]));
        for bytes in [
            &b"#"[..],
            b"#0",
            b"#1",
            b"#19abc",
            b"#13(@)x",
            b"#2+1a",
            b"13",
        ] {
            assert!(parse_block(bytes).is_err(), "{bytes:?}");
        }
    }

    #[test]
    fn quotes_inside_are_doubled() {
        assert_eq!(unquote("\"a\"\"b\""), Some("a\"b".to_owned()));
        assert_eq!(unquote("'it''s'"), Some("it's".to_owned()));
        for text in ["", "\"", "a", "\"a", "\"a\"b\"", "\"a'"] {
            assert_eq!(unquote(text), None, "{text}");
        }
    }
}
