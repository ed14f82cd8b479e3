//! Maps against a tracked baseline: a day of drift offline, and the daemon with its restarts.

use tactus_tests::Stage;

use crate::test_rig::{self, Needs, ask, baseline, measure, number};

/// Drift of a day and a half, and a press of 10 mm near its end.
const DRIFT: &str = "seed = 3\n[effects.temperature]\npercent_per_c = -0.2\nroom_c = 1.5\n[effects.long-drift]\n\
    wander_percent = 0.3\nwalk_percent = 0.05\nrunning_in_percent = 3.0\n[effects.contact-spread]\nstd = 0.3\n\
    [effects.voltmeter-noise]\n[[load]]\nname = \"press\"\nshape = \"disc\"\ndiameter_mm = 10.0\nx_mm = 80.0\ny_mm = 135.0\n\
    loss_percent = 50.0\nfrom_s = 100000.0\nto_s = 101000.0\n";
/// Number of the first frame with the press. Frames are ten minutes apart; the first one is the baseline.
const PRESSED: u64 = 167;

/// Distance between a position in the JSON and the press, mm.
fn away_mm(place: &serde_json::Value) -> f64 {
    let [x, y] = [0, 1].map(|axis| place[axis].as_f64().expect("a place"));
    (x - 80.0).hypot(y - 135.0)
}

/// A session of a scene, with a frame each ten minutes; the first is the baseline.
fn recorded(stage: &Stage, scene: &str, frames: usize) -> String {
    let file = stage.path().join("scene-to-record.toml");
    std::fs::write(&file, scene).expect("the folder can be written");
    let folder = stage.path().join("recorded");
    let line = format!(
        "tactus-lab scene run {} --every 600 --frames {frames} --nplc 10 --range-v 0.1 --logbook {}",
        file.display(),
        folder.display()
    );
    let ended = lab::run(line.split_whitespace().map(Into::into));
    assert_eq!(ended, std::process::ExitCode::SUCCESS);
    let mut files = std::fs::read_dir(&folder).expect("the session is written");
    let session = files.next().expect("one file").expect("it can be listed");
    session.path().display().to_string()
}

fn replayed(stage: &Stage, session: &str, options: &[&str]) -> Vec<serde_json::Value> {
    let mut words = vec![
        "replay",
        session,
        "--no-map",
        "--method",
        "one-step",
        "--noise-v",
        "2e-6",
    ];
    words.extend(options);
    ask(stage, &words)
}

#[test]
fn a_lost_electrode_costs_accuracy_and_not_the_session() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::QUIET) else {
        return;
    };
    let scene = "seed = 5\n[effects.contact-spread]\nstd = 0.3\n[effects.thermal-emf]\nuv = 0.9\n[effects.voltmeter-noise]\n\
        [effects.detachment]\nelectrode = 20\nfrom_s = 6200.0\nover_s = 100.0\n[[load]]\nname = \"press\"\nshape = \"disc\"\n\
        diameter_mm = 10.0\nx_mm = 80.0\ny_mm = 135.0\nloss_percent = 50.0\nfrom_s = 10000.0\nto_s = 11000.0\n";
    let session = recorded(&stage, scene, 18);
    let frames = replayed(&stage, &session, &["--tracked"]);
    for frame in &frames {
        let tracked = &frame["tracked"];
        let after = number(frame, "frame") > 10.0;
        let masked = if after {
            serde_json::json!([20])
        } else {
            serde_json::json!([])
        };
        assert_eq!(tracked["masked"], masked, "{frame}");
        assert_eq!(tracked["known"], true, "{frame}");
    }
    let fault = frames[10]["tracked"]["fault"]
        .as_str()
        .expect("it is named at once");
    assert!(fault.contains("electrode 20"), "{fault}");
    let pressed = &frames[16]["tracked"];
    let error = away_mm(&pressed["place"]["centre_mm"]);
    eprintln!("found {error:.2} mm off without electrode 20");
    assert!(error < 2.0, "{pressed}");
}

#[test]
fn a_press_after_a_day_of_drift_is_found_only_by_tracking() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::QUIET) else {
        return;
    };
    let session = recorded(&stage, DRIFT, 169);
    let replay = |options: &[&str]| replayed(&stage, &session, options);
    let all = replay(&["--tracked"]);
    let judgement = |frame: u64| all[frame as usize - 1]["tracked"]["judgement"].as_str();
    for frame in 1..=all.len() as u64 {
        let loaded = (PRESSED..PRESSED + 2).contains(&frame);
        let expected = if loaded { "loaded" } else { "empty" };
        assert_eq!(judgement(frame), Some(expected), "frame {frame}");
    }
    let pressed = &all[PRESSED as usize - 1];
    let place = &pressed["tracked"]["place"];
    let error = away_mm(&place["centre_mm"]);
    let half = place["half_axes_mm"][0].as_f64().expect("an ellipse");
    eprintln!("found {error:.2} mm off, 95 % ellipse of {half:.2} mm");
    assert!(error < 1.5 && half < 3.0, "{place}");
    assert_eq!(pressed["tracked"]["known"], true, "{pressed}");
    assert_eq!(pressed["tracked"]["came"], true, "{pressed}");
    assert!(away_mm(&pressed["found_mm"]) < 5.0, "{pressed}");
    // only the requested frame is shown, but the tracker follows all frames before it
    let one = replay(&["--tracked", "--from", &PRESSED.to_string(), "--count", "1"]);
    assert_eq!(one, std::slice::from_ref(pressed));
    // without tracking, the map shows the drift
    let untracked = replay(&["--from", &PRESSED.to_string(), "--count", "1"]);
    assert!(untracked[0]["tracked"].is_null());
    assert!(
        untracked[0]["found_mm"].is_null() || away_mm(&untracked[0]["found_mm"]) > 10.0,
        "{}",
        untracked[0]
    );
}

#[test]
fn tracking_without_times_or_noise_names_what_is_missing() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::QUIET) else {
        return;
    };
    let _daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let id = measure(&stage, 2);
    let case = stage.path().join("out.case").display().to_string();
    let table = stage.path().join("out.csv").display().to_string();
    ask(&stage, &["export", &id, "--format", "csv", "--out", &table]);
    for (options, wants) in [
        (&["--tracked", "--noise-v", "2e-6"][..], "--period-s"),
        (&["--tracked", "--period-s", "10"], "--noise-v"),
        (&["--period-s", "10"], "--tracked"),
        (&["--tracked=maybe"], "on or off"),
    ] {
        let mut words = vec!["replay", &case, "--no-map"];
        words.extend(options);
        let output = stage.tactus(&words).expect("the program runs");
        assert_eq!(output.code, Some(2), "{options:?}: {}", output.stderr);
        assert!(
            output.stderr.contains(wants),
            "{options:?}: {}",
            output.stderr
        );
    }
}

#[test]
fn a_tracked_baseline_survives_sessions_and_restarts() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        let method = "method = \"one-step\"\n";
        assert!(config.contains(method), "{config}");
        config.replace(method, "method = \"one-step\"\ntracking = true\n")
    }) else {
        return;
    };
    // frames are 500 ms apart, so that each can wait for its map; the first map waits for the fit of the sheet
    let measure = |frames: &str| {
        let lines = ask(
            &stage,
            &["start", "--count", frames, "--every", "500ms", "--wait"],
        );
        lines[0]["session"].as_str().expect("its id").to_owned()
    };
    let verified = |id: &str| {
        let frames = ask(&stage, &["replay", id, "--no-map"]);
        for frame in &frames {
            assert!(frame["tracked"]["judgement"].is_string(), "{frame}");
            assert_ne!(frame["verified"], false, "{frame}");
        }
        let same = frames.iter().filter(|frame| frame["verified"] == true);
        // on a busy machine a map may come after the next frame, and is then not recorded
        assert!(same.count() > 0, "no map is recorded");
        frames
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let first = measure("6");
    let before = verified(&first);
    // the next session continues with the state at the end of this one
    let second = measure("4");
    let after = verified(&second);
    let sd = |frame: &serde_json::Value| number(&frame["tracked"], "baseline_sd_uv");
    assert!(
        sd(&after[0]) < 0.7 * sd(&before[0]),
        "learnt in the session before: {} and {}",
        after[0],
        before[0]
    );
    let shown = &ask(&stage, &["baseline", "show"])[0]["tracked"];
    assert_eq!(shown["session"], serde_json::json!(second), "{shown}");
    assert_eq!(shown["sequence"], 4, "{shown}");
    assert_eq!(shown["empty"], shown["until"], "{shown}");
    assert!(number(shown, "change_uv") < 2.0, "noise alone: {shown}");
    // killed in the middle of a session, which the next daemon resumes
    let begun = ask(&stage, &["start", "--every", "500ms"]);
    let id = begun[0]["session"].as_str().expect("its id").to_owned();
    ask(&stage, &["watch", "--no-map", "--count", "3"]);
    daemon.kill();
    let _daemon = test_rig::start(&stage);
    ask(&stage, &["watch", "--no-map", "--count", "3"]);
    ask(&stage, &["stop"]);
    assert!(verified(&id).len() >= 6);
    let third = measure("3");
    assert!(sd(&verified(&third)[0]) < 0.7 * sd(&before[0]));
    // a damaged state is reported, and tracking starts again at the baseline
    let folder = stage.path().join("state");
    let states = std::fs::read_dir(&folder).expect("the record can be listed");
    let of_baseline = states
        .filter_map(|entry| Some(entry.ok()?.path()))
        .find(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.starts_with('b') && name.ends_with(".tracking")
        })
        .expect("the state is kept beside the baseline");
    std::fs::write(&of_baseline, "no state\n").expect("it can be written");
    let fourth = measure("3");
    assert!(sd(&verified(&fourth)[0]) > 0.9 * sd(&before[0]));
    let shown = ask(&stage, &["events", &fourth]);
    let text = serde_json::json!(shown).to_string();
    assert!(text.contains("cannot be used"), "{text}");
}

#[test]
fn a_person_overrules_the_tracker_and_replay_does_the_same() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        config.replace(
            "method = \"one-step\"\n",
            "method = \"one-step\"\ntracking = true\n",
        )
    }) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let refused = stage.tactus(&["baseline", "empty-now"]).expect("it runs");
    assert_eq!(refused.code, Some(3), "no session: {}", refused.stderr);
    let begun = ask(&stage, &["start", "--every", "500ms"]);
    let id = begun[0]["session"].as_str().expect("its id").to_owned();
    // frames and whether learning is held, as reported by `watch`
    let watched = |count: &str| -> Vec<(u64, bool)> {
        let frames = ask(&stage, &["watch", "--no-map", "--count", count]);
        let shown = frames.iter().filter(|frame| frame["tracked"].is_object());
        let held = shown.map(|frame| {
            (
                number(frame, "sequence") as u64,
                frame["tracked"]["held"] == true,
            )
        });
        held.collect()
    };
    let ordered = |order: &str| number(&ask(&stage, &["baseline", order])[0], "from_frame") as u64;
    assert!(watched("2").iter().all(|(_, held)| !held));
    let loaded = ordered("loaded-now");
    for (frame, held) in watched("3") {
        assert_eq!(held, frame >= loaded, "frame {frame} of {loaded}");
    }
    let status = &ask(&stage, &["status"])[0];
    assert_eq!(status["session"]["map"]["known"], false, "{status}");
    // the next daemon replays the recorded frames and orders
    daemon.kill();
    let _daemon = test_rig::start(&stage);
    let again = watched("2");
    assert!(again.iter().all(|(_, held)| *held), "{again:?}");
    let empty = ordered("empty-now");
    for (frame, held) in watched("3") {
        assert_eq!(held, frame < empty, "frame {frame} of {empty}");
    }
    ordered("forget-anchor");
    ask(&stage, &["stop"]);
    let shown = &ask(&stage, &["baseline", "show"])[0]["tracked"];
    assert!(number(&shown["drift"], "gain_uv").is_finite(), "{shown}");
    let frames = ask(&stage, &["replay", &id, "--no-map"]);
    for frame in &frames {
        let sequence = number(frame, "frame") as u64;
        let held = (loaded..empty).contains(&sequence);
        assert_eq!(frame["tracked"]["held"], held, "{frame}");
        assert_ne!(frame["verified"], false, "{frame}");
        let reason = if held {
            serde_json::json!("declared-loaded")
        } else {
            serde_json::Value::Null
        };
        assert_eq!(frame["tracked"]["reason"], reason, "{frame}");
    }
    assert!(frames.iter().any(|frame| frame["verified"] == true));
    let events = serde_json::json!(ask(&stage, &["events", &id])).to_string();
    for order in ["loaded-now", "empty-now", "forget-anchor"] {
        assert!(
            events.contains(&format!("{order}, from frame ")),
            "{events}"
        );
    }
}

#[test]
fn an_order_without_tracking_names_what_is_missing() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::QUIET, |config| {
        config.replace(
            "method = \"one-step\"\n",
            "method = \"one-step\"\ntracking = false\n",
        )
    }) else {
        return;
    };
    let _daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    ask(&stage, &["start", "--every", "500ms"]);
    let refused = stage
        .tactus(&["baseline", "forget-anchor"])
        .expect("it runs");
    assert_eq!(refused.code, Some(1), "{}", refused.stderr);
    assert!(
        refused.stderr.contains("`tracking` in [model]"),
        "{}",
        refused.stderr
    );
    ask(&stage, &["stop"]);
}
