//! Range checks for numbers from configuration, options and files; conversion of seconds and wall times.

use std::fmt;
use std::time::Duration;

use chrono::{DateTime, Utc};

/// The allowed range of a number from outside. NaN and infinities are always refused.
///
/// ```
/// use survey::Bounds;
/// let percent = Bounds::Within(0.0, 100.0);
/// assert_eq!(percent.check(5.0), Ok(5.0));
/// assert_eq!(percent.check(f64::NAN).unwrap_err().to_string(), "NaN is not from 0 to 100");
/// assert_eq!(Bounds::Above(0.0, 1.0).check(1e308).unwrap_err().to_string(), "1e308 is not above 0 and at most 1");
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bounds {
    /// From the first to the second, both included.
    Within(f64, f64),
    /// Above the first, and at most the second.
    Above(f64, f64),
    /// Above the first and below the second.
    Between(f64, f64),
    /// One of the listed values.
    OneOf(&'static [f64]),
}

/// A number that is not allowed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{} is {}{bounds}", Short(*.value), if matches!(.bounds, Bounds::OneOf(_)) { "n" } else { "not " })]
pub struct OutOfBounds {
    /// The number.
    pub value: f64,
    /// What is allowed.
    pub bounds: Bounds,
}

impl Bounds {
    /// Parses a number and checks it.
    ///
    /// # Errors
    /// The allowed range, in words.
    pub fn parse(self, text: &str) -> Result<f64, String> {
        let number = text.trim().parse().ok();
        number
            .and_then(|number| self.check(number).ok())
            .ok_or_else(|| format!("it must be {self}"))
    }

    /// Parses a whole number in range; `1e5` is accepted.
    ///
    /// # Errors
    /// The allowed range, in words.
    pub fn parse_count(self, text: &str) -> Result<usize, String> {
        let number = self.parse(text).ok().filter(|number| number.fract() == 0.0);
        number
            .map(|number| number as usize)
            .ok_or_else(|| format!("it must be a whole number {self}"))
    }

    /// [`Bounds::parse`] as the parser of an argument of a command line.
    pub fn parser(self) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
        move |text| self.parse(text)
    }

    /// [`Bounds::parse_count`] as the parser of an argument of a command line.
    pub fn counter(self) -> impl Fn(&str) -> Result<usize, String> + Clone + Send + Sync + 'static {
        move |text| self.parse_count(text)
    }

    /// Returns the value if it is in range.
    ///
    /// # Errors
    /// The value and the allowed range.
    pub fn check(self, value: f64) -> Result<f64, OutOfBounds> {
        let allowed = match self {
            Self::Within(low, high) => (low..=high).contains(&value),
            Self::Above(low, high) => value > low && value <= high,
            Self::Between(low, high) => value > low && value < high,
            Self::OneOf(each) => each.contains(&value),
        };
        match allowed {
            true => Ok(value),
            false => Err(OutOfBounds {
                value,
                bounds: self,
            }),
        }
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Within(low, high) => write!(f, "from {} to {}", Short(low), Short(high)),
            Self::Above(low, high) => write!(f, "above {} and at most {}", Short(low), Short(high)),
            Self::Between(low, high) => write!(f, "above {} and below {}", Short(low), Short(high)),
            Self::OneOf(each) => {
                f.write_str("one of ")?;
                for (k, value) in each.iter().enumerate() {
                    write!(f, "{}{}", if k > 0 { ", " } else { "" }, Short(*value))?;
                }
                Ok(())
            }
        }
    }
}

/// Formats a number of any size in a few characters.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        match size == 0.0 || !size.is_finite() || (1e-4..1e12).contains(&size) {
            true => write!(f, "{}", self.0),
            false => write!(f, "{:e}", self.0),
        }
    }
}

/// The longest time that [`duration`] returns: a hundred years, which can be added to the time of any clock.
pub const LONGEST_S: f64 = 100.0 * 365.25 * 86_400.0;

/// Converts seconds to a duration: zero for negative numbers and NaN, at most [`LONGEST_S`]. Meant for numbers that
/// have been range-checked already.
///
/// ```
/// use std::time::Duration;
/// assert_eq!(survey::duration(0.5), Duration::from_millis(500));
/// assert_eq!(survey::duration(f64::NAN), Duration::ZERO);
/// assert_eq!(survey::duration(1e308).as_secs(), 3_155_760_000);
/// ```
pub fn duration(seconds: f64) -> Duration {
    // false for NaN
    let seconds = if seconds > LONGEST_S {
        LONGEST_S
    } else {
        seconds
    };
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

/// Nanoseconds since 1970 UTC, clamped to the representable range (1677 to 2262).
pub fn nanoseconds(wall: DateTime<Utc>) -> i64 {
    wall.timestamp_nanos_opt()
        .unwrap_or(if wall < DateTime::UNIX_EPOCH {
            i64::MIN
        } else {
            i64::MAX
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTREMES: [f64; 7] = [
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::NAN,
        1e308,
        -1.0,
        -5e-324,
        u64::MAX as f64,
    ];

    #[test]
    fn extremes_are_in_no_bounds() {
        for bounds in [
            Bounds::Within(0.0, 10.0),
            Bounds::Above(0.0, 10.0),
            Bounds::Between(0.0, 1.0),
            Bounds::OneOf(&[1.0, 2.0]),
        ] {
            for value in EXTREMES {
                let text = bounds.check(value).unwrap_err().to_string();
                assert!(text.len() < 60, "{text}");
            }
        }
    }

    #[test]
    fn error_names_the_allowed_range() {
        let message = |bounds: Bounds, value| bounds.check(value).unwrap_err().to_string();
        assert_eq!(
            message(Bounds::OneOf(&[1.0, 2.0]), 3.0),
            "3 is none of 1, 2"
        );
        assert_eq!(
            message(Bounds::Above(0.0, 1.0), 0.0),
            "0 is not above 0 and at most 1"
        );
        assert_eq!(
            message(Bounds::Between(0.0, 1.0), 1.0),
            "1 is not above 0 and below 1"
        );
        assert_eq!(
            message(Bounds::Within(1.0, 8.0), -5e-324),
            "-5e-324 is not from 1 to 8"
        );
        assert_eq!(Bounds::Above(0.0, 1.0).check(5e-324), Ok(5e-324));
    }

    #[test]
    fn every_number_is_some_length_of_time() {
        for value in EXTREMES {
            assert!(duration(value).as_secs_f64() <= LONGEST_S);
        }
        assert_eq!(duration(1.0 / 3000.0), Duration::from_nanos(333_333));
    }
}
