//! The daemon's health, as reported by itself.

use chrono::DateTime;
use serde::Serialize;

use crate::options::duration::display_long;
use crate::output::time::{local, utc};

/// `health` of `status --json`; see `docs/reference/json.md`.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Health {
    well: bool,
    troubles: Vec<ActiveAlarm>,
    last_frame: Option<LastFrame>,
    period_s: Option<f64>,
    backlog: Option<u64>,
    gaps: Gaps,
    instruments: Vec<InstrumentState>,
    baseline_age_s: Option<f64>,
    disk_free_bytes: Option<u64>,
    disk_bytes_per_day: Option<f64>,
    disk_days: Option<f64>,
    relay: Option<RelayLife>,
}

#[derive(Debug, Serialize)]
struct ActiveAlarm {
    kind: String,
    text: String,
}

#[derive(Debug, Serialize)]
struct LastFrame {
    session: String,
    sequence: u64,
    wall: String,
    age_s: f64,
}

#[derive(Debug, Default, Serialize)]
struct Gaps {
    failed: u64,
    dropped: u64,
    last: Option<Gap>,
}

#[derive(Debug, Serialize)]
struct Gap {
    at: String,
    text: String,
    #[serde(skip)]
    at_ns: i64,
}

#[derive(Debug, Serialize)]
struct InstrumentState {
    role: String,
    fault: Option<String>,
}

/// The relay that will be worn out first.
#[derive(Debug, Serialize)]
struct RelayLife {
    relay: u32,
    used: f64,
    left_s: Option<f64>,
}

impl From<dbus::Health> for Health {
    fn from(reported: dbus::Health) -> Self {
        let pairs = |texts: Option<Vec<String>>| {
            texts
                .unwrap_or_default()
                .into_iter()
                .map(|text| match text.split_once(": ") {
                    Some((word, rest)) => (word.to_owned(), rest.to_owned()),
                    None => (text, String::new()),
                })
        };
        let time = |at_ns| utc(DateTime::from_timestamp_nanos(at_ns));
        Self {
            well: reported.well.unwrap_or(false),
            troubles: pairs(reported.troubles)
                .map(|(kind, text)| ActiveAlarm { kind, text })
                .collect(),
            last_frame: reported.last_frame_session.map(|session| LastFrame {
                session,
                sequence: reported.last_frame_sequence.unwrap_or(0),
                wall: time(reported.last_frame_ns.unwrap_or(0)),
                age_s: reported.last_frame_age_s.unwrap_or(0.0),
            }),
            period_s: reported.period_s,
            backlog: reported.backlog,
            gaps: Gaps {
                failed: reported.total_failed.unwrap_or(0),
                dropped: reported.total_dropped.unwrap_or(0),
                last: reported.last_gap.map(|text| {
                    let at_ns = reported.last_gap_ns.unwrap_or(0);
                    let at = time(at_ns);
                    Gap { at, text, at_ns }
                }),
            },
            instruments: pairs(reported.instruments)
                .map(|(role, state)| InstrumentState {
                    role,
                    fault: state.strip_prefix("fault: ").map(str::to_owned),
                })
                .collect(),
            baseline_age_s: reported.baseline_age_s,
            disk_free_bytes: reported.disk_free_bytes,
            disk_bytes_per_day: reported.disk_bytes_per_day,
            disk_days: reported.disk_days,
            relay: reported.relay.map(|relay| RelayLife {
                relay,
                used: reported.relay_used.unwrap_or(0.0),
                left_s: reported.relay_left_s,
            }),
        }
    }
}

impl Health {
    /// The first lines: healthy, or what is wrong.
    pub(crate) fn verdict(&self) -> Vec<String> {
        if self.well {
            return vec!["verdict    well".to_owned()];
        }
        let mut first = "verdict    NOT WELL: ";
        let each = self.troubles.iter().map(|trouble| {
            let line = format!("{first}{}", trouble.text);
            first = "           and: ";
            line
        });
        let lines: Vec<String> = each.collect();
        match lines.is_empty() {
            true => vec!["verdict    NOT WELL".to_owned()],
            false => lines,
        }
    }

    /// Text after the baseline's id.
    pub(crate) fn age_of_baseline(&self) -> String {
        match self.baseline_age_s {
            Some(age) => format!(", {} old", display_long(age)),
            None => String::new(),
        }
    }

    /// A line for each value available.
    pub(crate) fn for_a_person(&self) -> Vec<String> {
        let mut lines = Vec::new();
        lines.push(match (&self.last_frame, self.backlog) {
            (None, _) => "last frame none since the daemon began".to_owned(),
            (Some(frame), backlog) => format!(
                "last frame {} of {}, {} ago{}",
                frame.sequence,
                frame.session,
                display_long(frame.age_s),
                match backlog {
                    Some(backlog) => format!("; {backlog} wait for the disk"),
                    None => String::new(),
                }
            ),
        });
        let Gaps {
            failed, dropped, ..
        } = self.gaps;
        lines.push(match &self.gaps.last {
            None => format!("gaps       {failed} frames failed, {dropped} missed their time"),
            Some(gap) => format!(
                "gaps       {failed} frames failed, {dropped} missed their time; the last {}: {}",
                local(DateTime::from_timestamp_nanos(gap.at_ns)),
                gap.text
            ),
        });
        if !self.instruments.is_empty() {
            let each = self.instruments.iter();
            let each: Vec<String> = each
                .map(|one| match &one.fault {
                    None => format!("{} ready", one.role),
                    Some(_) => format!("{} cannot be used (the verdict says why)", one.role),
                })
                .collect();
            lines.push(format!("rig        {}", each.join(", ")));
        }
        if let Some(free) = self.disk_free_bytes {
            let free = free as f64 / 1e9;
            lines.push(match (self.disk_days, self.disk_bytes_per_day) {
                (Some(days), Some(rate)) => format!(
                    "disk       {days:.0} days left ({free:.1} GB free, {:.1} MB a day)",
                    rate / 1e6
                ),
                _ => format!("disk       {free:.1} GB free; how long that lasts is not known yet"),
            });
        }
        lines.push(match &self.relay {
            None => "relays     wear not read; `tactus instruments relays` does".to_owned(),
            Some(life) => format!(
                "relays     relay {} first: {:.1} % of its life used{}",
                life.relay,
                100.0 * life.used,
                match life.left_s {
                    Some(left) => format!(", {} of measuring left", display_long(left)),
                    None => String::new(),
                }
            ),
        });
        lines
    }
}

#[cfg(test)]
mod tests {
    use crate::control::health::*;

    fn reported() -> dbus::Health {
        dbus::Health {
            well: Some(false),
            troubles: Some(vec![
                "no-frame: session m1 has had no frame for 90.0 s".to_owned(),
                "disk-days: the disk is full in 3.0 days: soon".to_owned(),
            ]),
            instruments: Some(vec![
                "source: ready".to_owned(),
                "switch+voltmeter: fault: lost".to_owned(),
            ]),
            last_frame_session: Some("m1".to_owned()),
            last_frame_sequence: Some(17),
            last_frame_ns: Some(1_767_225_600_123_456_789),
            last_frame_age_s: Some(90.0),
            backlog: Some(2),
            period_s: Some(10.0),
            total_failed: Some(3),
            total_dropped: Some(4),
            last_gap: Some("frame 9 failed: late".to_owned()),
            last_gap_ns: Some(1_767_225_600_000_000_000),
            baseline_age_s: Some(7200.0),
            disk_free_bytes: Some(12_300_000_000),
            disk_bytes_per_day: Some(4.1e9),
            disk_days: Some(3.0),
            relay: Some(1042),
            relay_used: Some(0.125),
            relay_left_s: Some(86_400.0 * 40.0),
            ..dbus::Health::default()
        }
    }

    #[test]
    fn json_is_one_line() {
        let health = Health::from(reported());
        let line = serde_json::to_value(&health).unwrap();
        assert_eq!(line["well"], false);
        assert_eq!(line["troubles"][1]["kind"], "disk-days");
        assert_eq!(
            line["troubles"][1]["text"],
            "the disk is full in 3.0 days: soon"
        );
        assert_eq!(line["last_frame"]["wall"], "2026-01-01T00:00:00.123456789Z");
        assert_eq!(line["gaps"]["last"]["text"], "frame 9 failed: late");
        assert_eq!(line["instruments"][0]["fault"], serde_json::Value::Null);
        assert_eq!(line["instruments"][1]["fault"], "lost");
        assert_eq!(line["relay"]["relay"], 1042);
        let nothing = Health::from(dbus::Health::default());
        let line = serde_json::to_value(&nothing).unwrap();
        for key in ["last_frame", "backlog", "disk_days", "relay"] {
            assert_eq!(line[key], serde_json::Value::Null, "{key}");
        }
    }

    #[test]
    fn a_person_reads_what_is_wrong_first() {
        let health = Health::from(reported());
        let verdict = health.verdict();
        assert_eq!(
            verdict,
            [
                "verdict    NOT WELL: session m1 has had no frame for 90.0 s",
                "           and: the disk is full in 3.0 days: soon"
            ]
        );
        let text = health.for_a_person().join("\n");
        for wanted in [
            "last frame 17 of m1, 1.5 min ago; 2 wait for the disk",
            "gaps       3 frames failed, 4 missed their time; the last ",
            "frame 9 failed: late",
            "rig        source ready, switch+voltmeter cannot be used (the verdict says why)",
            "disk       3 days left (12.3 GB free, 4100.0 MB a day)",
            "relays     relay 1042 first: 12.5 % of its life used, 40.0 d of measuring left",
        ] {
            assert!(text.contains(wanted), "{wanted}\n{text}");
        }
        assert_eq!(health.age_of_baseline(), ", 2.0 h old");
    }
}
