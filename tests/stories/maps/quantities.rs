//! Quantities of maps: the same numbers from the daemon's rows and from the frames, for the sheet and its regions.

use std::time::Duration;

use dbus::Manager1Proxy;
use serde_json::Value;
use tactus_tests::Stage;

use crate::test_rig::{self, Needs, PRESS_MM, ask, baseline, number, press, runtime};

const REGIONS: &str = "\n[[region]]\nname = \"press\"\nrectangle_mm = [60.0, 115.0, 100.0, 155.0]\n\
    [[region]]\nname = \"far\"\npolygon_mm = [[150.0, 60.0], [200.0, 60.0], [175.0, 100.0]]\n";

/// The mean of a quantity in rows of a region.
fn mean(rows: &[Value], region: &str, quantity: &str) -> f64 {
    let of = rows
        .iter()
        .filter(|row| row["region"] == region && row["quantity"] == quantity);
    let (mut sum, mut frames) = (0.0, 0.0);
    for row in of {
        sum += number(row, "mean") * number(row, "frames");
        frames += number(row, "frames");
    }
    assert!(frames > 0.0, "no {quantity} of {region} in {rows:?}");
    sum / frames
}

/// The last standard deviations on the bus, and the index of the triangle at the press.
fn on_the_bus(stage: &Stage, id: &str) -> (Vec<f64>, usize) {
    runtime().block_on(async {
        let (connection, session) = test_rig::session(&stage.peer_path(), id).await;
        let manager = Manager1Proxy::new(&connection).await.expect("a proxy");
        let geometry = manager.geometry().await.expect("the geometry");
        let map = session.latest_map().await.expect("a map");
        let deviations = map.more.deviations.expect("standard deviations");
        assert_eq!(deviations.len(), map.values.len());
        assert!(map.more.deviations_sequence <= Some(map.sequence));
        let away = |corners: &[u32]| {
            let sum = |axis: usize| -> f64 {
                let along = corners
                    .iter()
                    .map(|n| geometry.nodes[2 * *n as usize + axis]);
                along.sum()
            };
            (sum(0) / 3.0 - 0.080).hypot(sum(1) / 3.0 - 0.135)
        };
        let triangles = geometry.triangles.chunks_exact(3).map(away).enumerate();
        let nearest = triangles.min_by(|a, b| a.1.total_cmp(&b.1));
        (deviations, nearest.expect("a triangle").0)
    })
}

#[test]
fn stored_quantities_are_those_of_the_frames() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        format!("{config}{REGIONS}")
    }) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    press(&stage, PRESS_MM, 20.0, 0.5);
    let begun = ask(&stage, &["start", "--step"]);
    let id = begun[0]["session"].as_str().expect("its id").to_owned();
    // frames for some seconds: deviations are computed once a second, and are larger in the first frame of a load
    let watch = ["watch", "--no-map", "--count", "24", "--sd"];
    let watched = std::thread::scope(|scope| {
        let watching = scope.spawn(|| ask(&stage, &watch));
        let steps = (1..).take_while(|_| !watching.is_finished());
        steps.for_each(|sequence| drop(stepped(&stage, &id, sequence)));
        watching.join().expect("it watches")
    });
    let (deviations, at_press) = on_the_bus(&stage, &id);
    let (of_maps, watched): (Vec<Value>, Vec<Value>) = watched
        .into_iter()
        .partition(|line| line["event"] == "deviation");
    let of_maps = &of_maps.last().expect("one a second")["deviations"];
    let of_maps = of_maps.as_array().expect("a value for each triangle");
    assert_eq!(of_maps.len(), deviations.len());
    let known: Vec<f64> = of_maps.iter().filter_map(Value::as_f64).collect();
    assert!(known.iter().all(|sd| *sd > 0.0));
    // half of the conductance is lost there
    let sd = of_maps[at_press].as_f64().expect("the frame tells it");
    assert!(sd < 0.7 && deviations[at_press] < 0.7, "{sd}");
    // the daemon computes standard deviations once in a second of frames
    let certain =
        |frame: &&Value| !frame["quantities"]["regions"][0]["deviations"]["load"].is_null();
    let last = watched.iter().rfind(certain).expect("deviations in 2 s");
    let sheet = &last["quantities"]["regions"][0];
    assert_eq!(sheet["name"], "sheet", "{last}");
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));

    // recomputing the recorded frame gives the published values
    let each = ask(&stage, &["quantities", &id, "--each-frame"]);
    let same = each
        .iter()
        .find(|frame| frame["frame"] == last["sequence"])
        .expect("the frame is recorded");
    assert_eq!(same["regions"][0]["values"], sheet["values"]);
    assert_eq!(same["spots"], last["quantities"]["spots"]);
    let sd = &same["regions"][0]["deviations"];
    assert!(number(sd, "load") > 0.0 && number(sd, "load") < number(&sheet["values"], "load"));
    assert_eq!(*sd, sheet["deviations"]);
    let spot = &same["spots"][0];
    let [low, high] = [0, 1].map(|end| spot["uncertainty"]["load_interval"][end].as_f64());
    let (load, low, high) = (number(spot, "load"), low.expect("low"), high.expect("high"));
    assert!(
        0.0 < low && low < load && load < high && high < 2.0 * load,
        "{spot}"
    );

    let stored = ask(&stage, &["quantities", &id]);
    let again = ask(&stage, &["quantities", &id, "--recompute"]);
    assert_eq!(stored.len(), again.len());
    for (stored, again) in stored.iter().zip(&again) {
        for field in ["begin", "region", "quantity", "unit", "frames", "known"] {
            assert_eq!(stored[field], again[field], "{stored}\n{again}");
        }
        for field in ["min", "mean", "max"] {
            let (a, b) = (number(stored, field), number(again, field));
            // rows are stored with seven digits
            assert!((a - b).abs() <= 1e-6 * b.abs(), "{stored}\n{again}");
        }
    }
    let centre = [
        mean(&stored, "sheet", "centre-x"),
        mean(&stored, "sheet", "centre-y"),
    ];
    assert!(
        (centre[0] - 80.0).hypot(centre[1] - 135.0) < 15.0,
        "{centre:?}"
    );
    assert!(mean(&stored, "press", "dispersion") > 40.0, "{stored:?}");
    assert!(mean(&stored, "far", "dispersion") < 5.0, "{stored:?}");
    assert_eq!(mean(&stored, "press", "known"), 1.0);

    for (options, says) in [
        (&["--region", "knee"][..], "sheet, press, far"),
        (&["--region", "knee", "--recompute"], "sheet, press, far"),
        (&["--mmhg"], "--calibration FILE"),
        (&["--quantity", "weight"], "known: contact, load"),
    ] {
        let mut words = vec!["quantities", &id];
        words.extend(options);
        let output = stage.tactus(&words).expect("the program runs");
        assert_eq!(output.code, Some(2), "{options:?}: {}", output.stderr);
        assert!(
            output.stderr.contains(says),
            "{options:?}: {}",
            output.stderr
        );
    }
    let table = stage
        .tactus(&["quantities", &id, "--csv", "--region", "far"])
        .expect("the program runs");
    let mut lines = table.stdout.lines();
    let heading = "begin_utc,region,quantity,unit,min,mean,max,frames,known";
    assert_eq!(lines.next(), Some(heading));
    assert!(lines.all(|line| line.split(',').count() == 9 && line.contains(",far,")));
}

/// Takes the next frame of a stepped session and waits for its quantities: a frame that is followed too early has none.
fn stepped(stage: &Stage, id: &str, sequence: u64) -> Value {
    ask(stage, &["step"]);
    let quantities = async {
        let (_connection, session) = test_rig::session(&stage.peer_path(), id).await;
        loop {
            match session.quantities().await {
                Ok(latest) if latest.sequence == sequence => {
                    return serde_json::from_str(&latest.json).expect("JSON");
                }
                _ => tokio::time::sleep(Duration::from_millis(20)).await,
            }
        }
    };
    runtime().block_on(async {
        let limit = tokio::time::timeout(Duration::from_secs(300), quantities);
        limit.await.expect("the frame has quantities")
    })
}

#[test]
fn a_restart_continues_dose_and_hot_spots() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    press(&stage, PRESS_MM, 20.0, 0.5);
    let begun = ask(&stage, &["start", "--step"]);
    let id = begun[0]["session"].as_str().expect("its id").to_owned();
    (1..=4).for_each(|sequence| drop(stepped(&stage, &id, sequence)));
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let daemon = test_rig::start(&stage);
    (5..=6).for_each(|sequence| drop(stepped(&stage, &id, sequence)));
    let last = stepped(&stage, &id, 7);
    ask(&stage, &["stop"]);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let events = ask(&stage, &["events", &id]);
    assert!(
        events.iter().any(|event| event["kind"] == "restarted"),
        "the session was resumed: {events:?}"
    );
    // replayed from the first frame on, without the restart
    let each = ask(&stage, &["quantities", &id, "--each-frame"]);
    let same = each
        .iter()
        .find(|frame| frame["frame"] == 7)
        .expect("the frame is recorded");
    let sheet = &last["regions"][0];
    assert_eq!(same["regions"][0]["values"], sheet["values"]);
    assert_eq!(same["spots"], last["spots"]);
    assert!(number(&sheet["values"], "dose") > 0.0, "{last}");
}

#[test]
fn a_region_that_cannot_be_is_named_with_its_line() {
    let beside = "\n[[region]]\nname = \"off\"\nrectangle_mm = [900.0, 900.0, 950.0, 950.0]\n";
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::QUIET, |config| {
        format!("{config}{REGIONS}{beside}")
    }) else {
        return;
    };
    let refused = test_rig::refused_by_check(&stage);
    assert!(
        refused.contains("region.2: region 'off' does not touch the sheet"),
        "{refused}"
    );
    let text = std::fs::read_to_string(stage.config_path()).expect("it is there");
    let line = 1 + text[..text.find("name = \"off\"").expect("the region")]
        .matches('\n')
        .count();
    assert!(
        refused.contains(&format!("config.toml:{}:", line - 1)),
        "{line}: {refused}"
    );
}
