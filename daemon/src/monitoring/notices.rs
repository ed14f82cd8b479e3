//! Decides which alarms are notified and when: once at the beginning and once at the end of an alarm. An alarm that
//! begins repeatedly, or a latched one whose condition comes back, is rate-limited.

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
    /// With another time, it has begun again since then.
    active_since: Option<f64>,
    /// Whether this beginning was notified.
    reported: bool,
    /// Whether a beginning was notified and no end since then, so that the end will be.
    end_due: bool,
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
            if !kept && notice.end_due {
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
    /// The alarm is shelved or out of service, which does not end it: its end is still due.
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
            let end_due = std::mem::take(&mut self.end_due);
            let last = std::mem::take(&mut self.cause);
            let cause = match cause {
                "" => last.as_str(),
                cause => cause,
            };
            return end_due.then(|| message(Phase::Ended, format!("over; it was: {cause}")));
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
        (self.reported, self.end_due) = (true, true);
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

    fn beyond() -> Judgement {
        Judgement::Beyond("9 kPa".to_owned())
    }

    /// An alarm and its notifications.
    struct Scene {
        notices: Notices,
        alarms: Alarms,
        begin: Instant,
    }

    impl Scene {
        fn new() -> Self {
            let mut alarms = Alarms::default();
            alarms.set_rules(vec![rule()]);
            Self {
                notices: Notices::default(),
                alarms,
                begin: Instant::now(),
            }
        }

        /// The notifications of one check at this second.
        fn due(&mut self, second: u32, again: Duration) -> Vec<Message> {
            let now = self.begin + Duration::from_secs(second.into());
            self.notices.due(now, &self.alarms, again)
        }

        /// The phases of the notifications of one check after a judgement at this second.
        fn judged(&mut self, second: u32, judgement: Judgement) -> Vec<Phase> {
            self.alarms.judge(NAME, f64::from(second), judgement);
            let due = self.due(second, Duration::from_secs(60));
            due.into_iter().map(|message| message.phase).collect()
        }

        fn order(&mut self, second: u32, order: &Order) {
            let ordered = self.alarms.order(NAME, second.into(), order, "user 7", "");
            ordered.unwrap();
        }
    }

    #[tokio::test(start_paused = true)]
    async fn no_alarm_is_notified_as_over_because_it_is_shelved() {
        let mut scene = Scene::new();
        assert_eq!(scene.judged(0, beyond()), [Phase::Begun]);
        scene.order(1, &Order::Shelve(100.0));
        assert_eq!(scene.judged(2, beyond()), []);
        // its beginning is notified again when it is no longer shelved
        assert_eq!(scene.judged(101, beyond()), [Phase::Begun]);
        scene.order(102, &Order::OutOfService);
        assert_eq!(scene.judged(103, beyond()), []);
        // its end is notified when it is in service again
        assert_eq!(scene.judged(104, Judgement::Within), []);
        scene.order(105, &Order::InService);
        assert_eq!(scene.judged(106, Judgement::Within), [Phase::Ended]);
        assert_eq!(scene.judged(200, beyond()), [Phase::Begun]);
        // shelving without a time ends with the alarm
        scene.order(201, &Order::ShelveOnce);
        assert_eq!(scene.judged(202, beyond()), []);
        assert_eq!(scene.judged(203, Judgement::Within), [Phase::Ended]);
    }

    #[tokio::test(start_paused = true)]
    async fn an_alarm_whose_rule_is_removed_is_notified_as_over() {
        let mut scene = Scene::new();
        assert_eq!(scene.judged(0, beyond()), [Phase::Begun]);
        scene.alarms.set_rules(Vec::new());
        // it stays until it is acknowledged
        assert_eq!(scene.judged(1, beyond()), []);
        scene.order(2, &Order::Acknowledge);
        assert_eq!(scene.judged(3, beyond()), [Phase::Ended]);
        assert_eq!(scene.judged(4, beyond()), []);
        // a rule of the same name begins anew
        scene.alarms.set_rules(vec![rule()]);
        assert_eq!(scene.judged(5, Judgement::Within), []);
        assert_eq!(scene.judged(6, beyond()), [Phase::Begun]);
    }

    #[tokio::test(start_paused = true)]
    async fn end_names_its_cause_if_the_rule_comes_back_at_once() {
        let mut scene = Scene::new();
        let text = |scene: &mut Scene, second| {
            let due = scene.due(second, AGAIN).into_iter();
            due.map(|message| (message.phase, message.text))
                .collect::<Vec<_>>()
        };
        for cause in ["9 kPa", "11 kPa"] {
            scene
                .alarms
                .judge(NAME, 0.0, Judgement::Beyond(cause.to_owned()));
            text(&mut scene, 0);
        }
        scene.order(1, &Order::Acknowledge);
        // between two checks
        scene.alarms.set_rules(Vec::new());
        scene.alarms.set_rules(vec![rule()]);
        let ended = (Phase::Ended, "over; it was: 11 kPa".to_owned());
        assert_eq!(text(&mut scene, 5), [ended]);
        assert_eq!(text(&mut scene, 10), []);
    }

    #[tokio::test(start_paused = true)]
    async fn an_alarm_that_ends_and_begins_between_two_checks_is_new() {
        let mut scene = Scene::new();
        assert_eq!(scene.judged(0, beyond()), [Phase::Begun]);
        scene.order(1, &Order::Acknowledge);
        scene.alarms.set_rules(Vec::new());
        scene.alarms.set_rules(vec![rule()]);
        // within the time in which a beginning is notified once
        assert_eq!(scene.judged(2, beyond()), []);
        assert_eq!(scene.judged(61, beyond()), [Phase::Begun]);
        assert_eq!(scene.judged(62, beyond()), []);
        for second in [63, 64] {
            scene
                .alarms
                .judge(NAME, f64::from(second), Judgement::Within);
            assert_eq!(scene.judged(second, beyond()), []);
        }
        // the beginning at 61 s was notified: so is the end, though the last beginning was not
        assert_eq!(scene.judged(65, Judgement::Within), [Phase::Ended]);
        assert_eq!(scene.judged(66, Judgement::Within), []);
    }

    #[tokio::test(start_paused = true)]
    async fn an_end_is_notified_soon_after_the_alarm_is_unshelved() {
        let mut scene = Scene::new();
        assert_eq!(scene.judged(0, beyond()), [Phase::Begun]);
        scene.order(1, &Order::Shelve(10.0));
        assert_eq!(scene.judged(2, beyond()), []);
        // active again, within the time in which a beginning is notified once
        assert_eq!(scene.judged(12, beyond()), []);
        assert_eq!(scene.judged(13, Judgement::Within), [Phase::Ended]);
    }
}
