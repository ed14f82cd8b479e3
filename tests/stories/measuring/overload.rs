//! A reading over range is missing: flagged, counted, masked, blank in the export, and never a number.

use crate::test_rig::{self, Needs, ask, baseline, measure, number};

#[test]
fn overload_is_never_recorded_as_a_number() {
    // the largest readings of the sheet are about 300 mV: on the 0.1 V range those near the corners overload
    let narrow = |config: &str| config.replace("range_v = 1.0", "range_v = 0.1");
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, narrow) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 2);
    let id = measure(&stage, 1);
    let shown = &ask(&stage, &["baseline", "show"])[0];
    let missing = number(shown, "missing") as usize;
    assert!(
        (4..100).contains(&missing),
        "{missing} readings are over the range"
    );

    let text = test_rig::export_csv(&stage, &id);
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let row: Vec<&str> = lines.next().expect("a frame").split(',').collect();
    let first = header
        .iter()
        .position(|name| *name == "m0_V")
        .expect("readings have columns");
    let blanks = row[first..].iter().filter(|field| field.is_empty()).count();
    assert_eq!(blanks, missing, "a blank for every overload");
    for field in row[first..].iter().filter(|field| !field.is_empty()) {
        let volts: f64 = field.parse().expect("a voltage");
        assert!(volts.abs() <= 0.12, "{volts} V on a range of 0.1 V");
    }
    let replayed = &ask(&stage, &["replay", &id, "--no-map"])[0];
    assert_eq!(
        number(replayed, "masked") as usize,
        missing,
        "masked in the reconstruction: {replayed}"
    );
}
