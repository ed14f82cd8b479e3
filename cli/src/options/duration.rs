//! Durations as people write them: `500ms`, `10s`, `5m`, `2h`, `1h30m`, `1d`.

use std::time::Duration;

/// Errors of durations.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SpanError {
    /// It cannot be parsed.
    #[error("'{text}' is not a duration ({cause}); write for example 10s, 5m, 2h")]
    Text {
        /// The text.
        text: String,
        /// What is wrong with it.
        cause: humantime::DurationError,
    },
    /// Zero, or more than the maximum.
    #[error("'{0}' is not a usable duration; it must be more than zero and less than 100 years")]
    Range(String),
}

/// Parses a duration: one or more numbers (a decimal point is allowed), each with its unit: `ms`, `s`, `m` or `min`,
/// `h`, `d`, and the others of the crate humantime.
///
/// # Errors
/// A text that cannot be parsed; zero, or 100 years or more.
///
/// ```
/// use std::time::Duration;
/// assert_eq!(cli::parse_span("1h30m"), Ok(Duration::from_secs(5400)));
/// ```
pub fn parse_span(text: &str) -> Result<Duration, SpanError> {
    let span = humantime::parse_duration(text.trim()).map_err(|cause| SpanError::Text {
        text: text.to_owned(),
        cause,
    })?;
    if span.is_zero() || span.as_secs_f64() >= survey::LONGEST_S {
        return Err(SpanError::Range(text.trim().to_owned()));
    }
    Ok(span)
}

/// Formats a duration briefly: `850 ms`, `12.5 s`, `3 min 20 s`, `2 h 5 min`.
pub(crate) fn display_span(span: Duration) -> String {
    let seconds = span.as_secs_f64();
    // limits of the rounded numbers: neither 1000 ms nor 60.0 s is written
    if seconds < 0.9995 {
        return format!("{:.0} ms", seconds * 1e3);
    }
    if seconds < 59.95 {
        return format!("{seconds:.1} s");
    }
    let whole = seconds.round() as u64;
    if whole < 3_600 {
        return format!("{} min {} s", whole / 60, whole % 60);
    }
    format!("{} h {} min", whole / 3_600, whole % 3_600 / 60)
}

/// Formats a possibly long time with one unit: `1.4 s`, `1.5 min`, `2.0 h`, `40.0 d`.
pub(crate) fn display_long(seconds: f64) -> String {
    // limits of the rounded numbers: neither 60.0 s nor 60.0 min is written
    match seconds.abs() {
        short if short < 59.95 => format!("{seconds:.1} s"),
        short if short < 59.95 * 60.0 => format!("{:.1} min", seconds / 60.0),
        short if short < 47.95 * 3_600.0 => format!("{:.1} h", seconds / 3_600.0),
        _ => format!("{:.1} d", seconds / 86_400.0),
    }
}

#[cfg(test)]
mod tests {
    use crate::options::duration::*;

    #[test]
    fn durations_are_read_with_their_units() {
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
    fn text_that_is_no_duration_is_refused_by_name() {
        for text in ["", "10", "10 fortnights", "1.2.3s", "s", "-5s"] {
            assert!(
                matches!(parse_span(text), Err(SpanError::Text { text: named, .. }) if named == text),
                "{text}"
            );
        }
        assert_eq!(parse_span("0s"), Err(SpanError::Range("0s".into())));
        assert!(matches!(parse_span("99999999h"), Err(SpanError::Range(_))));
    }

    #[test]
    fn durations_are_written_with_two_units() {
        assert_eq!(display_span(Duration::from_millis(850)), "850 ms");
        assert_eq!(display_span(Duration::from_millis(12_500)), "12.5 s");
        assert_eq!(display_span(Duration::from_micros(999_600)), "1.0 s");
        assert_eq!(display_span(Duration::from_millis(59_960)), "1 min 0 s");
        assert_eq!(display_span(Duration::from_secs(200)), "3 min 20 s");
        assert_eq!(display_span(Duration::from_secs(7_500)), "2 h 5 min");
    }

    #[test]
    fn long_times_are_written_with_one_unit() {
        for (seconds, text) in [
            (1.44, "1.4 s"),
            (59.96, "1.0 min"),
            (3_598.0, "1.0 h"),
            (172_700.0, "2.0 d"),
        ] {
            assert_eq!(display_long(seconds), text);
        }
    }
}
