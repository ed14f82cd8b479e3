//! Errors in input name its position, nothing moves, and the exit code is that of configuration errors.

use crate::test_rig::{self, Needs, ask, baseline};

/// Runs `tactusd --check` on a changed configuration: exit code 78, and the message names each word.
fn refused(change: &dyn Fn(&str) -> String, words: &[&str]) {
    let Some(stage) =
        test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| change(config))
    else {
        return;
    };
    let text = test_rig::refused_by_check(&stage);
    for word in words {
        assert!(text.contains(word), "'{word}' is not in: {text}");
    }
}

#[test]
fn an_unknown_key_is_named_with_its_line() {
    refused(
        &|config| config.replace("settle_ms = 2.0", "setle_ms = 2.0"),
        &["config.toml:", "setle_ms", "settle_ms"],
    );
}

#[test]
fn a_unit_that_does_not_exist_is_named() {
    refused(
        &|config| config.replace("current_ua = 1000.0", "current_ma = 1.0"),
        &["config.toml:", "current_ma"],
    );
}

#[test]
fn electrode_counts_that_disagree_are_both_named() {
    refused(
        &|config| config.replace("nplc = 1.0", "nplc = 1.0\nelectrodes = 16"),
        &["config.toml:", "16", "26"],
    );
}

#[test]
fn current_over_the_relay_limit_is_refused_not_clipped() {
    refused(
        &|config| config.replace("current_ua = 1000.0", "current_ua = 60000.0"),
        &["60 mA", "50 mA"],
    );
}

#[test]
fn a_schedule_or_a_ring_without_end_is_refused() {
    refused(
        &|config| config.to_owned() + "\n[schedule]\nevery_s = 1e308\n",
        &["every_s", "1e308", "from 0 to 3155760000"],
    );
    refused(
        &|config| config.replace("nplc = 1.0", "nplc = 1.0\nelectrodes = 1000000"),
        &["electrodes", "256"],
    );
}

#[test]
fn a_missing_scene_is_named() {
    refused(
        &|config| config.replace("STAGE/scene.toml", "STAGE/nosuch.toml"),
        &["nosuch.toml"],
    );
}

#[test]
fn missing_instrument_is_an_error_and_never_simulated() {
    let real = |config: &str| {
        // port 1 of loopback: connection refused
        config
            .replace("kind = \"simulated\"", "kind = \"instruments\"")
            .replace("profile = \"STAGE/profile.toml\"\n", "")
            .replace("scene = \"STAGE/scene.toml\"\n", "")
            + "\n[source]\naddress = \"127.0.0.1:1\"\n[switch]\naddress = \"127.0.0.1:1\"\n[voltmeter]\naddress = \"127.0.0.1:1\"\n"
    };
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, real) else {
        return;
    };
    let fault = stage.start_daemon().expect_err("there is no instrument");
    let text = fault.to_string();
    assert!(text.contains("127.0.0.1:1"), "{text}");
}

#[test]
fn a_second_daemon_on_the_same_record_is_refused() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    let second = stage
        .run(
            "tactusd",
            &["--config", &stage.config_path().display().to_string()],
        )
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert_ne!(second.code, Some(0));
    assert!(
        second.stderr.contains(&daemon.id().to_string()),
        "names the other's process: {}",
        second.stderr
    );
    // the first daemon continues
    assert_eq!(ask(&stage, &["status"])[0]["state"], "idle");
}

#[test]
fn a_baseline_taken_with_other_settings_is_refused() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    let id = baseline(&stage, 2)[0]["session"]
        .as_str()
        .expect("an id")
        .to_owned();
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
    let other = tactus_tests::SIMULATED.replace("current_ua = 1000.0", "current_ua = 500.0");
    stage
        .configure(&other)
        .expect("the configuration is written");
    let _guard = test_rig::start(&stage);
    let message = stage
        .tactus(&["start", "--count", "1", "--baseline", &id])
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert_ne!(message.code, Some(0));
    assert!(
        message.stderr.contains("500 uA") && message.stderr.contains("1 mA"),
        "{}",
        message.stderr
    );
}

#[test]
fn a_truncated_or_foreign_model_is_refused() {
    let shipped = std::path::Path::new(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../models/rbf-matched.safetensors"
    ));
    let whole = std::fs::read(shipped).expect("the model ships with the project");
    for (bytes, name) in [
        (&whole[..whole.len() / 2], "half.safetensors"),
        (&b"not a model"[..], "foreign.safetensors"),
    ] {
        let change = |config: &str| {
            config.replace(
                "method = \"one-step\"\nnoise_uv = 2.0",
                &format!("file = \"STAGE/{name}\""),
            )
        };
        let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, change) else {
            return;
        };
        std::fs::write(stage.path().join(name), bytes).expect("the story's folder can be written");
        let text = test_rig::refused_by_check(&stage);
        assert!(text.contains(name), "{text}");
    }
}

#[test]
fn a_wrong_column_count_names_the_line() {
    let Some(data) = needs::shared("data/uottawa2005") else {
        return;
    };
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::QUIET) else {
        return;
    };
    let text = std::fs::read_to_string(data.join("frames.csv")).expect("frames lie there");
    let broken: String = text
        .lines()
        .enumerate()
        .map(|(index, line)| if index == 2 { line.rsplit_once(',').expect("columns").0.to_owned() } else { line.to_owned() } + "\n")
        .collect();
    let frames = stage.path().join("broken.csv");
    std::fs::write(&frames, broken).expect("the story's folder can be written");
    let message = stage
        .tactus(&[
            "replay",
            &data.display().to_string(),
            "--frames",
            &frames.display().to_string(),
            "--baseline",
            "first:1",
            "--preset",
            "disc-tank",
        ])
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert_ne!(message.code, Some(0));
    assert!(
        message.stderr.contains("broken.csv:3"),
        "{}",
        message.stderr
    );
}

#[test]
fn check_warns_of_what_will_not_work_on_this_machine() {
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        let notify = "[notify]\ncommand = [\"/nonexistent/mail\"]\n";
        config.replace("[notify]\n", notify) + "\n[schedule]\nevery_s = 0.01\n"
    }) else {
        return;
    };
    let path = stage.config_path().display().to_string();
    let checked = stage
        .run("tactusd", &["--config", &path, "--check"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    let text = format!("{}{}", checked.stdout, checked.stderr);
    assert_eq!(checked.code, Some(0), "{text}");
    for warning in [
        "/nonexistent/mail",
        "schedule.every_s is 0.01",
        "a frame takes",
    ] {
        assert!(text.contains(warning), "no '{warning}' in {text}");
    }
    assert!(!text.contains("no problem found"), "{text}");
}
