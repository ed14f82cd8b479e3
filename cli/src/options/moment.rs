//! A place in a recording: a frame's number, a time since its first frame, or a time of day.

use std::time::Duration;

use chrono::{DateTime, Local, NaiveDateTime, Utc};

use crate::options::duration::parse_span;

/// A place in a recording, as `--from` and `--to` name it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moment {
    /// A frame's number (its row in a table), from 1.
    Frame(u64),
    /// A time since the first frame.
    Since(Duration),
    /// A wall time.
    At(DateTime<Utc>),
}

impl std::str::FromStr for Moment {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        if let Ok(frame) = text.parse() {
            return Ok(Self::Frame(frame));
        }
        if let Ok(at) = DateTime::parse_from_rfc3339(text) {
            return Ok(Self::At(at.to_utc()));
        }
        let local = ["%Y-%m-%d %H:%M:%S%.f", "%Y-%m-%d %H:%M"]
            .iter()
            .find_map(|form| NaiveDateTime::parse_from_str(text, form).ok());
        if let Some(local) = local.and_then(|local| local.and_local_timezone(Local).earliest()) {
            return Ok(Self::At(local.to_utc()));
        }
        parse_span(text).map(Self::Since).map_err(|_| {
            format!(
                "'{text}' is not a position in a recording; write a frame's number (120), a time since the first frame (10m), or a \
                 time ('2026-11-22 14:00' local, 2026-11-22T14:00:00Z)"
            )
        })
    }
}

/// Parses a wall time: an instant, or a duration before now.
///
/// # Errors
/// The text is neither.
pub(crate) fn wall_time(text: &str) -> Result<DateTime<Utc>, String> {
    let at = match text.parse() {
        Ok(Moment::At(at)) => Some(at),
        Ok(Moment::Since(before)) => chrono::TimeDelta::from_std(before)
            .ok()
            .and_then(|before| Utc::now().checked_sub_signed(before)),
        _ => None,
    };
    at.ok_or_else(|| {
        format!(
            "'{text}' is not a time; write '2026-11-22 14:00' (local), 2026-11-22T14:00:00Z, or a time before now: 7d"
        )
    })
}

impl Moment {
    /// Whether a frame is before, at or after this place; `None` if the place is a time and the frame has none.
    pub(crate) fn compare(
        self,
        sequence: u64,
        wall: Option<DateTime<Utc>>,
        first: Option<DateTime<Utc>>,
    ) -> Option<std::cmp::Ordering> {
        match self {
            Self::Frame(frame) => Some(sequence.cmp(&frame)),
            Self::At(at) => Some(wall?.cmp(&at)),
            Self::Since(since) => {
                let since = chrono::TimeDelta::from_std(since).ok()?;
                Some((wall? - first?).cmp(&since))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;

    #[test]
    fn places_are_frames_spans_and_times() {
        let at = DateTime::parse_from_rfc3339("2026-11-22T14:00:00+01:00").unwrap();
        assert_eq!("12".parse(), Ok(Moment::Frame(12)));
        assert_eq!("10m".parse(), Ok(Moment::Since(Duration::from_secs(600))));
        for text in ["2026-11-22T14:00:00+01:00", "2026-11-22T13:00:00Z"] {
            assert_eq!(text.parse(), Ok(Moment::At(at.to_utc())));
        }
        let local = at
            .with_timezone(&Local)
            .format("%Y-%m-%d %H:%M")
            .to_string();
        assert_eq!(local.parse(), Ok(Moment::At(at.to_utc())));
        for wrong in ["", "noon", "-1", "1.5", "2026-11-22"] {
            let refusal = wrong.parse::<Moment>().unwrap_err();
            assert!(refusal.contains("120"), "{refusal}");
        }
    }

    #[test]
    fn wall_times_are_given_or_lie_before_now() {
        let at = wall_time("2026-11-22T13:00:00Z").unwrap();
        assert_eq!(at.timestamp(), 1_795_352_400);
        let (before, now) = (wall_time("2h").unwrap(), Utc::now());
        assert!((7200..7260).contains(&(now - before).num_seconds()));
        for wrong in ["12", "noon", "", "99999999999w"] {
            let text = wall_time(wrong).unwrap_err();
            assert!(text.contains("7d"), "{wrong}: {text}");
        }
    }

    #[test]
    fn a_frame_without_a_time_is_not_compared_with_one() {
        let first = DateTime::from_timestamp(100, 0);
        let wall = DateTime::from_timestamp(110, 0);
        let since = Moment::Since(Duration::from_secs(10));
        assert_eq!(since.compare(2, wall, first), Some(Ordering::Equal));
        assert_eq!(since.compare(2, None, None), None);
        assert_eq!(
            Moment::Frame(3).compare(2, None, None),
            Some(Ordering::Less)
        );
    }
}
