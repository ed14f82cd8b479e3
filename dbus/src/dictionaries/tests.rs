use zbus::wire::serialized::Context;
use zbus::wire::{LE, to_bytes};

use crate::dictionaries::*;
use crate::{LatestMap, Options};

fn context() -> Context {
    Context::new(LE, 0)
}

#[test]
fn unknown_keys_are_ignored_and_missing_ones_are_none() {
    let sent = Options::new()
        .with("well", true)
        .with("relay", 1001_u32)
        .with("a_key_of_the_next_version", 7_u64);
    let bytes = to_bytes(context(), &sent).unwrap();
    let (health, _): (Health, _) = bytes.deserialize().unwrap();
    let expected = Health {
        well: Some(true),
        relay: Some(1001),
        ..Health::default()
    };
    assert_eq!(health, expected);
    let wrong = to_bytes(context(), &Options::new().with("backlog", "two")).unwrap();
    assert!(wrong.deserialize::<Health>().is_err());
}

#[test]
fn absent_values_are_no_keys_on_the_wire() {
    let mut plan = PlanDetails {
        wiring: Some("pairs".to_owned()),
        ..PlanDetails::default()
    };
    plan.set_cost(SettingCost {
        setting: "half",
        seconds: -2.5,
        gain: 0.5,
    });
    let bytes = to_bytes(context(), &plan).unwrap();
    let (sent, _): (Options, _) = bytes.deserialize().unwrap();
    let mut keys: Vec<_> = sent.0.keys().map(String::as_str).collect();
    keys.sort_unstable();
    assert_eq!(keys, ["cost_half_s", "gain_half", "wiring"]);
    let (back, _): (PlanDetails, _) = bytes.deserialize().unwrap();
    assert_eq!(back, plan);
    assert_eq!(back.costs().len(), 1);
}

#[test]
fn a_frame_summary_is_one_flat_dictionary() {
    let summary = FrameSummary {
        frames_acquired: Some(8),
        quality: FrameQuality {
            flags: Some("loop_sum".to_owned()),
            ..FrameQuality::default()
        },
        map: MapDetails {
            newtons: Some(19.6),
            ..MapDetails::default()
        },
        ..FrameSummary::default()
    };
    let bytes = to_bytes(context(), &summary).unwrap();
    let (sent, _): (Options, _) = bytes.deserialize().unwrap();
    assert_eq!(sent.0.len(), 3, "{sent:?}");
    let (back, _): (FrameSummary, _) = bytes.deserialize().unwrap();
    assert_eq!(back, summary);
}

#[test]
fn a_reply_is_one_flat_dictionary_whose_own_keys_are_required() {
    let map = LatestMap {
        sequence: 7,
        wall_ns: 1,
        values: vec![-0.5, 0.25],
        unit: "relative".to_owned(),
        mesh_hash: "0f".to_owned(),
        method: "tv".to_owned(),
        simulated: true,
        more: MapDetails {
            known: Some(true),
            deviations: Some(vec![0.01, 0.02]),
            ..MapDetails::default()
        },
    };
    let bytes = to_bytes(context(), &map).unwrap();
    let (sent, _): (Options, _) = bytes.deserialize().unwrap();
    assert_eq!(sent.0.len(), 9, "{sent:?}");
    let (back, _): (LatestMap, _) = bytes.deserialize().unwrap();
    assert_eq!(back, map);

    let mut without = Options(sent.0);
    without.0.remove("mesh_hash");
    let bytes = to_bytes(context(), &without).unwrap();
    let refused = bytes.deserialize::<LatestMap>().unwrap_err();
    assert!(refused.to_string().contains("mesh_hash"), "{refused}");
}
