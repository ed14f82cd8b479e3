//! `tactus-lab scene`: output, files and errors.

use crate::program::{done, lab, numbers, words};

fn printed(line: &str) -> String {
    let output = lab(&words(line, &[]));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn a_set_written_over_another_keeps_no_places_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    let places = set.join("presses.csv");
    for line in [
        "judge --set polygons --count 1 --force --out {}",
        "scene run quiet --frames 2 --force --out {}",
    ] {
        let presses = "judge --set presses-10 --count 1 --force --out {}";
        done(&words(presses, &[&set]));
        assert!(places.is_file());
        done(&words(line, &[&set]));
        assert!(!places.exists(), "{line}");
    }
}

#[test]
fn loads_that_are_wider_than_the_region_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    let small = "--count 1 --noise-v 0 --measure fineness=0.4 --measure region_half_width_mm=14.0";
    let judge = |name: &str| {
        let line = format!("judge --set {name} {small} --out {{}}");
        lab(&words(&line, &[&set]))
    };
    for name in ["presses-30", "test-1", "test-2"] {
        let output = judge(name);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(
            message.contains(name) && message.contains("does not fit into the region"),
            "{message}"
        );
        assert!(!set.exists());
    }
    let output = judge("presses-10");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
}

#[test]
fn explain_lists_every_effect_and_marks_those_that_matter() {
    let line = printed("scene explain paper-test1 --json --frames 20");
    let reported: serde_json::Value = serde_json::from_str(&line).unwrap();
    let effects = reported["effects"].as_array().unwrap();
    assert_eq!(effects.len(), phantom::EffectSettings::ALL.len());
    assert_eq!(reported["noise_v"], 2e-6);
    let of = |name: &str| effects.iter().find(|one| one["name"] == name).unwrap();
    assert_eq!(of("voltmeter-noise")["named"], true);
    assert_eq!(of("spray")["verdict"], "left out, would matter");
    assert_eq!(
        of("detachment")["verdict"],
        "left out, would matter if it happened"
    );
    assert!(
        reported["missing"]
            .as_array()
            .unwrap()
            .contains(&"leakage".into())
    );
    // 50 pA through a kilohm give 50 nV
    assert_eq!(of("bias-current")["verdict"], "");
    let text = printed("scene explain effect-output-resistance --nplc 0.02");
    let row = text
        .lines()
        .find(|row| row.starts_with("output-resistance"))
        .unwrap();
    assert!(row.contains("yes") && row.ends_with("negligible"), "{row}");
    // three groups, each with its largest effect first
    let place = |heading: &str| {
        text.find(heading)
            .unwrap_or_else(|| panic!("{heading}: {text}"))
    };
    let groups = [
        place("in the scene:"),
        place("left out, and it would matter:"),
        place("left out, and too small to matter:"),
        text.len(),
    ];
    assert!(groups.is_sorted(), "{text}");
    for group in groups.windows(2) {
        let rows = text[group[0]..group[1]]
            .lines()
            .skip(1)
            .take_while(|row| !row.is_empty());
        let sizes: Vec<f64> = rows
            .map(|row| row.split_whitespace().nth(2).unwrap().parse().unwrap())
            .collect();
        assert!(sizes.is_sorted_by(|a, b| a >= b), "{sizes:?}");
    }
    // the noise is 1e-4 of the 1 V range
    assert!(
        text.contains("noise 1.0e-4 V a reading (the voltmeter's table)"),
        "{text}"
    );
}

#[test]
fn explain_lists_the_time_line_with_its_repeats() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hourly.toml");
    let text = "[[load]]\nname = \"sitter\"\nshape = \"disc\"\ndiameter_mm = 30\nx_mm = 60\ny_mm = 70\n\
        loss_percent = 20\nfrom_s = 60\nto_s = 900\nrepeat = { every_s = 3600, times = 5 }\n\
        [[fault]]\nat_s = 30\nwhat = \"lost 6221\"\n";
    std::fs::write(&path, text).unwrap();
    let output = lab(&words("scene explain {} --frames 2", &[&path]));
    let printed = String::from_utf8(output.stdout).unwrap();
    for line in [
        "load  sitter                   from 60 s to 900 s; again every 3600 s, 5 times in all",
        "fault lost 6221                from 30 s",
    ] {
        assert!(printed.lines().any(|printed| printed == line), "{printed}");
    }
    let output = lab(&words("scene explain {} --frames 2 --json", &[&path]));
    let reported: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let load = serde_json::json!(
        { "name": "sitter", "from_s": 60.0, "to_s": 900.0, "every_s": 3600.0, "times": 5 }
    );
    assert_eq!(reported["loads"], serde_json::json!([load]));
    assert_eq!(reported["faults"][0]["times"], 1);
    let output = lab(&words("scene check {}", &[&path]));
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(
        printed.contains(": 5 loads, 1 faults, no effects"),
        "{printed}"
    );
}

#[test]
fn text_of_a_scene_cannot_act_on_the_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    let text = "name = \"\\u001b[1mnight\"\n[[load]]\nname = \"\\u001b[2J\"\nshape = \"disc\"\ndiameter_mm = 30\n\
        x_mm = 60\ny_mm = 70\nloss_percent = 20\nfrom_s = 60\nto_s = 900\n";
    std::fs::write(&path, text).unwrap();
    let explained = |options: &str| {
        let line = format!("scene explain {{}} --frames 2{options}");
        let output = lab(&words(&line, &[&path]));
        String::from_utf8(output.stdout).unwrap()
    };
    let printed = explained("");
    assert!(printed.starts_with("\\u{1b}[1mnight: "), "{printed:?}");
    assert!(printed.contains("\nload  \\u{1b}[2J "), "{printed:?}");
    let printed = explained(" --json");
    assert!(!printed.contains('\u{1b}'), "{printed:?}");
    let reported: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(reported["loads"][0]["name"], "\u{1b}[2J");
    std::fs::write(&path, "[effects.\"\\u001b[2J\"]\n").unwrap();
    let output = lab(&words("scene check {}", &[&path]));
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(
        message.contains("there is no effect `\\u{1b}[2J`"),
        "{message:?}"
    );
}

#[test]
fn scene_run_writes_a_reproducible_case_folder_with_truth() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    for out in [&one, &two] {
        done(&words(
            "scene run paper-test1 --every 30 --frames 4 --out {}",
            &[out],
        ));
    }
    let bytes = |out: &std::path::Path, name: &str| std::fs::read(out.join(name)).unwrap();
    for name in ["frames.csv", "truth.csv", "judged.json"] {
        assert!(bytes(&one, name) == bytes(&two, name), "{name}");
    }
    let frames = numbers(&one.join("frames.csv"));
    assert_eq!(frames.len(), 4);
    assert!(frames.iter().all(|frame| frame.len() == 598));
    let truth = numbers(&one.join("truth.csv"));
    let lost = |row: &[f64]| row.iter().filter(|change| **change < 0.0).count();
    // frames at 36, 66 and 96 s: only the second is taken during the press, which begins at 60 s
    let pressed: Vec<bool> = truth.iter().map(|row| lost(row) > 0).collect();
    assert_eq!(pressed, [false, true, false]);
    let maps = folder.path().join("maps.csv");
    done(&words(
        "reconstruct --case {} --method one-step --noise-v 2e-6 --frames {} --baseline first:1 --out {}",
        &[&one, &one.join("frames.csv"), &maps],
    ));
    assert!(maps.is_file());
}

#[test]
fn a_run_is_a_session_of_the_logbook() {
    let folder = tempfile::tempdir().unwrap();
    let case = folder.path().join("case");
    done(&words(
        "scene run paper-test1 --every 30 --frames 4 --out {} --logbook {}",
        &[&case, folder.path()],
    ));
    let path = folder.path().join("scene_paper_test_1_1.tactus");
    let session = logbook::SessionReader::open(&path).unwrap();
    assert!(session.header().simulated && session.closed().is_some());
    assert_eq!(session.header().seed, Some(1));
    assert_eq!(session.len().unwrap(), 3);
    let frames = numbers(&case.join("frames.csv"));
    let volts = |readings: &[survey::Reading]| -> Vec<f64> {
        readings
            .iter()
            .map(|reading| reading.volts().unwrap().0)
            .collect()
    };
    let baseline = session.baseline().unwrap().unwrap();
    assert_eq!(volts(&baseline.readings), frames[0]);
    assert_eq!(volts(&session.frame(2).unwrap().frame.readings), frames[2]);
    // a second session of the same name is refused, and the first is not overwritten
    let again = lab(&words(
        "scene run paper-test1 --frames 2 --logbook {}",
        &[folder.path()],
    ));
    assert_eq!(again.status.code(), Some(1));
}

#[test]
fn what_is_no_scene_is_refused_where_it_is_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let wrong = folder.path().join("wrong.toml");
    std::fs::write(&wrong, "seed = 1\n[effects.temprature]\n").unwrap();
    let output = lab(&words("scene check quiet {}", &[&wrong]));
    assert_eq!(output.status.code(), Some(1));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    let place = format!(
        "{}:2:10: there is no effect `temprature`, perhaps `temperature`?",
        wrong.display()
    );
    assert!(message.contains(&place), "{message}");
    assert!(
        message.contains("1 of 2 scenes cannot be loaded"),
        "{message}"
    );
    for (name, hint) in [
        ("bedside-nigth", "did you mean 'bedside-night'?"),
        ("nowhere", "`tactus-lab scene list` lists"),
    ] {
        let output = lab(&["scene", "explain", name]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            message.contains(hint) && !message.contains("paper-test1"),
            "{message}"
        );
    }
    for (options, says) in [
        ("--nplc 0", "--nplc is 0"),
        ("--every 1e19 --frames 3", "--every is"),
        ("--every 3e9 --frames 3", "more than a century"),
        ("--line-hz 1e-9", "more than a century"),
    ] {
        let line = format!("scene run quiet {options} --logbook {{}}");
        let output = lab(&words(&line, &[&folder.path().join("sessions")]));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{options}: {message}");
        assert!(message.contains(says), "{options}: {message}");
    }
}

#[test]
fn the_list_names_every_scene() {
    let listed = printed("scene list --json");
    assert_eq!(listed.lines().count(), phantom::Scene::shipped().len());
    for (name, _) in phantom::Scene::shipped() {
        assert!(listed.contains(&format!("\"name\":\"{name}\"")), "{name}");
    }
}
