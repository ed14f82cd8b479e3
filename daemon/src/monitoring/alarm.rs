//! Decides which alarms are notified and when: once when one begins, once when it has ended; alarms that come and go
//! are rate-limited.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::time::Instant;

use crate::monitoring::health::ActiveAlarm;

/// Kinds of alarms that are notified.
pub(crate) const REPORTED: [&str; 6] = [
    "faulted",
    "source-unverified",
    "disk-days",
    "relay-life",
    "baseline-stale",
    "no-frame",
];

/// An alarm has ended when it has been absent for this time.
const HOLD: Duration = Duration::from_secs(60);

/// Phase of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    Begun,
    Ended,
    /// A test by `tactus notify test`.
    Test,
}

impl Phase {
    /// The word in JSON.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Begun => "begun",
            Self::Ended => "ended",
            Self::Test => "test",
        }
    }
}

/// A notification.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Message {
    pub kind: &'static str,
    pub phase: Phase,
    pub text: String,
}

/// State of every alarm.
#[derive(Debug, Default)]
pub(crate) struct Alarm(BTreeMap<&'static str, AlarmState>);

#[derive(Debug, Clone)]
struct AlarmState {
    /// When it was last active; `None` when it has ended.
    seen: Option<Instant>,
    /// Whether its beginning was notified, so that its end will be.
    reported: bool,
    /// When a beginning was last notified.
    last: Option<Instant>,
    /// Beginnings that were not notified.
    unreported: u64,
    text: String,
}

impl Alarm {
    /// Returns the notifications that are due. `alarms`: active. `lingering`: still active under the (wider) reset
    /// limits. `unsure`: no data; neither raised nor cleared. The beginning of a kind is notified at most once in
    /// `again`.
    pub(crate) fn evaluate(
        &mut self,
        now: Instant,
        alarms: &[ActiveAlarm],
        lingering: &[ActiveAlarm],
        unsure: &[&str],
        again: Duration,
    ) -> Vec<Message> {
        let mut messages = Vec::new();
        for kind in REPORTED {
            let there = alarms.iter().find(|alarm| alarm.kind == kind);
            let stays = unsure.contains(&kind) || lingering.iter().any(|one| one.kind == kind);
            let state = self.0.entry(kind).or_insert(AlarmState {
                seen: None,
                reported: false,
                last: None,
                unreported: 0,
                text: String::new(),
            });
            messages.extend(state.step(kind, now, there, stays, again));
        }
        messages
    }
}

impl AlarmState {
    fn step(
        &mut self,
        kind: &'static str,
        now: Instant,
        there: Option<&ActiveAlarm>,
        stays: bool,
        again: Duration,
    ) -> Option<Message> {
        if let Some(alarm) = there {
            if self.seen.is_none() {
                self.unreported += 1;
            }
            self.seen = Some(now);
            self.text.clone_from(&alarm.text);
        } else if stays && self.seen.is_some() {
            self.seen = Some(now);
        }
        let seen = self.seen?;
        if now.duration_since(seen) >= HOLD {
            self.seen = None;
            let reported = std::mem::take(&mut self.reported);
            return reported.then(|| Message {
                kind,
                phase: Phase::Ended,
                text: format!("over: {}", self.text),
            });
        }
        let may = self
            .last
            .is_none_or(|last| now.duration_since(last) >= again);
        if self.reported || !may || there.is_none() {
            return None;
        }
        self.reported = true;
        self.last = Some(now);
        let before = std::mem::take(&mut self.unreported).saturating_sub(1);
        let text = match before {
            0 => self.text.clone(),
            before => format!("{} (and {before} times before this)", self.text),
        };
        Some(Message {
            kind,
            phase: Phase::Begun,
            text,
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::alarm::*;

    const AGAIN: Duration = Duration::from_secs(3600);

    fn disk(text: &str) -> Vec<ActiveAlarm> {
        vec![ActiveAlarm {
            kind: "disk-days",
            text: text.to_owned(),
        }]
    }

    /// Simulates one step a second: which alarms are active, and which notifications are sent.
    fn play(alarm: &mut Alarm, seconds: u64, there: bool, stays: bool) -> Vec<(Phase, String)> {
        let begin = Instant::now();
        let mut reported = Vec::new();
        for second in 0..seconds {
            let now = begin + Duration::from_secs(second);
            let alarms = if there { disk("3 days") } else { Vec::new() };
            let wider = if stays { disk("3 days") } else { Vec::new() };
            for message in alarm.evaluate(now, &alarms, &wider, &[], AGAIN) {
                reported.push((message.phase, message.text));
            }
        }
        reported
    }

    #[tokio::test(start_paused = true)]
    async fn alarm_is_reported_at_its_start_and_end() {
        let mut alarm = Alarm::default();
        assert!(play(&mut alarm, 10, false, false).is_empty());
        let begun = play(&mut alarm, 1000, true, true);
        assert_eq!(begun, [(Phase::Begun, "3 days".to_owned())]);
        tokio::time::advance(Duration::from_secs(1000)).await;
        // between the reset limit and the limit: it continues
        assert!(play(&mut alarm, 500, false, true).is_empty());
        tokio::time::advance(Duration::from_secs(500)).await;
        assert!(play(&mut alarm, 59, false, false).is_empty());
        tokio::time::advance(Duration::from_secs(59)).await;
        let ended = play(&mut alarm, 100, false, false);
        assert_eq!(ended, [(Phase::Ended, "over: 3 days".to_owned())]);
    }

    #[tokio::test(start_paused = true)]
    async fn flapping_alarm_is_rate_limited() {
        let mut alarm = Alarm::default();
        let mut begun = Vec::new();
        // five hours of alternating two minutes with the alarm and two without
        for _ in 0..75 {
            for there in [true, false] {
                let reported = play(&mut alarm, 120, there, there);
                begun.extend(
                    reported
                        .into_iter()
                        .filter(|(phase, _)| *phase == Phase::Begun),
                );
                tokio::time::advance(Duration::from_secs(120)).await;
            }
        }
        assert_eq!(begun.len(), 5, "{begun:#?}");
        assert_eq!(begun[0].1, "3 days");
        assert_eq!(begun[1].1, "3 days (and 14 times before this)");
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_not_known_does_not_end_and_not_begin() {
        let mut alarm = Alarm::default();
        let now = Instant::now();
        let unsure = ["disk-days"];
        assert!(alarm.evaluate(now, &[], &[], &unsure, AGAIN).is_empty());
        assert_eq!(alarm.evaluate(now, &disk("x"), &[], &[], AGAIN).len(), 1);
        for minutes in 1..10 {
            let later = now + Duration::from_secs(60 * minutes - 1);
            assert!(alarm.evaluate(later, &[], &[], &unsure, AGAIN).is_empty());
        }
        let later = now + Duration::from_secs(3600);
        assert_eq!(alarm.evaluate(later, &[], &[], &[], AGAIN).len(), 1);
    }
}
