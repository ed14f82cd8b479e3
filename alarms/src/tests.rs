use crate::*;
use proptest::prelude::*;

const NAME: &str = "heel";

fn rule(latched: bool) -> Rule {
    Rule {
        name: NAME.to_owned(),
        severity: Severity::Major,
        on_s: 10.0,
        off_s: 20.0,
        latched,
    }
}

fn alarms(latched: bool) -> Alarms {
    let mut alarms = Alarms::default();
    alarms.set_rules(vec![rule(latched)]);
    alarms
}

fn beyond() -> Judgement {
    Judgement::Beyond("9 kPa, above 8 kPa".to_owned())
}

fn unknown() -> Judgement {
    Judgement::Unknown("no frame".to_owned())
}

/// Judges once a second from `from` to `to`; returns the time and kind of each transition.
fn play(
    alarms: &mut Alarms,
    from: u32,
    to: u32,
    judgement: &Judgement,
) -> Vec<(u32, TransitionKind)> {
    let mut seen = Vec::new();
    for second in from..to {
        let transitions = alarms.judge(NAME, f64::from(second), judgement.clone());
        seen.extend(transitions.iter().map(|one| (second, one.kind)));
    }
    seen
}

fn level(alarms: &Alarms) -> Option<Level> {
    alarms.get(NAME).unwrap().level()
}

fn order(alarms: &mut Alarms, at_s: f64, order: Order) -> Result<Vec<Transition>, Refused> {
    alarms.order(NAME, at_s, &order, "user 7", "")
}

#[test]
fn begins_after_its_delay_and_ends_after_the_other() {
    let mut alarms = alarms(false);
    assert_eq!(level(&alarms), Some(Level::Invalid));
    assert_eq!(play(&mut alarms, 0, 30, &Judgement::Within), []);
    assert_eq!(level(&alarms), Some(Level::Ok));
    assert_eq!(play(&mut alarms, 30, 39, &beyond()), []);
    // one second too short: the alarm does not begin
    assert_eq!(play(&mut alarms, 39, 40, &Judgement::Deadband), []);
    let begun = play(&mut alarms, 40, 60, &beyond());
    assert_eq!(begun, [(50, TransitionKind::Active)]);
    assert_eq!(level(&alarms), Some(Level::Major));
    // the deadband does not end it, and nor does a short time below
    assert_eq!(play(&mut alarms, 60, 100, &Judgement::Deadband), []);
    assert_eq!(play(&mut alarms, 100, 119, &Judgement::Within), []);
    assert_eq!(play(&mut alarms, 119, 120, &beyond()), []);
    let ended = play(&mut alarms, 120, 150, &Judgement::Within);
    assert_eq!(ended, [(140, TransitionKind::Over)]);
    assert_eq!(level(&alarms), Some(Level::Ok));
    assert!(!alarms.get(NAME).unwrap().state.acknowledged);
}

#[test]
fn what_cannot_be_judged_is_no_all_clear() {
    let mut alarms = alarms(false);
    play(&mut alarms, 0, 30, &Judgement::Within);
    let lost = play(&mut alarms, 30, 40, &unknown());
    assert_eq!(lost, [(30, TransitionKind::Invalid)]);
    assert_eq!(level(&alarms), Some(Level::Invalid));
    // judged for too short a time
    assert_eq!(play(&mut alarms, 40, 59, &Judgement::Within), []);
    assert_eq!(level(&alarms), Some(Level::Invalid));
    let begun = play(&mut alarms, 59, 80, &beyond());
    assert_eq!(
        begun,
        [(60, TransitionKind::Judged), (69, TransitionKind::Active)]
    );
    // unknown for an hour: still active
    play(&mut alarms, 80, 3680, &unknown());
    assert_eq!(level(&alarms), Some(Level::Major));
    // the time without a judgement does not count towards the end
    play(&mut alarms, 3680, 3699, &Judgement::Within);
    play(&mut alarms, 3699, 3700, &unknown());
    assert_eq!(play(&mut alarms, 3700, 3720, &Judgement::Within), []);
    let ended = play(&mut alarms, 3720, 3721, &Judgement::Within);
    assert_eq!(
        ended,
        [(3720, TransitionKind::Judged), (3720, TransitionKind::Over)]
    );
}

#[test]
fn a_gap_does_not_delay_the_beginning() {
    let mut alarms = alarms(false);
    play(&mut alarms, 0, 5, &beyond());
    play(&mut alarms, 5, 10, &unknown());
    let begun = alarms.judge(NAME, 10.0, beyond());
    assert_eq!(begun.last().unwrap().kind, TransitionKind::Active);
}

#[test]
fn a_latched_alarm_ends_by_a_reset_only() {
    let mut alarms = alarms(true);
    play(&mut alarms, 0, 11, &beyond());
    assert!(matches!(
        order(&mut alarms, 11.0, Order::Reset),
        Err(Refused::StillBeyond(..))
    ));
    let held = play(&mut alarms, 11, 1000, &Judgement::Within);
    assert!(held.contains(&(31, TransitionKind::Held)), "{held:?}");
    assert_eq!(level(&alarms), Some(Level::Major));
    // the condition recurs: it must be acknowledged again
    order(&mut alarms, 1000.0, Order::Acknowledge).unwrap();
    assert_eq!(
        play(&mut alarms, 1000, 1001, &beyond()),
        [(1000, TransitionKind::Active)]
    );
    assert!(!alarms.get(NAME).unwrap().state.acknowledged);
    play(&mut alarms, 1001, 1100, &Judgement::Within);
    order(&mut alarms, 1100.0, Order::Reset).unwrap();
    assert_eq!(level(&alarms), Some(Level::Ok));
    // a reset does not acknowledge
    assert!(!alarms.get(NAME).unwrap().state.acknowledged);
    assert!(matches!(
        order(&mut alarms, 1101.0, Order::Reset),
        Err(Refused::NotLatched(_))
    ));
}

#[test]
fn only_a_latched_alarm_is_reset_also_by_a_changed_rule() {
    let mut alarms = alarms(false);
    play(&mut alarms, 0, 11, &beyond());
    let refused = order(&mut alarms, 11.0, Order::Reset);
    assert!(matches!(refused, Err(Refused::NotLatched(_))));
    alarms.set_rules(vec![rule(true)]);
    play(&mut alarms, 11, 40, &Judgement::Within);
    alarms.set_rules(vec![rule(false)]);
    order(&mut alarms, 40.0, Order::Reset).unwrap();
    assert!(!alarms.get(NAME).unwrap().state.active);
}

#[test]
fn a_shelved_alarm_is_evaluated_without_a_notification() {
    let mut alarms = alarms(false);
    assert_eq!(
        order(&mut alarms, 0.0, Order::ShelveOnce),
        Err(Refused::NotActive(NAME.into()))
    );
    for wrong in [0.0, -1.0, f64::NAN, LONGEST_SHELF_S + 1.0] {
        assert_eq!(
            order(&mut alarms, 0.0, Order::Shelve(wrong)),
            Err(Refused::ShelfTime)
        );
    }
    order(&mut alarms, 0.0, Order::Shelve(100.0)).unwrap();
    let begun = play(&mut alarms, 0, 99, &beyond());
    assert!(begun.contains(&(10, TransitionKind::Active)));
    assert!(!alarms.get(NAME).unwrap().notifies());
    assert_eq!(
        play(&mut alarms, 99, 110, &beyond()),
        [(100, TransitionKind::Handled)]
    );
    assert!(alarms.get(NAME).unwrap().notifies());
    order(&mut alarms, 110.0, Order::ShelveOnce).unwrap();
    assert!(!alarms.get(NAME).unwrap().notifies());
    play(&mut alarms, 110, 200, &Judgement::Within);
    assert!(alarms.get(NAME).unwrap().state.shelf.is_none());
    order(&mut alarms, 200.0, Order::OutOfService).unwrap();
    assert_eq!(level(&alarms), None);
    play(&mut alarms, 200, 220, &beyond());
    assert!(!alarms.get(NAME).unwrap().notifies());
    order(&mut alarms, 220.0, Order::InService).unwrap();
    assert!(alarms.get(NAME).unwrap().notifies());
}

#[test]
fn a_suppressed_alarm_is_neither_ok_nor_invalid() {
    let mut alarms = alarms(false);
    let idle = Judgement::Suppressed("no measurement runs".to_owned());
    assert_eq!(play(&mut alarms, 0, 100, &idle), []);
    assert_eq!(level(&alarms), None);
    play(&mut alarms, 100, 120, &beyond());
    assert_eq!(play(&mut alarms, 120, 1000, &idle), []);
    assert_eq!(level(&alarms), Some(Level::Major));
}

#[test]
fn a_removed_rule_stays_until_it_is_acknowledged() {
    let mut alarms = alarms(false);
    play(&mut alarms, 0, 20, &beyond());
    alarms.set_rules(Vec::new());
    let orphan = alarms.get(NAME).unwrap();
    assert!(orphan.removed && orphan.notifies());
    assert_eq!(play(&mut alarms, 20, 100, &Judgement::Within), []);
    let done = order(&mut alarms, 100.0, Order::Acknowledge).unwrap();
    let kinds: Vec<_> = done.iter().map(|one| one.kind).collect();
    assert_eq!(kinds, [TransitionKind::Handled, TransitionKind::Over]);
    assert_eq!(alarms.get(NAME), None);
    assert!(matches!(
        order(&mut alarms, 100.0, Order::Acknowledge),
        Err(Refused::NoAlarm { .. })
    ));
}

#[test]
fn an_acknowledged_alarm_ends_with_its_rule() {
    let mut alarms = alarms(false);
    play(&mut alarms, 0, 20, &beyond());
    order(&mut alarms, 20.0, Order::Acknowledge).unwrap();
    let gone = alarms.set_rules(Vec::new());
    assert_eq!(gone.len(), 1, "{gone:?}");
    assert_eq!(gone[0].kind, TransitionKind::Over);
    assert!(gone[0].text.contains("9 kPa"), "{gone:?}");
    // an alarm that was not active has no end
    alarms.set_rules(vec![rule(false)]);
    assert_eq!(alarms.set_rules(Vec::new()), []);
}

#[test]
fn a_clock_that_is_set_back_begins_anew() {
    let mut alarms = alarms(false);
    play(&mut alarms, 1000, 1005, &beyond());
    let begun = play(&mut alarms, 500, 520, &beyond());
    assert!(begun.contains(&(510, TransitionKind::Active)), "{begun:?}");
}

#[test]
fn a_shelf_ends_when_the_clock_is_set_back() {
    const SET_S: f64 = 1e9;
    let mut alarms = alarms(false);
    order(&mut alarms, SET_S, Order::Shelve(3600.0)).unwrap();
    // a small correction of the clock does not end it
    assert_eq!(alarms.judge(NAME, SET_S - 1.0, Judgement::Within), []);
    assert!(alarms.get(NAME).unwrap().state.shelf.is_some());
    let changed = alarms.judge(NAME, SET_S - 30.0 * 86_400.0, Judgement::Within);
    let texts: Vec<_> = changed.iter().map(|one| one.text.as_str()).collect();
    assert_eq!(texts, ["is no longer shelved: the clock was set back"]);
    assert!(alarms.get(NAME).unwrap().state.shelf.is_none());
}

/// One step of a random history.
#[derive(Debug, Clone)]
enum Step {
    Judge(Judgement),
    Order(Order),
    Restart,
    RuleGone,
}

fn step() -> impl Strategy<Value = Step> {
    let judgement = prop_oneof![
        3 => Just(beyond()),
        2 => Just(Judgement::Within),
        1 => Just(Judgement::Deadband),
        2 => Just(unknown()),
        1 => Just(Judgement::Suppressed("no measurement runs".to_owned())),
    ];
    let order = prop_oneof![
        Just(Order::Acknowledge),
        Just(Order::Shelve(30.0)),
        Just(Order::ShelveOnce),
        Just(Order::Unshelve),
        Just(Order::Reset),
        Just(Order::OutOfService),
        Just(Order::InService),
    ];
    prop_oneof![
        12 => judgement.prop_map(Step::Judge),
        2 => order.prop_map(Step::Order),
        1 => Just(Step::Restart),
        1 => Just(Step::RuleGone),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]
    /// No sequence of judgements, orders, restarts and reloads loses an unacknowledged alarm, ends an alarm on unknown
    /// data, or reports an unjudged alarm as ok.
    #[test]
    fn no_history_loses_an_unacknowledged_alarm(
        latched: bool,
        steps in prop::collection::vec((step(), 0.0..15.0f64), 1..120),
    ) {
        let mut alarms = alarms(latched);
        let mut at_s = 0.0;
        // the expected state, tracked independently of the code under test
        let (mut due, mut active) = (false, false);
        let mut judged = false;
        for (step, wait_s) in steps {
            at_s += wait_s;
            let transitions = match step {
                Step::Judge(judgement) => {
                    let known = !matches!(
                        judgement,
                        Judgement::Unknown(_) | Judgement::Suppressed(_)
                    );
                    judged = known;
                    let transitions = alarms.judge(NAME, at_s, judgement);
                    for one in &transitions {
                        match one.kind {
                            TransitionKind::Active => (active, due) = (true, true),
                            TransitionKind::Over => {
                                prop_assert!(known && !latched);
                                active = false;
                            }
                            TransitionKind::Held => prop_assert!(known && latched),
                            _ => {}
                        }
                    }
                    transitions
                }
                Step::Order(order) => {
                    let held = alarms.get(NAME).is_some_and(|alarm| alarm.state.held);
                    let done = alarms.order(NAME, at_s, &order, "user 7", "");
                    match (order, &done) {
                        (Order::Acknowledge, Ok(_)) => due = false,
                        (Order::Reset, Ok(_)) => {
                            prop_assert!(held);
                            active = false;
                        }
                        _ => {}
                    }
                    done.unwrap_or_default()
                }
                Step::Restart => {
                    let stored = serde_json::to_string(&alarms).unwrap();
                    alarms = serde_json::from_str(&stored).unwrap();
                    alarms.restarted();
                    judged = false;
                    Vec::new()
                }
                Step::RuleGone => {
                    alarms.set_rules(Vec::new());
                    prop_assert_eq!(alarms.get(NAME).is_some(), due);
                    alarms.set_rules(vec![rule(latched)]);
                    if !due {
                        active = false;
                    }
                    judged = false;
                    Vec::new()
                }
            };
            for one in &transitions {
                prop_assert!(!one.text.is_empty());
            }
            let Some(alarm) = alarms.get(NAME) else {
                return Err(TestCaseError::fail("the alarm is gone"));
            };
            prop_assert_eq!(alarm.state.acknowledged, !due);
            prop_assert_eq!(alarm.state.active, active);
            if alarm.level() == Some(Level::Ok) {
                prop_assert!(judged, "not judged, and reported as well");
            }
        }
    }
}
