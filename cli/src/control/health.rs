//! The daemon's health, as the daemon reports it.

use chrono::DateTime;
use dbus::json::{Gaps, Health};

use crate::options::duration::display_long;
use crate::output::time::local;

/// The first lines: that all is well, or each alarm and problem.
pub(crate) fn verdict(health: &Health) -> Vec<String> {
    if health.well {
        return vec!["verdict    well".to_owned()];
    }
    let mut first = "verdict    NOT WELL: ";
    let each = health.troubles.iter().map(|trouble| {
        let line = format!("{first}{}: {}", trouble.kind, trouble.text);
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
pub(crate) fn age_of_baseline(health: &Health) -> String {
    match health.baseline_age_s {
        Some(age) => format!(", {} old", display_long(age)),
        None => String::new(),
    }
}

/// The first remark on the baseline, and which command shows the others.
pub(crate) fn remark_on_baseline(remarks: &[String]) -> Option<String> {
    let (first, others) = remarks.split_first()?;
    let more = match others.len() {
        0 => String::new(),
        count => format!("; {count} more: `tactus baseline show`"),
    };
    Some(format!("{first}{more}"))
}

/// One line for each available value.
pub(crate) fn for_a_person(health: &Health) -> Vec<String> {
    let mut lines = Vec::new();
    lines.push(match (&health.last_frame, health.backlog) {
        (None, _) => "last frame none since the daemon started".to_owned(),
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
    } = health.gaps;
    lines.push(match &health.gaps.last {
        None => format!("gaps       {failed} frames failed, {dropped} dropped"),
        Some(gap) => format!(
            "gaps       {failed} frames failed, {dropped} dropped; the last {}: {}",
            local(DateTime::from_timestamp_nanos(gap.at_ns)),
            gap.text
        ),
    });
    if !health.instruments.is_empty() {
        let each = health.instruments.iter();
        let each: Vec<String> = each
            .map(|one| match &one.fault {
                None => format!("{} ready", one.role),
                Some(_) => format!("{} cannot be used (see the verdict)", one.role),
            })
            .collect();
        lines.push(format!("rig        {}", each.join(", ")));
    }
    if let Some(free) = health.disk_free_bytes {
        let free = free as f64 / 1e9;
        lines.push(match (health.disk_days, health.disk_bytes_per_day) {
            (Some(days), Some(rate)) => format!(
                "disk       {days:.0} days left ({free:.1} GB free, {:.1} MB a day)",
                rate / 1e6
            ),
            _ => {
                format!("disk       {free:.1} GB free; the time until it is full is not known yet")
            }
        });
    }
    lines.push(match &health.relay {
        None => "relays     wear not read yet; `tactus instruments relays` reads it".to_owned(),
        Some(life) => format!(
            "relays     relay {} wears out first: {:.1} % of its life used{}",
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
        let verdict = verdict(&health);
        assert_eq!(
            verdict,
            [
                "verdict    NOT WELL: no-frame: session m1 has had no frame for 90.0 s",
                "           and: disk-days: the disk is full in 3.0 days: soon"
            ]
        );
        let text = for_a_person(&health).join("\n");
        for wanted in [
            "last frame 17 of m1, 1.5 min ago; 2 wait for the disk",
            "gaps       3 frames failed, 4 dropped; the last ",
            "frame 9 failed: late",
            "rig        source ready, switch+voltmeter cannot be used (see the verdict)",
            "disk       3 days left (12.3 GB free, 4100.0 MB a day)",
            "relays     relay 1042 wears out first: 12.5 % of its life used, 40.0 d of measuring left",
        ] {
            assert!(text.contains(wanted), "{wanted}\n{text}");
        }
        assert_eq!(age_of_baseline(&health), ", 2.0 h old");
    }
}
