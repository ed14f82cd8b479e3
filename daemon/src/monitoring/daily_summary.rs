//! One line a day: frames, gaps, drift, worst contact. A day ends at midnight UTC, whatever the time zone of the host.

use std::fmt::Write as _;
use std::sync::Arc;

use chrono::{DateTime, NaiveDate, Utc};
use survey::{Baseline, Reading};

use crate::monitoring::health::Counts;
use survey::relative_changes;

/// State compared from day to day.
pub(crate) struct DailySummary {
    day: NaiveDate,
    counts: Counts,
    /// Readings of the last frame of the previous day.
    yesterday: Option<Vec<Reading>>,
}

/// Values at the end of a day.
pub(crate) struct DayEnd {
    pub counts: Counts,
    /// Readings of the last frame of the running session.
    pub readings: Option<Vec<Reading>>,
    pub baseline: Option<Arc<Baseline>>,
    /// From the last self-test, as text for people.
    pub worst_contact: Option<String>,
}

impl DailySummary {
    pub(crate) fn new(now: DateTime<Utc>, counts: Counts) -> Self {
        Self {
            day: now.date_naive(),
            counts,
            yesterday: None,
        }
    }

    /// Whether the day is over. If the clock is set back by less than a day, no day ends twice. If the date goes back
    /// by two days or more, because the clock was wrong before, the day counts as over: otherwise there would be no
    /// summary until the wrong date is reached again.
    pub(crate) fn is_over(&self, now: DateTime<Utc>) -> bool {
        let today = now.date_naive();
        today > self.day || self.day.signed_duration_since(today).num_days() > 1
    }

    /// The summary of the day that is over; the next one begins.
    pub(crate) fn summary(&mut self, now: DateTime<Utc>, day_end: &DayEnd) -> String {
        let counts = day_end.counts;
        let mut text = format!(
            "{} UTC: {} frames, {} failed, {} dropped",
            self.day,
            counts.durable.saturating_sub(self.counts.durable),
            counts.failed.saturating_sub(self.counts.failed),
            counts.dropped.saturating_sub(self.counts.dropped),
        );
        let readings = day_end.readings.as_ref();
        let drifts = [
            (
                "baseline",
                day_end.baseline.as_ref().map(|baseline| &baseline.readings),
            ),
            ("the day before", self.yesterday.as_ref()),
        ];
        for (whence, from) in drifts {
            if let (Some(from), Some(to)) = (from, readings)
                && let Some(drift) = drift(from, to)
            {
                let _ = write!(text, "; drift since {whence} {:+.3} %", 100.0 * drift);
            }
        }
        if let Some(contact) = &day_end.worst_contact {
            let _ = write!(text, "; worst contact {contact}");
        }
        self.day = now.date_naive();
        self.counts = counts;
        self.yesterday = readings.cloned();
        text
    }
}

/// Median relative change of the readings: a load changes few of them, ageing of the sheet changes all.
fn drift(from: &[Reading], to: &[Reading]) -> Option<f64> {
    if from.len() != to.len() {
        return None;
    }
    let mut changes: Vec<f64> = relative_changes(from, to).collect();
    if changes.is_empty() {
        return None;
    }
    changes.sort_by(f64::total_cmp);
    let middle = changes.len() / 2;
    Some(match changes.len() % 2 {
        0 => 0.5 * (changes[middle - 1] + changes[middle]),
        _ => changes[middle],
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use crate::monitoring::daily_summary::*;
    use survey::{Amps, Frame, Protocol, Settings, Volts};

    fn frame(volts: &[f64]) -> Frame {
        let protocol = Protocol::sheffield(4).unwrap();
        Frame {
            sequence: 1,
            readings: volts.iter().map(|v| Reading::Ok(Volts(*v))).collect(),
            monotonic: Duration::ZERO,
            wall: DateTime::UNIX_EPOCH,
            duration: Duration::ZERO,
            settings: Settings {
                protocol_hash: protocol.hash(),
                current: Amps(1e-3),
                range: Volts(1.0),
                nplc: 1.0,
                settle: Duration::ZERO,
                wiring: "w".into(),
                precautions: Default::default(),
            },
            extra: vec![],
            compliance: vec![],
            simulated: true,
        }
    }

    /// Three days in steps of five seconds; the clock is set back by an hour just after a midnight.
    #[test]
    fn each_day_ends_once_at_midnight_utc() {
        let begin: DateTime<Utc> = "2026-11-22T10:00:00Z".parse().unwrap();
        let mut daily = DailySummary::new(begin, Counts::default());
        let mut lines = Vec::new();
        let baseline = Baseline::from_frames("b", &[frame(&[1.0, 2.0, -4.0, 8.0])]);
        let baseline = Arc::new(baseline.unwrap());
        let mut now = begin;
        let mut set_back = false;
        for tick in 0_u64..3 * 17_280 {
            now += std::time::Duration::from_secs(5);
            if lines.len() == 1 && !set_back {
                now -= std::time::Duration::from_secs(3600);
                set_back = true;
            }
            if !daily.is_over(now) {
                continue;
            }
            // three of four readings grow by a thousandth a day, one is under a load
            let grown = 1.0 + 1e-3 * (lines.len() + 1) as f64;
            let volts = [grown, 2.0 * grown, -4.0 * grown, 20.0];
            let day_end = DayEnd {
                counts: Counts {
                    durable: tick / 2,
                    failed: 3 * lines.len() as u64 + 1,
                    ..Counts::default()
                },
                readings: Some(frame(&volts).readings),
                baseline: Some(Arc::clone(&baseline)),
                worst_contact: (lines.len() == 2).then(|| "electrode 3".to_owned()),
            };
            lines.push(daily.summary(now, &day_end));
        }
        assert_eq!(lines.len(), 3, "{lines:#?}");
        assert_eq!(
            lines[0],
            "2026-11-22 UTC: 5039 frames, 1 failed, 0 dropped; drift since baseline +0.100 %"
        );
        assert!(
            lines[1].starts_with("2026-11-23 UTC: 9000 frames, 3 failed"),
            "{}",
            lines[1]
        );
        assert!(
            lines[1].ends_with("since baseline +0.200 %; drift since the day before +0.100 %"),
            "{}",
            lines[1]
        );
        assert!(
            lines[2].ends_with("; worst contact electrode 3"),
            "{}",
            lines[2]
        );
    }

    #[test]
    fn days_begin_anew_where_the_clock_is_set_back_by_years() {
        let wrong: DateTime<Utc> = "2036-01-01T12:00:00Z".parse().unwrap();
        let mut daily = DailySummary::new(wrong, Counts::default());
        // setting the clock back by an hour across midnight does not end a day
        let before_midnight: DateTime<Utc> = "2035-12-31T23:30:00Z".parse().unwrap();
        assert!(!daily.is_over(before_midnight));
        let right: DateTime<Utc> = "2026-11-22T10:00:00Z".parse().unwrap();
        assert!(daily.is_over(right));
        let day_end = DayEnd {
            counts: Counts::default(),
            readings: None,
            baseline: None,
            worst_contact: None,
        };
        let text = daily.summary(right, &day_end);
        assert!(text.starts_with("2036-01-01 UTC: "), "{text}");
        assert!(!daily.is_over(right));
        assert!(daily.is_over(right + Duration::from_secs(86_400)));
    }

    #[test]
    fn what_has_no_voltage_has_no_drift() {
        let ok = |volts| Reading::Ok(Volts(volts));
        assert_eq!(drift(&[ok(1.0)], &[Reading::Overload]), None);
        assert_eq!(drift(&[ok(1.0)], &[ok(1.0), ok(1.0)]), None);
        assert_eq!(drift(&[ok(0.0), ok(2.0)], &[ok(1.0), ok(3.0)]), Some(0.5));
    }
}
