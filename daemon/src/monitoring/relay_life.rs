//! Extrapolates relay wear: counters cannot be read while a session uses the instruments, but every frame closes a
//! known number of relays.

use std::time::Duration;

use crate::instruments::relay_wear::Wear;

/// The relay with the shortest remaining life, at the time when the counters were read.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RelayLife {
    /// Its number.
    pub relay: u32,
    /// Used fraction of its rating.
    pub used: f64,
    /// Frames until its rating is reached; `None` if measuring does not close it.
    pub frames_left: Option<f64>,
    /// Frame period at that time.
    pub period: Duration,
    /// Number of frames that the daemon had acquired at that time.
    pub frames: u64,
}

impl RelayLife {
    /// The relay with the shortest remaining life; `None` if no relay has a rating.
    pub(crate) fn worst(wear: &[Wear], period: Duration, frames: u64) -> Option<Self> {
        let each = wear.iter().filter_map(|wear| {
            Some(Self {
                relay: wear.relay.0,
                used: wear.used?,
                frames_left: wear
                    .left
                    .map(|left| left.as_secs_f64() / period.as_secs_f64()),
                period,
                frames,
            })
        });
        each.min_by(|a, b| {
            let left = |one: &Self| one.frames_left.unwrap_or(f64::INFINITY);
            left(a).total_cmp(&left(b)).then(b.used.total_cmp(&a.used))
        })
    }

    /// Extrapolates to the time when the daemon has acquired this number of frames.
    pub(crate) fn after(&self, frames: u64) -> Self {
        let since = frames.saturating_sub(self.frames) as f64;
        let Some(left) = self.frames_left else {
            return self.clone();
        };
        let part = if left > 0.0 { since / left } else { 0.0 };
        Self {
            used: self.used + (1.0 - self.used) * part,
            frames_left: Some((left - since).max(0.0)),
            frames,
            ..self.clone()
        }
    }

    /// Time of continuous measurement until the rating is reached.
    pub(crate) fn left(&self) -> Option<Duration> {
        let seconds = self.frames_left? * self.period.as_secs_f64();
        Duration::try_from_secs_f64(seconds).ok()
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::relay_life::*;
    use survey::Relay;

    fn wear(relay: u32, cycles: u64, rated: Option<u64>, left_s: Option<u64>) -> Wear {
        Wear {
            relay: Relay(relay),
            purpose: String::new(),
            cycles,
            rated,
            used: rated.map(|rated| cycles as f64 / rated as f64),
            left: left_s.map(Duration::from_secs),
        }
    }

    #[test]
    fn the_worst_relay_is_carried_on_frame_by_frame() {
        let period = Duration::from_secs(10);
        let relays = [
            wear(1, 0, None, None),
            wear(2, 900, Some(1000), None),
            wear(3, 500, Some(1000), Some(2_500)),
            wear(4, 100, Some(1000), Some(9_000)),
        ];
        let worst = RelayLife::worst(&relays, period, 40).unwrap();
        assert_eq!((worst.relay, worst.used), (3, 0.5));
        // 250 frames are left, two closures in each
        let later = worst.after(140);
        assert!((later.used - 0.7).abs() < 1e-12, "{later:?}");
        assert_eq!(later.left(), Some(Duration::from_secs(1_500)));
        let over = worst.after(10_000);
        assert_eq!(over.left(), Some(Duration::ZERO));
        assert!(over.used > 1.0, "{over:?}");
        assert_eq!(RelayLife::worst(&relays[..1], period, 0), None);
    }
}
