//! Repetition of a load or fault in a scene, such as a load every night or a lost reply every hour.

use std::fmt;
use std::time::Duration;

/// Largest number of repetitions.
const MOST_TIMES: u32 = 100_000;
/// Shortest period, s.
const SHORTEST_S: f64 = 1e-3;
/// Longest time from the first to the last repetition, s: a hundred years.
const LONGEST_S: f64 = 100.0 * 365.25 * 86_400.0;

/// Number of repetitions and their period.
///
/// ```
/// use std::time::Duration;
/// let nights = phantom::Repeat::new(86_400.0, 30)?;
/// assert_eq!(nights.delay(29), Duration::from_secs(29 * 86_400));
/// assert_eq!(nights.to_string(), "every 86400 s, 30 times");
/// assert!(phantom::Repeat::new(0.0, 30).is_err());
/// # Ok::<(), phantom::RepeatError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Repeat {
    every: Duration,
    times: u32,
}

/// An invalid repetition: the key of the scene, and what is wrong with its value.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} is {why}")]
pub struct RepeatError {
    /// `every_s` or `times`.
    pub key: &'static str,
    /// The value, and what is allowed.
    pub why: String,
}

impl Repeat {
    /// `times` repetitions including the first, `every_s` seconds apart.
    ///
    /// # Errors
    /// Fewer than 2 or more than 100,000 times, less than a millisecond, more than a hundred years from first to last.
    pub fn new(every_s: f64, times: i64) -> Result<Self, RepeatError> {
        let refuse = |key, why| Err(RepeatError { key, why });
        let count = u32::try_from(times).unwrap_or(0);
        if !(2..=MOST_TIMES).contains(&count) {
            return refuse(
                "times",
                format!("{times}, it must be 2 to {MOST_TIMES}, the first time included"),
            );
        }
        let longest = LONGEST_S / f64::from(count - 1);
        if !(SHORTEST_S..=longest).contains(&every_s) {
            return refuse(
                "every_s",
                format!(
                    "{every_s}, it must be {SHORTEST_S} to {longest:.0} s: {times} times take no more than a hundred years"
                ),
            );
        }
        Ok(Self {
            every: survey::duration(every_s),
            times: count,
        })
    }

    /// Period.
    pub fn every(self) -> Duration {
        self.every
    }

    /// Number of times, including the first.
    pub fn times(self) -> u32 {
        self.times
    }

    /// Delay of a repetition relative to the first, which has number 0.
    pub fn delay(self, number: u32) -> Duration {
        self.every.saturating_mul(number)
    }

    /// The number of the repetition that started last, at a time after the start of the first.
    pub(crate) fn number(self, since_first: Duration) -> u32 {
        let passed = since_first.as_nanos() / self.every.as_nanos();
        u32::try_from(passed)
            .unwrap_or(u32::MAX)
            .min(self.times - 1)
    }
}

impl fmt::Display for Repeat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let every = self.every.as_secs_f64();
        write!(f, "every {every} s, {} times", self.times)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_counts_from_the_first_and_stops_at_the_last() {
        let repeat = Repeat::new(10.0, 3).unwrap();
        let numbers = [0.0, 9.999, 10.0, 25.0, 1e9].map(|s| repeat.number(survey::duration(s)));
        assert_eq!(numbers, [0, 0, 1, 2, 2]);
    }

    #[test]
    fn absurd_repeats_are_refused_by_key() {
        for (every_s, times, wanted) in [
            (10.0, 0, "times is 0, it must be 2 to 100000"),
            (10.0, 1, "times is 1, it must be 2 to 100000"),
            (10.0, -3, "times is -3, it must be"),
            (10.0, i64::MAX, "times is 9223372036854775807, it must be"),
            (0.0, 2, "every_s is 0, it must be 0.001 to 3155760000 s"),
            (-5.0, 2, "every_s is -5, it must be"),
            (f64::NAN, 2, "every_s is NaN, it must be"),
            (
                1e9,
                30,
                "every_s is 1000000000, it must be 0.001 to 108819310 s",
            ),
        ] {
            let refusal = Repeat::new(every_s, times).unwrap_err().to_string();
            assert!(refusal.starts_with(wanted), "{refusal}");
        }
    }
}
