//! Another pattern is one line of the configuration: the linearised method adapts, a model trained for another is
//! refused.

use crate::test_rig::{self, Needs, ask, baseline, measure, number, press};

const BOARD: &str = "time = \"instant\"\n[board]\n";

/// A press of 30 mm is found on a rig with this change of its configuration; returns the number of readings per frame.
fn found_with(change: impl FnOnce(&str) -> String) -> Option<usize> {
    let stage = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, change)?;
    std::fs::write(stage.path().join("board.toml"), BOARD).expect("the story's folder");
    let _guard = test_rig::start(&stage);
    baseline(&stage, 4);
    let truth = [84.7, 138.7];
    press(&stage, truth, 15.0, 0.5);
    let id = measure(&stage, 1);
    let found = &ask(&stage, &["replay", &id, "--no-map"])[0];
    assert_eq!(found["verified"], true, "{found}");
    let place = &found["found_mm"];
    let off =
        (place[0].as_f64().expect("x") - truth[0]).hypot(place[1].as_f64().expect("y") - truth[1]);
    assert!(off < 10.0, "{off} mm off: {found}");
    Some(number(&ask(&stage, &["plan"])[0], "readings") as usize)
}

#[test]
fn a_press_is_found_with_pairs_that_leave_out_two_electrodes() {
    let change = |config: &str| {
        config
            .replace("kind = \"pairs-34924a\"\nslot = 1", "kind = \"gpio-board\"")
            .replace("STAGE/profile.toml", "STAGE/board.toml")
            .replace("compliance_v = 10.0", "compliance_v = 4.0")
            .replace("nplc = 1.0", "nplc = 1.0\nskip = 2")
    };
    if let Some(readings) = found_with(change) {
        // each pair excludes itself and the two that share an electrode with it
        assert_eq!(readings, 26 * 23);
    }
}

#[test]
fn a_press_is_found_with_half_a_frame() {
    let change = |config: &str| config.replace("nplc = 1.0", "nplc = 1.0\nhalf = true");
    if let Some(readings) = found_with(change) {
        assert_eq!(readings, 299);
    }
}

#[test]
fn a_model_trained_for_another_pattern_is_refused_naming_both() {
    let model = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../models/rbf-matched.safetensors"
    );
    let change = |config: &str| {
        config
            .replace("nplc = 1.0", "nplc = 1.0\nhalf = true")
            .replace(
                "method = \"one-step\"\nnoise_uv = 2.0",
                &format!("file = \"{model}\""),
            )
    };
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, change) else {
        return;
    };
    let text = test_rig::refused_by_check(&stage);
    for word in [
        "survey",
        "598",
        "299",
        "trained for this protocol",
        "set survey.half = false",
        "method = \"one-step\"",
    ] {
        assert!(text.contains(word), "'{word}' is not in: {text}");
    }
}

#[test]
fn check_accepts_the_lines_that_advise_prints() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let path = stage.config_path();
    let config = path.display().to_string();
    let mut proposed = Vec::new();
    for options in [
        &[][..],
        &["--module", "34934A"],
        &["--current-ma", "10"],
        &["--electrodes", "16"],
        &["--electrodes", "32", "--module", "34934A"],
    ] {
        let mut words = vec![
            "advise",
            "--config",
            &config,
            "--error-mm",
            "3",
            "--max-seconds",
            "60",
        ];
        words.extend(options);
        let text = stage
            .run("tactus-lab", &words)
            .unwrap_or_else(|fault| panic!("{fault}"));
        assert_eq!(text.code, Some(0), "{}", text.stderr);
        words.push("--json");
        let advice = stage
            .run("tactus-lab", &words)
            .unwrap_or_else(|fault| panic!("{fault}"));
        let advice: serde_json::Value = serde_json::from_str(&advice.stdout).expect("a JSON line");
        let lines = advice["config"].as_str().expect("TOML").to_owned();
        assert!(text.stdout.contains(&lines), "{}", text.stdout);
        let before = std::fs::read_to_string(&path).expect("a configuration");
        let mut whole: toml::Table = toml::from_str(&before).expect("TOML");
        for (section, keys) in toml::from_str::<toml::Table>(&lines).expect("TOML") {
            let given = keys.as_table().expect("a section").clone();
            let section = whole.entry(section).or_insert_with(|| given.clone().into());
            section.as_table_mut().expect("a section").extend(given);
        }
        let changed = path.with_file_name("advised.toml");
        std::fs::write(&changed, whole.to_string()).expect("the folder can be written");
        let changed = changed.display().to_string();
        let checked = stage
            .run("tactusd", &["--config", &changed, "--check"])
            .unwrap_or_else(|fault| panic!("{fault}"));
        assert_eq!(
            checked.code,
            Some(0),
            "{lines}{}{}",
            checked.stdout,
            checked.stderr
        );
        proposed.push(lines);
    }
    assert!(proposed[0].contains("electrodes = 26\n") && !proposed[0].contains("[wiring]"));
    assert!(
        proposed[1].contains("kind = \"matrix-34934a\""),
        "{}",
        proposed[1]
    );
    assert!(
        proposed[3].contains("electrodes = 16\n")
            && proposed[3].contains("electrodes_per_width = 4\n"),
        "{}",
        proposed[3]
    );
    assert!(
        proposed[2].contains("current_ua = 10000.0"),
        "{}",
        proposed[2]
    );
}
