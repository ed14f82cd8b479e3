//! The instant of a picture: a place in a recording, or an event of its session.

use crate::options::moment::Moment;

/// An instant as `--at` names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Instant {
    /// A frame's number, a time since the first frame, or a time.
    Place(Moment),
    /// An event of the session by its kind and number among those of this kind, from 1; kind `event`: among all.
    Event {
        /// The kind.
        kind: String,
        /// The number.
        number: usize,
    },
}

/// The kind that stands for events of every kind.
pub(crate) const ANY_KIND: &str = "event";

impl std::str::FromStr for Instant {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        if let Ok(place) = text.parse() {
            return Ok(Self::Place(place));
        }
        let (kind, number) = match text.split_once(':') {
            Some((kind, number)) => (kind, number.parse().ok().filter(|number| *number > 0)),
            None => (text, Some(1)),
        };
        let of_kind = |c: char| c.is_ascii_lowercase() || c == '-';
        let begins = kind.starts_with(|c: char| c.is_ascii_lowercase());
        match number {
            Some(number) if begins && kind.chars().all(of_kind) => Ok(Self::Event {
                kind: kind.to_owned(),
                number,
            }),
            _ => Err(format!(
                "'{text}' is not an instant of a recording; write a frame's number (120), a time since the first frame (10m), a time \
                 ('2026-11-22 14:00' local, 2026-11-22T14:00:00Z), or an event: its kind (alarm-active), the second of a kind \
                 (alarm-active:2), or its number among all (event:7)"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn instants_are_places_and_events() {
        let event = |kind: &str, number| {
            Ok(Instant::Event {
                kind: kind.to_owned(),
                number,
            })
        };
        assert_eq!("12".parse(), Ok(Instant::Place(Moment::Frame(12))));
        let since = Moment::Since(Duration::from_secs(600));
        assert_eq!("10m".parse(), Ok(Instant::Place(since)));
        assert_eq!("alarm-active".parse(), event("alarm-active", 1));
        assert_eq!("alarm:3".parse(), event("alarm", 3));
        assert_eq!("event:7".parse(), event(ANY_KIND, 7));
        for wrong in [
            "",
            "-1",
            "1.5",
            "alarm:0",
            "alarm:x",
            "Alarm",
            ":2",
            "--",
            "2026-11-22",
        ] {
            let refusal = wrong.parse::<Instant>().unwrap_err();
            assert!(refusal.contains("alarm-active:2"), "{wrong}: {refusal}");
        }
    }
}
