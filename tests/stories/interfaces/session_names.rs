//! Sessions and baselines named by `last` and by the beginning of their ids.

use serde_json::Value;

use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, press};

#[test]
fn baselines_are_listed_and_chosen_by_name() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    let id = |lines: &[Value]| lines[0]["session"].as_str().expect("an id").to_owned();
    let (first, second) = (id(&baseline(&stage, 2)), id(&baseline(&stage, 2)));
    let in_use = || -> Vec<(Value, Value)> {
        let listed = ask(&stage, &["baseline", "list"]);
        let pair = |line: &Value| (line["id"].clone(), line["in_use"].clone());
        listed.iter().map(pair).collect()
    };
    let listed = |used: [bool; 2]| {
        [(first.as_str(), used[0]), (second.as_str(), used[1])]
            .map(|(id, used)| (Value::from(id), Value::from(used)))
    };
    assert_eq!(in_use(), listed([false, true]));
    let used = ask(&stage, &["baseline", "use", &first]);
    assert_eq!(used[0]["baseline"], first.as_str());
    assert_eq!(in_use(), listed([true, false]));
    let text = stage
        .tactus(&["baseline", "list"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    let mark = format!("{first}  <- in use");
    assert!(text.stdout.contains(&mark), "{}", text.stdout);
    assert_eq!(
        ask(&stage, &["baseline", "use", "last"])[0]["baseline"],
        second.as_str()
    );
    assert_eq!(in_use(), listed([false, true]));
    let refused = stage
        .tactus(&["baseline", "use", "b"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert_eq!(refused.code, Some(2), "{}", refused.stderr);
    assert!(
        refused.stderr.contains(&first) && refused.stderr.contains(&second),
        "{}",
        refused.stderr
    );
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn session_warns_of_its_own_baseline_and_of_no_other() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    let empty = baseline(&stage, 3)[0]["session"].clone();
    press(&stage, PRESS_MM, 30.0, 0.5);
    let loaded = baseline(&stage, 3)[0]["session"].clone();
    let warnings = |args: &[&str]| -> Vec<String> {
        let lines = ask(&stage, args);
        let warnings = lines.iter().filter(|line| line["event"] == "warning");
        let text = |line: &Value| line["text"].as_str().expect("a text").to_owned();
        warnings.map(text).collect()
    };
    let [empty, loaded] = [&empty, &loaded].map(|id| id.as_str().expect("an id"));
    // the baseline with a load is current
    assert_eq!(warnings(&["start", "--step", "--baseline", empty]), [""; 0]);
    ask(&stage, &["stop"]);
    assert_eq!(warnings(&["baseline", "use", empty]), [""; 0]);
    // now the empty baseline is current
    let found = warnings(&["start", "--step", "--baseline", loaded]);
    ask(&stage, &["stop"]);
    let shows = format!("baseline {loaded}: against baseline {empty}");
    assert!(
        found.iter().any(|text| text.starts_with(&shows)),
        "{found:?}"
    );
    assert_eq!(warnings(&["baseline", "use", loaded]), found);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn running_session_is_named_by_last_and_by_its_beginning() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 2);
    let started = ask(&stage, &["start", "--step", "--baseline", "last"]);
    let id = started[0]["session"].as_str().expect("an id");
    let stepped = ask(&stage, &["step", "--session", "last"]);
    assert_eq!(stepped[0]["session"], id);
    let ended = ask(&stage, &["stop", "m"]);
    assert_eq!(ended[0]["session"], id);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}
