//! Decides which alarms are notified and when: once at the beginning and once at the end of an alarm. An alarm that
//! begins repeatedly is rate-limited.

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

/// The notifications that were sent, for each alarm.
#[derive(Debug, Default)]
pub(crate) struct Notices(BTreeMap<String, Notice>);

#[derive(Debug, Default)]
struct Notice {
    /// When the alarm became active, s, if it was active, and neither shelved nor out of service, at the last check.
    /// With another time, it has ended and begun since then.
    active_since: Option<f64>,
    /// Whether its beginning was notified, so that its end will be.
    reported: bool,
    /// The cause at the last check at which the alarm was active. If the rule was removed and added again since then,
    /// the alarm has a new state without a cause.
    cause: String,
    /// When a beginning was last notified.
    last: Option<Instant>,
    /// Beginnings that were not notified.
    unreported: u64,
}

impl Notices {
    /// The notifications that are due. The beginning of an alarm is notified at most once within `again`. An alarm that
    /// is shelved or out of service is not notified. Afterwards its end is notified, or, if it is still active, its
    /// beginning again. An alarm that no longer exists, because its rule was removed, has ended.
    pub(crate) fn due(&mut self, now: Instant, alarms: &Alarms, again: Duration) -> Vec<Message> {
        let mut messages = Vec::new();
        for alarm in alarms.iter() {
            let name = &alarm.rule.name;
            if !built_in::is_notified(name) {
                continue;
            }
            let notice = self.0.entry(name.clone()).or_default();
            if alarm.is_put_aside() {
                notice.set_aside();
                continue;
            }
            let state = &alarm.state;
            let since = state.active.then(|| state.changed_s.unwrap_or_default());
            messages.extend(notice.step(name, now, since, &state.cause, again));
        }
        self.0.retain(|name, notice| {
            let kept = alarms.get(name).is_some();
            if !kept && notice.reported {
                messages.push(Message {
                    kind: name.clone(),
                    phase: Phase::Ended,
                    text: "over: its rule is no longer in the configuration".to_owned(),
                });
            }
            kept
        });
        messages
    }
}

impl Notice {
    /// The alarm is shelved or out of service, which does not end it: `reported` is kept.
    fn set_aside(&mut self) {
        self.active_since = None;
    }

    fn step(
        &mut self,
        name: &str,
        now: Instant,
        active_since: Option<f64>,
        cause: &str,
        again: Duration,
    ) -> Option<Message> {
        let message = |phase, text| Message {
            kind: name.to_owned(),
            phase,
            text,
        };
        let last_since = std::mem::replace(&mut self.active_since, active_since);
        if active_since.is_none() {
            let reported = std::mem::take(&mut self.reported);
            let last = std::mem::take(&mut self.cause);
            let cause = match cause {
                "" => last.as_str(),
                cause => cause,
            };
            return reported.then(|| message(Phase::Ended, format!("over; it was: {cause}")));
        }
        cause.clone_into(&mut self.cause);
        if last_since != active_since {
            self.unreported += 1;
            // also for an alarm that is still active when it is unshelved or in service again
            self.reported = false;
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
    use alarms::{Judgement, Order, Rule, Severity};

    use crate::monitoring::notices::*;

    const AGAIN: Duration = Duration::from_secs(3600);

    /// Simulates one check per second of an alarm that is `active` or not; returns the phase and text of each
    /// notification.
    fn play(
        notice: &mut Notice,
        begin: Instant,
        seconds: u64,
        active: bool,
    ) -> Vec<(Phase, String)> {
        let looks = (0..seconds).map(|second| begin + Duration::from_secs(second));
        let sent = looks.filter_map(|now| {
            let since = active.then_some(0.0);
            notice.step("disk-days", now, since, "3 days", AGAIN)
        });
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
        // five hours in which the alarm is active for two minutes and inactive for two minutes in turn
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

    const NAME: &str = "heel";

    /// The rule of an alarm that begins and ends without delay.
    fn rule() -> Rule {
        Rule {
            name: NAME.to_owned(),
            severity: Severity::Major,
            on_s: 0.0,
            off_s: 0.0,
            latched: false,
        }
    }

    fn alarms() -> Alarms {
        let mut alarms = Alarms::default();
        alarms.set_rules(vec![rule()]);
        alarms
    }

    /// The phases of the notifications of one check after a judgement at this second.
    fn check(
        notices: &mut Notices,
        alarms: &mut Alarms,
        begin: Instant,
        second: u32,
        judgement: Judgement,
    ) -> Vec<Phase> {
        alarms.judge(NAME, f64::from(second), judgement);
        let now = begin + Duration::from_secs(second.into());
        let due = notices.due(now, alarms, Duration::from_secs(60));
        due.into_iter().map(|message| message.phase).collect()
    }

    fn order(alarms: &mut Alarms, second: u32, order: &Order) {
        let ordered = alarms.order(NAME, second.into(), order, "user 7", "");
        ordered.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn no_alarm_is_notified_as_over_because_it_is_shelved() {
        let beyond = || Judgement::Beyond("9 kPa".to_owned());
        let (mut notices, mut alarms, begin) = (Notices::default(), alarms(), Instant::now());
        let mut at = |alarms: &mut Alarms, second, judgement| {
            check(&mut notices, alarms, begin, second, judgement)
        };
        assert_eq!(at(&mut alarms, 0, beyond()), [Phase::Begun]);
        order(&mut alarms, 1, &Order::Shelve(100.0));
        assert_eq!(at(&mut alarms, 2, beyond()), []);
        // its beginning is notified again when it is no longer shelved
        assert_eq!(at(&mut alarms, 101, beyond()), [Phase::Begun]);
        order(&mut alarms, 102, &Order::OutOfService);
        assert_eq!(at(&mut alarms, 103, beyond()), []);
        // its end is notified when it is in service again
        assert_eq!(at(&mut alarms, 104, Judgement::Within), []);
        order(&mut alarms, 105, &Order::InService);
        assert_eq!(at(&mut alarms, 106, Judgement::Within), [Phase::Ended]);
        assert_eq!(at(&mut alarms, 200, beyond()), [Phase::Begun]);
        // shelving without a time ends with the alarm
        order(&mut alarms, 201, &Order::ShelveOnce);
        assert_eq!(at(&mut alarms, 202, beyond()), []);
        assert_eq!(at(&mut alarms, 203, Judgement::Within), [Phase::Ended]);
    }

    #[tokio::test(start_paused = true)]
    async fn an_alarm_whose_rule_is_removed_is_notified_as_over() {
        let beyond = || Judgement::Beyond("9 kPa".to_owned());
        let (mut notices, mut alarms, begin) = (Notices::default(), alarms(), Instant::now());
        let mut at = |alarms: &mut Alarms, second, judgement| {
            check(&mut notices, alarms, begin, second, judgement)
        };
        assert_eq!(at(&mut alarms, 0, beyond()), [Phase::Begun]);
        alarms.set_rules(Vec::new());
        // it stays until it is acknowledged
        assert_eq!(at(&mut alarms, 1, beyond()), []);
        order(&mut alarms, 2, &Order::Acknowledge);
        assert_eq!(at(&mut alarms, 3, beyond()), [Phase::Ended]);
        assert_eq!(at(&mut alarms, 4, beyond()), []);
        // a rule of the same name begins anew
        alarms.set_rules(vec![rule()]);
        assert_eq!(at(&mut alarms, 5, Judgement::Within), []);
        assert_eq!(at(&mut alarms, 6, beyond()), [Phase::Begun]);
    }

    #[tokio::test(start_paused = true)]
    async fn end_names_its_cause_if_the_rule_comes_back_at_once() {
        let (mut notices, mut alarms, begin) = (Notices::default(), alarms(), Instant::now());
        let mut text = |alarms: &Alarms, second| {
            let now = begin + Duration::from_secs(second);
            let due = notices.due(now, alarms, AGAIN);
            let each = due.into_iter().map(|message| (message.phase, message.text));
            each.collect::<Vec<_>>()
        };
        for cause in ["9 kPa", "11 kPa"] {
            alarms.judge(NAME, 0.0, Judgement::Beyond(cause.to_owned()));
            text(&alarms, 0);
        }
        order(&mut alarms, 1, &Order::Acknowledge);
        // between two checks
        alarms.set_rules(Vec::new());
        alarms.set_rules(vec![rule()]);
        let ended = (Phase::Ended, "over; it was: 11 kPa".to_owned());
        assert_eq!(text(&alarms, 5), [ended]);
        assert_eq!(text(&alarms, 10), []);
    }

    #[tokio::test(start_paused = true)]
    async fn an_alarm_that_ends_and_begins_between_two_checks_is_new() {
        let beyond = || Judgement::Beyond("9 kPa".to_owned());
        let (mut notices, mut alarms, begin) = (Notices::default(), alarms(), Instant::now());
        let mut at = |alarms: &mut Alarms, second, judgement| {
            check(&mut notices, alarms, begin, second, judgement)
        };
        assert_eq!(at(&mut alarms, 0, beyond()), [Phase::Begun]);
        order(&mut alarms, 1, &Order::Acknowledge);
        alarms.set_rules(Vec::new());
        alarms.set_rules(vec![rule()]);
        // within the time in which a beginning is notified once
        assert_eq!(at(&mut alarms, 2, beyond()), []);
        assert_eq!(at(&mut alarms, 61, beyond()), [Phase::Begun]);
        assert_eq!(at(&mut alarms, 62, beyond()), []);
    }
}
