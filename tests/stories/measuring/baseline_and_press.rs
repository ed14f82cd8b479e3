//! The main use case: after a baseline, the position of a press is found.

use dbus::{Address, Simulation1Proxy};

use crate::test_rig::{self, Needs, ask, baseline, measure};

#[test]
fn press_is_located_where_it_is() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 10);
    let truth = [0.0847, 0.1387];
    test_rig::runtime().block_on(async {
        let (connection, _) = dbus::connect(Some(&Address::Unix(stage.peer_path())))
            .await
            .expect("the daemon listens");
        let hand = Simulation1Proxy::new(&connection)
            .await
            .expect("a simulated rig has a hand");
        hand.press("disc", truth[0], truth[1], 0.010, 0.5)
            .await
            .expect("the place is on the sheet");
    });
    let id = measure(&stage, 1);
    let found = &ask(&stage, &["replay", &id, "--no-map"])[0];
    assert_eq!(
        found["verified"], true,
        "the map that the daemon recorded is made again, bit for bit: {found}"
    );
    assert_eq!(found["simulated"], true);
    let place = &found["found_mm"];
    let off = (place[0].as_f64().expect("x") - truth[0] * 1e3)
        .hypot(place[1].as_f64().expect("y") - truth[1] * 1e3);
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
