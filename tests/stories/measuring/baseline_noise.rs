//! Repeated readings of an unloaded sheet agree within the voltmeter's noise.

use crate::test_rig::{self, Needs, ask, baseline, number};

/// Noise of a reading at 1 PLC relative to its range (34970A integration table, same converter), taken as rms; a real
/// rig's noise may be ten times that before its wiring is suspect.
const NOISE_OF_RANGE: f64 = 3e-6;
const ALLOWANCE: f64 = 10.0;

#[test]
fn baseline_noise_is_the_voltmeters_noise() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 10);
    let shown = &ask(&stage, &["baseline", "show"])[0];
    let noise = number(shown, "noise_v");
    let range = number(shown, "range_v");
    assert!(
        noise < ALLOWANCE * NOISE_OF_RANGE * range,
        "{noise} V on a range of {range} V"
    );
    assert!(noise > 0.0, "a voltmeter without noise is a stuck one");
    assert_eq!(shown["missing"], 0);
    assert_eq!(shown["readings"], 598);
}

#[test]
fn baseline_measures_the_noise_of_the_scene() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 20);
    let noise = number(&ask(&stage, &["baseline", "show"])[0], "noise_v");
    // 598 readings with 19 degrees of freedom each: the estimate is accurate to 1 %
    assert!(
        (noise / 2e-6 - 1.0).abs() < 0.05,
        "{noise} V, the scene says 2 uV"
    );
}
