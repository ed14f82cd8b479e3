//! Tests of the stored state, and of rules that are removed.

use alarms::Severity;

use super::*;

/// The stored state of an active and acknowledged alarm.
fn stored(name: &str) -> Vec<u8> {
    let rule = alarms::Rule {
        name: name.to_owned(),
        severity: Severity::Major,
        on_s: 0.0,
        off_s: 0.0,
        latched: false,
    };
    let mut alarms = Alarms::default();
    alarms.set_rules(vec![rule]);
    alarms.judge(name, 0.0, Judgement::Beyond("9 kPa".to_owned()));
    let seen = alarms.order(name, 0.0, &Order::Acknowledge, "user 7", "");
    seen.unwrap();
    serde_json::to_vec(&alarms).unwrap()
}

fn kinds(changes: &[Change]) -> Vec<EventKind> {
    changes.iter().map(|change| change.kind).collect()
}

#[test]
fn a_state_that_cannot_be_read_is_kept_under_another_name() {
    // no JSON, and no text
    for damaged in [b"{".as_slice(), b"\xff\xfe"] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        std::fs::write(&path, damaged).unwrap();
        let (_, changes) = AlarmDesk::open(folder.path(), &Config::default());
        assert_eq!(kinds(&changes), [EventKind::AlarmInvalid]);
        assert!(changes[0].text.contains(DAMAGED), "{changes:?}");
        store(&path, &Alarms::default()).unwrap();
        let kept = std::fs::read(folder.path().join(DAMAGED)).unwrap();
        assert_eq!(kept, damaged);
    }
    // a folder in its place
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join(FILE)).unwrap();
    let (_, changes) = AlarmDesk::open(folder.path(), &Config::default());
    assert_eq!(kinds(&changes), [EventKind::AlarmInvalid]);
    assert!(folder.path().join(DAMAGED).is_dir());
}

#[tokio::test]
async fn an_alarm_ends_once_when_its_rule_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FILE);
    let without = Config::default();
    // while no daemon runs
    std::fs::write(&path, stored("heel")).unwrap();
    let (_, changes) = AlarmDesk::open(folder.path(), &without);
    assert_eq!(kinds(&changes), [EventKind::AlarmOver]);
    let (_, again) = AlarmDesk::open(folder.path(), &without);
    assert_eq!(again, []);
    // by a reload
    std::fs::write(&path, stored("heel")).unwrap();
    let rule = toml::from_str("name = \"heel\"\nquantity = \"ppi\"\nabove = 0.3\n");
    let with = Config {
        alarm: vec![rule.unwrap()],
        ..Config::default()
    };
    let (desk, changes) = AlarmDesk::open(folder.path(), &with);
    assert_eq!(changes, []);
    let changes = desk.take_rules(&without).await;
    assert_eq!(kinds(&changes), [EventKind::AlarmOver]);
    assert!(changes[0].text.contains("heel: over"), "{changes:?}");
    assert!(desk.shown().alarms.get("heel").is_none());
    assert_eq!(desk.take_rules(&without).await, []);
}
