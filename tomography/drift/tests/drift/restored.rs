//! The state of a tracked baseline: stored and restored, with another noise, and after the clock was set back.

use std::sync::Arc;

use drift::{Tracker, TrackerState};
use serde_json::{Value, json};

use crate::sheet::Sheet;
use crate::walk::{EVERY_S, follow, walked};

#[test]
fn restored_state_goes_on_with_the_same_bits() {
    let (mut walk, mut tracker) = walked(45);
    let text = serde_json::to_string(tracker.state()).unwrap();
    let state: TrackerState = serde_json::from_str(&text).unwrap();
    let mut again = Tracker::restore(Arc::clone(&walk.model), state).unwrap();
    for frame in 46..=80 {
        let readings = walk.frame(None);
        let at_s = EVERY_S * frame as f64;
        let (one, two) = (
            tracker.follow(&readings, at_s),
            again.follow(&readings, at_s),
        );
        assert_eq!(one.unwrap(), two.unwrap());
        assert_eq!(tracker.state(), again.state());
    }
    let other = Arc::new(Sheet::with_gain(1.01).model());
    let refused = Tracker::restore(other, tracker.state().clone());
    assert!(refused.is_err_and(|fault| fault.to_string().contains("baseline")));
}

#[test]
fn pace_is_followed_anew_where_the_noise_is_another_one() {
    let (walk, tracker) = walked(20);
    let state = serde_json::to_value(tracker.state()).unwrap();
    let restored = |noise_v: f64, state: &Value| {
        let model = Arc::new(walk.sheet.model_with_noise(noise_v));
        let state: TrackerState = serde_json::from_value(state.clone()).unwrap();
        let restored = Tracker::restore(model, state).unwrap();
        serde_json::to_value(restored.state()).unwrap()
    };
    assert_eq!(restored(2e-6, &state), state);
    // its coordinates are in units of the noise
    let other = restored(4e-6, &state);
    let filters = other["pace"]["filters"].as_array().expect("a list");
    let ones = "3ff0000000000000".repeat(299);
    for filter in filters {
        assert_eq!(filter["variance"], json!(ones));
        assert_eq!(filter["mean"], filters[0]["mean"]);
    }
    assert_ne!(filters[0]["mean"], state["pace"]["filters"][0]["mean"]);
    assert_eq!(other["baseline"], state["baseline"]);
    // a state without its noise is taken as it is
    let mut older = state.clone();
    older.as_object_mut().expect("an object").remove("noise");
    assert_eq!(restored(2e-6, &older), state);
}

#[test]
fn state_with_a_length_or_index_of_another_sheet_is_refused() {
    let (mut walk, mut tracker) = walked(3);
    let load = walk.model.disc([0.06, 0.07], 0.06) * -0.3;
    follow(&mut tracker, &mut walk, 4, Some((&load, 1.0)));
    let whole = serde_json::to_value(tracker.state()).unwrap();
    let restore = |state: Value| {
        let state: TrackerState = serde_json::from_value(state).unwrap();
        Tracker::restore(Arc::clone(&walk.model), state)
    };
    assert!(restore(whole.clone()).is_ok());
    let one = json!("3ff0000000000000");
    for (field, place, damaged) in [
        ("baseline", "/baseline", one.clone()),
        ("covariance", "/covariance", one.clone()),
        ("last", "/last", one.clone()),
        ("last_rows", "/last_rows", json!([0, 299])),
        ("last_rows", "/last_rows", json!([1, 0])),
        ("ledger", "/ledger/entries/0/before", one.clone()),
        ("ledger", "/ledger/peak", one.clone()),
        ("pace", "/pace/filters", json!([])),
        ("pace", "/pace/filters/2/mean", one.clone()),
        ("pace", "/pace/filters/2/variance", one.clone()),
        ("anchors", "/anchors/kept/0/baseline", one.clone()),
        (
            "faults",
            "/faults",
            json!([{"electrode": 26, "last_s": one}]),
        ),
    ] {
        let mut state = whole.clone();
        *state.pointer_mut(place).unwrap() = damaged;
        let refused = restore(state).err().map(|fault| fault.to_string());
        let expected = format!("its {field} does not fit");
        assert!(
            refused
                .as_ref()
                .is_some_and(|text| text.contains(&expected)),
            "{place}: {refused:?}"
        );
    }
}

#[test]
fn clock_that_was_a_year_ahead_delays_nothing() {
    let (mut walk, mut tracker) = walked(20);
    follow(&mut tracker, &mut walk, 21 + 365 * 144, None);
    for frame in 22..=22 + 2 * 144 {
        follow(&mut tracker, &mut walk, frame, None);
    }
    let state = serde_json::to_value(tracker.state()).unwrap();
    let seconds = |value: &Value| {
        let digits = value.as_str().expect("hexadecimal digits");
        f64::from_bits(u64::from_str_radix(digits, 16).unwrap())
    };
    // the pace is chosen, and a baseline is kept, once a day
    let days = [22.0, 22.0 + 144.0, 22.0 + 2.0 * 144.0].map(|frame| EVERY_S * frame);
    assert_eq!(seconds(&state["pace"]["chosen_s"]), days[2]);
    let kept = state["anchors"]["kept"].as_array().expect("a list");
    let kept: Vec<f64> = kept.iter().map(|one| seconds(&one["at_s"])).collect();
    assert_eq!(kept, days);
}
