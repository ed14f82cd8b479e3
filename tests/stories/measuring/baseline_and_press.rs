//! The main use case: after a baseline, the position of a press is found.

use crate::test_rig::{self, Needs, ask, baseline, measure, press};

#[test]
fn press_is_located_where_it_is() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 10);
    let truth = [84.7, 138.7];
    press(&stage, truth, 10.0, 0.5);
    let id = measure(&stage, 1);
    let found = &ask(&stage, &["replay", &id, "--no-map"])[0];
    assert_eq!(
        found["verified"], true,
        "the map that the daemon recorded is made again, bit for bit: {found}"
    );
    assert_eq!(found["simulated"], true);
    let place = &found["found_mm"];
    let off =
        (place[0].as_f64().expect("x") - truth[0]).hypot(place[1].as_f64().expect("y") - truth[1]);
    assert!(off < 5.0, "{off} mm off: {found}");
}

#[test]
fn start_without_a_baseline_is_refused_with_advice() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    let refused = stage
        .tactus(&["start", "--count", "1"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert_eq!(refused.code, Some(3), "{}", refused.stderr);
    assert!(
        refused.stderr.contains("baseline record"),
        "{}",
        refused.stderr
    );
}
