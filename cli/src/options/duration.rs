//! Spans of time as a person writes them: `500ms`, `10s`, `5m`, `2h`, `1h30m`, `1d`.

use std::time::Duration;

/// Why a text is not a span of time.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SpanError {
    /// Nothing was written.
    #[error("a duration is missing; write for example 10s, 5m, 2h")]
    Empty,
    /// A number without a unit.
    #[error("'{0}' has no unit; write for example {0}s or {0}m")]
    NoUnit(String),
    /// An unknown unit.
    #[error("'{unit}' in '{text}' is not a unit of time; ms, s, m, h and d are")]
    Unit {
        /// The whole text.
        text: String,
        /// The unknown part.
        unit: String,
    },
    /// The number before the unit cannot be read.
    #[error("'{text}' has no number before '{unit}'; write for example 10s, 5m, 2h")]
    Number {
        /// The whole text.
        text: String,
        /// The unit that stands alone.
        unit: String,
    },
    /// Zero, or more than the clock can count.
    #[error("'{0}' is not a usable duration; it must be more than zero and less than 100 years")]
    Range(String),
}

/// Reads a span: one or more numbers (a decimal point is allowed), each with its unit `ms`, `s`, `m` (or `min`), `h`, `d`.
///
/// # Errors
/// Says which part is not understood; zero is refused.
///
/// ```
/// use std::time::Duration;
/// assert_eq!(cli::parse_span("1h30m"), Ok(Duration::from_secs(5400)));
/// ```
pub fn parse_span(text: &str) -> Result<Duration, SpanError> {
    let trimmed = text.trim();
    if trimmed.is_empty() {
        return Err(SpanError::Empty);
    }
    let mut rest = trimmed;
    let mut seconds = 0.0_f64;
    while !rest.is_empty() {
        let digits = rest
            .find(|c: char| !c.is_ascii_digit() && c != '.')
            .unwrap_or(rest.len());
        let (number, tail) = rest.split_at(digits);
        let tail = tail.trim_start();
        let letters = tail
            .find(|c: char| c.is_ascii_digit() || c == '.' || c.is_whitespace())
            .unwrap_or(tail.len());
        let (unit, tail) = tail.split_at(letters);
        if unit.is_empty() {
            return Err(SpanError::NoUnit(number.to_owned()));
        }
        let scale = match unit {
            "ms" => 1e-3,
            "s" | "sec" => 1.0,
            "m" | "min" => 60.0,
            "h" => 3_600.0,
            "d" => 86_400.0,
            _ => {
                return Err(SpanError::Unit {
                    text: trimmed.to_owned(),
                    unit: unit.to_owned(),
                });
            }
        };
        let number: f64 = number.parse().map_err(|_| SpanError::Number {
            text: trimmed.to_owned(),
            unit: unit.to_owned(),
        })?;
        seconds += number * scale;
        rest = tail.trim_start();
    }
    if !(seconds > 0.0 && seconds < survey::LONGEST_S) {
        return Err(SpanError::Range(trimmed.to_owned()));
    }
    Ok(survey::duration(seconds))
}

/// Writes a span shortly: `850 ms`, `12.5 s`, `3 min 20 s`, `2 h 5 min`.
pub(crate) fn display_span(span: Duration) -> String {
    let seconds = span.as_secs_f64();
    if seconds < 1.0 {
        return format!("{:.0} ms", seconds * 1e3);
    }
    if seconds < 60.0 {
        return format!("{seconds:.1} s");
    }
    let whole = seconds.round() as u64;
    if whole < 3_600 {
        return format!("{} min {} s", whole / 60, whole % 60);
    }
    format!("{} h {} min", whole / 3_600, whole % 3_600 / 60)
}

/// Writes a time that may be long, with one unit: `1.4 s`, `1.5 min`, `2.0 h`, `40.0 d`.
pub(crate) fn display_long(seconds: f64) -> String {
    match seconds.abs() {
        short if short < 60.0 => format!("{seconds:.1} s"),
        short if short < 3_600.0 => format!("{:.1} min", seconds / 60.0),
        short if short < 2.0 * 86_400.0 => format!("{:.1} h", seconds / 3_600.0),
        _ => format!("{:.1} d", seconds / 86_400.0),
    }
}

#[cfg(test)]
mod tests {
    use crate::options::duration::*;

    #[test]
    fn what_a_person_writes_is_understood() {
        for (text, millis) in [
            ("10s", 10_000),
            ("500ms", 500),
            ("5m", 300_000),
            ("5min", 300_000),
            ("2h", 7_200_000),
            ("1h30m", 5_400_000),
            ("1h 30m", 5_400_000),
            ("0.5 s", 500),
            ("1d", 86_400_000),
        ] {
            assert_eq!(
                parse_span(text),
                Ok(Duration::from_millis(millis)),
                "{text}"
            );
        }
    }

    #[test]
    fn what_is_not_understood_is_named() {
        assert_eq!(parse_span(""), Err(SpanError::Empty));
        assert_eq!(parse_span("10"), Err(SpanError::NoUnit("10".into())));
        assert_eq!(parse_span("0s"), Err(SpanError::Range("0s".into())));
        assert!(
            matches!(parse_span("10 weeks"), Err(SpanError::Unit { unit, .. }) if unit == "weeks")
        );
        assert!(matches!(
            parse_span("1.2.3s"),
            Err(SpanError::Number { .. })
        ));
        assert!(matches!(parse_span("s"), Err(SpanError::Number { .. })));
        assert!(matches!(parse_span("-5s"), Err(SpanError::Unit { .. })));
        assert!(matches!(parse_span("99999999h"), Err(SpanError::Range(_))));
    }

    #[test]
    fn spans_are_shown_shortly() {
        assert_eq!(display_span(Duration::from_millis(850)), "850 ms");
        assert_eq!(display_span(Duration::from_millis(12_500)), "12.5 s");
        assert_eq!(display_span(Duration::from_secs(200)), "3 min 20 s");
        assert_eq!(display_span(Duration::from_secs(7_500)), "2 h 5 min");
    }
}
