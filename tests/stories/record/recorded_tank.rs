//! Recordings of a real tank are played by the daemon like a rig, and offline by `tactus replay`.

use std::path::Path;

use crate::test_rig::{self, Needs, ask, measure, number};

fn tank(data: &Path, frames: &str, baseline: &str) -> String {
    format!(
        r#"
[rig]
kind = "recording"

[recording]
case = "{}"
frames = "{frames}"
baseline = "{baseline}"
negate = true
frames_per_s = 13.0
speed = 0.0

[geometry]
preset = "disc-tank"

[geometry.disc-tank]
radius_mm = 150.0
electrodes = 16

[record]
directory = "STAGE/state"

[bus]
peer = true
peer_path = "STAGE/peer"
"#,
        data.display()
    )
}

#[test]
fn daemon_replays_750_frames_of_a_real_tank() {
    let Some(data) = needs::shared("data/uottawa2005") else {
        return;
    };
    let config = tank(&data, "replay_ph3t1_750frames.csv", "first:16");
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::QUIET, |_| config) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    let id = measure(&stage, 750);
    let session = ask(&stage, &["sessions"])
        .into_iter()
        .find(|line| line["id"] == id.as_str())
        .expect("listed");
    assert_eq!(session["frames"], 750);
    assert_eq!(
        session["simulated"], false,
        "a recording of a real tank is no simulation"
    );
    assert_eq!(session["readings"], 208);
    let maps = ask(&stage, &["replay", &id, "--no-map"]);
    assert_eq!(maps.len(), 750);
    assert!(
        maps.iter().all(|map| map["verified"] == true),
        "every map is made again, bit for bit"
    );
    // the baseline was recorded with the empty tank
    for map in &maps[..16] {
        assert_eq!(map["significant"], false, "{map}");
        assert_eq!(map["found_mm"], serde_json::Value::Null);
    }
    // the ball is moved around: from frame 60 on it is found inside the tank, except in the middle, where the signal
    // is too weak
    let mut found = 0;
    for map in maps[60..].iter().filter(|map| map["significant"] == true) {
        let place = &map["found_mm"];
        let radius = place[0]
            .as_f64()
            .expect("x")
            .hypot(place[1].as_f64().expect("y"));
        assert!(radius < 150.0, "{map}");
        found += 1;
    }
    assert!(found > 660, "found in {found} of 690 frames");
}

#[test]
fn ball_in_the_tank_is_located_within_2_cm() {
    let Some(data) = needs::shared("data/uottawa2005") else {
        return;
    };
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::QUIET) else {
        return;
    };
    let text =
        std::fs::read_to_string(data.join("truth.csv")).expect("the truth is beside the frames");
    let replayed = ask(
        &stage,
        &[
            "replay",
            &data.display().to_string(),
            "--frames",
            "frames.csv",
            "--baseline",
            "first:1",
            "--negate",
            "--preset",
            "disc-tank",
            "--diameter-mm",
            "300",
            "--no-map",
        ],
    );
    let mut checked = 0;
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        if !["ph1t1_setup2", "ph1t1_setup3"].contains(&fields[0]) {
            continue;
        }
        let truth: Vec<f64> = fields[2..4]
            .iter()
            .map(|field| field.trim().parse().expect("centimetres"))
            .collect();
        let found = replayed
            .iter()
            .find(|map| map["label"] == fields[0])
            .unwrap_or_else(|| panic!("no frame is labelled {}: {replayed:?}", fields[0]));
        let x = found["found_mm"][0].as_f64().expect("x") / 10.0;
        let y = found["found_mm"][1].as_f64().expect("y") / 10.0;
        let off = (x - truth[0]).hypot(y - truth[1]);
        println!(
            "{}: true ({}, {}) cm, found ({x:.2}, {y:.2}) cm, {off:.2} cm off",
            fields[0], truth[0], truth[1]
        );
        assert!(off < 2.0, "{}: {off} cm off", fields[0]);
        assert!(number(found, "largest_loss") > 0.0);
        checked += 1;
    }
    assert_eq!(checked, 2, "both set-ups with a ball are in truth.csv");
}
