//! Decides which alarms people are notified of and when: once when one begins, once when it has ended; alarms that come and
//! go are rate-limited.

use std::collections::BTreeMap;
use std::time::Duration;

use alarms::Alarms;
use tokio::time::Instant;

use crate::monitoring::built_in;

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
    /// The alarm.
    pub kind: String,
    pub phase: Phase,
    pub text: String,
}

/// What people were notified of.
#[derive(Debug, Default)]
pub(crate) struct Notices(BTreeMap<String, Notice>);

#[derive(Debug, Default)]
struct Notice {
    /// Whether the alarm notified at the last look.
    notifies: bool,
    /// Whether its beginning was notified, so that its end will be.
    reported: bool,
    /// When a beginning was last notified.
    last: Option<Instant>,
    /// Beginnings that were not notified.
    unreported: u64,
}

impl Notices {
    /// The notifications that are due. The beginning of an alarm is notified at most once in `again`; a shelved alarm is not.
    pub(crate) fn due(&mut self, now: Instant, alarms: &Alarms, again: Duration) -> Vec<Message> {
        let mut messages = Vec::new();
        for alarm in alarms.iter() {
            let name = &alarm.rule.name;
            if !built_in::is_notified(name) {
                continue;
            }
            let notice = self.0.entry(name.clone()).or_default();
            messages.extend(notice.step(name, now, alarm.notifies(), &alarm.state.cause, again));
        }
        messages
    }
}

impl Notice {
    fn step(
        &mut self,
        name: &str,
        now: Instant,
        notifies: bool,
        cause: &str,
        again: Duration,
    ) -> Option<Message> {
        let message = |phase, text| Message {
            kind: name.to_owned(),
            phase,
            text,
        };
        let notified = std::mem::replace(&mut self.notifies, notifies);
        if !notifies {
            let reported = std::mem::take(&mut self.reported);
            return reported.then(|| message(Phase::Ended, format!("over; it was: {cause}")));
        }
        if !notified {
            self.unreported += 1;
        }
        let may = self
            .last
            .is_none_or(|last| now.duration_since(last) >= again);
        if self.reported || !may {
            return None;
        }
        self.reported = true;
        self.last = Some(now);
        let before = std::mem::take(&mut self.unreported).saturating_sub(1);
        let text = match before {
            0 => cause.to_owned(),
            before => format!("{cause} (and {before} times before this)"),
        };
        Some(message(Phase::Begun, text))
    }
}

#[cfg(test)]
mod tests {
    use crate::monitoring::notices::*;

    const AGAIN: Duration = Duration::from_secs(3600);

    /// Simulates one check a second of an alarm that `notifies` or not; returns the notifications that are sent.
    fn play(
        notice: &mut Notice,
        begin: Instant,
        seconds: u64,
        notifies: bool,
    ) -> Vec<(Phase, String)> {
        let looks = (0..seconds).map(|second| begin + Duration::from_secs(second));
        let sent = looks.filter_map(|now| notice.step("disk-days", now, notifies, "3 days", AGAIN));
        sent.map(|message| (message.phase, message.text)).collect()
    }

    #[tokio::test(start_paused = true)]
    async fn alarm_is_notified_at_its_start_and_end() {
        let mut notice = Notice::default();
        let now = Instant::now();
        assert!(play(&mut notice, now, 10, false).is_empty());
        let begun = play(&mut notice, now, 1000, true);
        assert_eq!(begun, [(Phase::Begun, "3 days".to_owned())]);
        let ended = play(&mut notice, now, 100, false);
        assert_eq!(ended, [(Phase::Ended, "over; it was: 3 days".to_owned())]);
    }

    #[tokio::test(start_paused = true)]
    async fn flapping_alarm_is_rate_limited() {
        let mut notice = Notice::default();
        let mut begun = Vec::new();
        let mut now = Instant::now();
        // five hours of alternating two minutes with the alarm and two without
        for _ in 0..75 {
            for notifies in [true, false] {
                let sent = play(&mut notice, now, 120, notifies);
                begun.extend(sent.into_iter().filter(|(phase, _)| *phase == Phase::Begun));
                now += Duration::from_secs(120);
            }
        }
        assert_eq!(begun.len(), 5, "{begun:#?}");
        assert_eq!(begun[0].1, "3 days");
        assert_eq!(begun[1].1, "3 days (and 14 times before this)");
    }
}
