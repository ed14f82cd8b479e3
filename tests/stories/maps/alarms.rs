//! Alarms of a running daemon: they begin and end with a press, survive a restart, and do not treat unknown values as
//! ok.

use serde_json::Value;
use tactus_tests::Stage;

use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, press, release};

const RULES: &str = "\n[[region]]\nname = \"press\"\nrectangle_mm = [60.0, 115.0, 100.0, 155.0]\n\
    [[alarm]]\nname = \"heavy\"\nquantity = \"contact\"\nregion = \"press\"\nabove = 100.0\ndeadband = 50.0\nfor_s = 0.5\n\
    severity = \"major\"\nlatched = true\nguidance = \"lift it\"\n\
    [[alarm]]\nname = \"skin\"\nquantity = \"unrelieved-area\"\nabove = 100.0\nfor_s = 0.0\n";

/// Largest number of polls until an alarm is in a state; a frame passes between two.
const LOOKS: usize = 200;

/// The alarm with this name, and the exit code of the list.
fn alarm(stage: &Stage, name: &str) -> (Value, Option<i32>) {
    let output = stage
        .tactus(&["--json", "alarms"])
        .expect("the program runs");
    let lines = output.stdout.lines();
    let mut alarms = lines.map(|line| serde_json::from_str::<Value>(line).expect("JSON"));
    let found = alarms.find(|alarm| alarm["name"] == name);
    (found.expect("the alarm is listed"), output.code)
}

/// Waits until the alarm is as wanted.
fn wait_for(stage: &Stage, name: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    for _ in 0..LOOKS {
        let (found, _) = alarm(stage, name);
        if wanted(&found) {
            return found;
        }
        ask(stage, &["watch", "--no-map", "--count", "1"]);
    }
    panic!("never so: {:?}", alarm(stage, name));
}

#[test]
fn an_alarm_begins_with_a_press_and_outlives_a_restart() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{RULES}")
    }) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let (idle, code) = alarm(&stage, "heavy");
    assert_eq!((&idle["level"], code), (&Value::Null, Some(0)), "{idle}");
    let begun = ask(&stage, &["start", "--every", "200ms"]);
    let id = begun[0]["session"].as_str().expect("its id").to_owned();
    wait_for(&stage, "heavy", |alarm| alarm["level"] == "ok");
    // four hours must pass before this quantity is known
    let unknown = wait_for(&stage, "skin", |alarm| alarm["level"] == "invalid");
    assert!(
        unknown["invalid"]
            .as_str()
            .is_some_and(|why| why.contains("not known yet")),
        "{unknown}"
    );
    let status = ask(&stage, &["status"]);
    assert_eq!(status[0]["health"]["well"], false, "{status:?}");

    press(&stage, PRESS_MM, 30.0, 0.5);
    let active = wait_for(&stage, "heavy", |alarm| alarm["active"] == true);
    assert_eq!(
        (&active["level"], &active["acknowledged"]),
        (&"major".into(), &false.into())
    );
    assert!(
        active["cause"]
            .as_str()
            .is_some_and(|cause| cause.starts_with("contact of press ")),
        "{active}"
    );
    let listed = stage.tactus(&["alarms"]).expect("the program runs");
    assert_eq!(listed.code, Some(1), "{}", listed.stderr);
    for wanted in [
        "heavy",
        "ACTIVE, major, not acknowledged",
        "lift it",
        "CANNOT BE JUDGED",
    ] {
        assert!(
            listed.stdout.contains(wanted),
            "{wanted}\n{}",
            listed.stdout
        );
    }
    let early = stage
        .tactus(&["alarms", "reset", "heavy"])
        .expect("the program runs");
    assert_eq!(early.code, Some(1), "{}", early.stderr);
    assert!(
        early.stderr.contains("not known to be gone"),
        "{}",
        early.stderr
    );
    let nobody = stage
        .tactus(&["alarms", "ack", "havy"])
        .expect("the program runs");
    assert_eq!(nobody.code, Some(2), "{}", nobody.stderr);
    assert!(nobody.stderr.contains("there are: "), "{}", nobody.stderr);
    release(&stage);
    let held = wait_for(&stage, "heavy", |alarm| alarm["held"] == true);
    assert_eq!(held["active"], true, "{held}");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));

    let events = ask(&stage, &["events", &id]);
    let kinds: Vec<&str> = events
        .iter()
        .filter(|event| {
            event["text"]
                .as_str()
                .is_some_and(|text| text.starts_with("heavy: "))
        })
        .filter_map(|event| event["kind"].as_str())
        // on a busy machine the release can occur during a frame, whose map then cannot be judged
        .filter(|kind| !["alarm-invalid", "alarm-judged"].contains(kind))
        .collect();
    assert_eq!(kinds, ["alarm-active", "alarm-held"], "{events:?}");
    assert!(
        events.iter().any(|event| event["kind"] == "alarm-invalid"),
        "{events:?}"
    );

    let daemon = test_rig::start(&stage);
    let (again, code) = alarm(&stage, "heavy");
    assert_eq!(
        (&again["active"], &again["acknowledged"]),
        (&true.into(), &false.into()),
        "{again}"
    );
    assert_eq!(code, Some(1));
    ask(&stage, &["alarms", "shelve", "heavy", "--for", "1h"]);
    assert_eq!(
        alarm(&stage, "heavy").1,
        Some(0),
        "a shelved alarm notifies nobody"
    );
    ask(&stage, &["alarms", "unshelve", "heavy"]);
    ask(&stage, &["alarms", "ack", "heavy", "--comment", "lifted"]);
    let reset = ask(&stage, &["alarms", "reset", "heavy"]);
    assert_eq!(
        (&reset[0]["active"], &reset[0]["acknowledged"]),
        (&false.into(), &true.into())
    );
    let by = reset[0]["acknowledged_by"].as_str().expect("somebody did");
    assert!(
        by.starts_with("by user ") && by.ends_with(": lifted"),
        "{by}"
    );
    assert_eq!(alarm(&stage, "heavy").1, Some(0));
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let log = ask(&stage, &["log"]);
    assert!(
        log.iter().any(|event| event["kind"] == "alarm-handled"),
        "{log:?}"
    );
}
