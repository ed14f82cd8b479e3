//! Options and settings that would have no effect are refused by name; accepted ones take effect.

use std::path::{Path, PathBuf};

use crate::program::{done, lab, words};

/// Runs the program, which must refuse its command line; returns standard error.
fn refused(line: &str, paths: &[&Path]) -> String {
    let output = lab(&words(line, paths));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{line}: {message}");
    message
}

fn tank(folder: &Path) -> PathBuf {
    let case = folder.join("tank");
    let line = "mesh --preset disc-tank --set radius_mm=100.0 --set electrodes=8 --set fineness=0.5 --out {}";
    done(&words(line, &[&case]));
    case
}

#[test]
fn options_that_a_command_would_ignore_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    for (line, says) in [
        ("honesty --load ring --out {}", "--maps"),
        ("honesty --method best --out {}", "--maps"),
        ("honesty --unstated --out {}", "--maps"),
        ("months --method tv --out {}", "--maps"),
        ("months --model a.safetensors --out {}", "--maps"),
        (
            "months --quick --days 90 --out {}",
            "--days 90: --quick has 2",
        ),
        (
            "months --quick --sheets 5 --out {}",
            "--sheets 5: --quick has 1",
        ),
        (
            "months --quick --presses 4 --out {}",
            "--presses 4: --quick has 1",
        ),
        (
            "months --sheets 0 --presses 3 --days 0 --out {}",
            "--presses has no effect: --sheets is 0",
        ),
        (
            "months --sheets 0 --maps 2 --days 0 --out {}",
            "--maps has no effect: --sheets is 0",
        ),
        (
            "months --sheets 0 --drift gain-contacts --days 0 --out {}",
            "--drift has no effect: --sheets is 0",
        ),
        (
            "months --sheets 2 --presses 0 --days 0 --out {}",
            "--sheets has no effect: --presses and --maps are 0",
        ),
        (
            "months --sheets 0 --scene month --days 0 --out {}",
            "--scene has no effect: --days is 0",
        ),
        ("evaluate --seed 7 --set {}", "--set"),
        ("evaluate --count 3 --set {}", "--set"),
        ("dataset --loss 0.5 --out {}", "--recorded"),
        (
            "judge --set test-1 --count 17 --out {}",
            "--count 17: the set test-1 has 16",
        ),
        (
            "judge --set test-2 --count 10 --out {}",
            "--count 10: the set test-2 has 9",
        ),
        (
            "judge --set sizes --count 29 --out {}",
            "--count 29: the set sizes has 28",
        ),
    ] {
        let message = refused(line, &[&out]);
        assert!(message.contains(says), "{line}: {message}");
        assert!(!out.exists(), "{line}");
    }
}

#[test]
fn cases_are_refused_where_nothing_is_trained() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let [volts, maps] = ["v.csv", "maps.csv"].map(|name| folder.path().join(name));
    let line = "forward --case {} --sigma homog --out {}";
    done(&words(line, &[&case, &volts]));
    for (method, says) in [
        (
            "--method one-step --cases 100",
            "not apply to --method one-step",
        ),
        (
            "--cases 100",
            "--cases 100 belongs to the methods that are trained",
        ),
        // a map that was trained on no case would show nothing for any load
        ("--method linear --cases 0", "from 1 to 10000000"),
    ] {
        let line = format!("reconstruct --case {{}} --frames {{}} --out {{}} {method}");
        let message = refused(&line, &[&case, &volts, &maps]);
        assert!(message.contains(says), "{method}: {message}");
        assert!(!maps.exists(), "{method}");
    }
}

#[test]
fn extent_of_images_needs_their_true_places() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("one.csv"), "0,0\n1,2\n").unwrap();
    let line = "merit --width-mm 100 --height-mm 80 --images {}";
    let message = refused(line, &[folder.path()]);
    assert!(message.contains("targets.csv"), "{message}");
    std::fs::write(path("targets.csv"), "image,x,y\none,0.5,0.5\n").unwrap();
    done(&words(line, &[folder.path()]));
    // a first line with a typing error is not taken for a header
    for slip in ["one,0.5,O.5\n", "one,nan,0.5\n"] {
        std::fs::write(path("targets.csv"), slip).unwrap();
        let output = lab(&words("merit --images {}", &[folder.path()]));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{slip}: {message}");
        assert!(message.contains("targets.csv:1:"), "{slip}: {message}");
    }
}

#[test]
fn loss_is_stated_by_the_table_or_by_the_option() {
    let folder = tempfile::tempdir().unwrap();
    let (case, out) = (tank(folder.path()), folder.path().join("set"));
    std::fs::write(
        folder.path().join("presses.csv"),
        "frame,x_m,y_m,diameter_m,loss\n2,0.02,0.03,0.01,0.2\n",
    )
    .unwrap();
    let line = "dataset --loss 0.5 --yes --recorded {} --case {} --out {}";
    let message = refused(line, &[folder.path(), &case, &out]);
    assert!(
        message.contains("--loss 0.5") && message.contains("presses.csv"),
        "{message}"
    );
    assert!(!out.exists());
}

#[test]
fn seed_of_the_settings_is_that_of_the_set() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("settings.toml"), "seed = 9\n").unwrap();
    let line = "dataset --cases 20 --case {} --out {}";
    let make = |options: &str, out: &str| {
        let line = format!("{line}{options}");
        done(&words(&line, &[&case, &at(out), &at("settings.toml")]));
        std::fs::read(at(out).join("shard-0-of-1.tset")).unwrap()
    };
    let of_settings = make(" --settings {}", "settings");
    assert!(of_settings == make(" --seed 9", "nine"));
    let usual = make("", "usual");
    assert!(of_settings != usual);
    assert!(usual == make(" --seed 1 --settings {}", "one"));
}

#[test]
fn settings_without_effect_on_a_set_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let [settings, out] = ["settings.toml", "set"].map(|name| folder.path().join(name));
    let line = "dataset --cases 20 --settings {} --case {} --out {}";
    let paths: [&Path; 3] = [&settings, &case, &out];
    for text in [
        "repeats = 3\n",
        "vertices = 4\nspread_times = 2.0\n",
        "neurons = 7\n",
        "[jitter]\nprofile = \"paper\"\ngamma = 0.02\n",
    ] {
        std::fs::write(&settings, text).unwrap();
        let output = lab(&words(line, &paths));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(78), "{text}: {message}");
        assert!(
            message.contains("settings.toml") && message.contains("has no effect on a set"),
            "{text}: {message}"
        );
        assert!(!out.exists(), "{text}");
    }
    std::fs::write(&settings, "vertices = 4\n[open]\nspread = \"variance\"\n").unwrap();
    done(&words(line, &paths));
}

#[test]
fn errors_of_a_settings_file_name_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let [settings, out] = ["settings.toml", "out"].map(|name| folder.path().join(name));
    let [set, network] = ["dataset", "train dnn --yes --profile matched"]
        .map(|command| format!("{command} --settings {{}} --case {{}} --out {{}}"));
    for (line, text, says) in [
        (
            &set,
            "vertices = 4\nrepeats = 3\n",
            ":2: repeats has no effect",
        ),
        (&set, "vertices = 4\n\nedges = 3\n", ":3: unknown field"),
        (&set, "vertices = \"4\"\n", ":1: invalid type"),
        (&set, "vertices = 4\nradius_m\n", ":2: "),
        (&network, "[data]\nneurons = 7\n", ":2: data.neurons is"),
        (
            &network,
            "[data]\nvertices = 4\n[deep]\nlayers = 2\n",
            ":4: unknown field",
        ),
        (
            &network,
            "[deep]\n[rbf]\nneurons = 7\n",
            ":2: unknown field",
        ),
        (&network, "[deep]\nwidth = -1\n", ":2: invalid value"),
    ] {
        std::fs::write(&settings, text).unwrap();
        let output = lab(&words(line, &[&settings, &case, &out]));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{text}");
        assert!(
            message.contains(&format!("settings.toml{says}")),
            "{text}: {message}"
        );
    }
}

#[test]
fn settings_that_a_deep_network_would_ignore_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let model = folder.path().join("x.model");
    for (options, says) in [
        ("--set data.neurons=7", "data.neurons"),
        ("--set data.spread_times=2.0", "data.spread_times"),
        (
            "--noise-v 2e-6 --set data.jitter={profile=\"paper\",gamma=0.01}",
            "data.jitter and --noise-v",
        ),
    ] {
        let line = format!("train dnn --profile matched {options} --case {{}} --out {{}}");
        let message = refused(&line, &[&case, &model]);
        assert!(message.contains(says), "{options}: {message}");
        assert!(!model.exists(), "{options}");
    }
}

#[test]
fn cases_of_a_set_have_the_settings_of_the_set() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let [set, model, settings] =
        ["set", "x.model", "settings.toml"].map(|name| folder.path().join(name));
    let line = "dataset --cases 20 --case {} --out {}";
    done(&words(line, &[&case, &set]));
    std::fs::write(&settings, "[data]\nvertices = 4\n").unwrap();
    let paths: [&Path; 4] = [&set, &case, &model, &settings];
    for (option, says) in [
        ("--set data.radius_m=0.05", "data.radius_m"),
        ("--settings {}", "data.vertices"),
    ] {
        let line =
            format!("train dnn --profile matched --dataset {{}} --case {{}} --out {{}} {option}");
        let message = refused(&line, &paths);
        assert!(
            message.contains(says) && message.contains("tactus-lab dataset --settings"),
            "{message}"
        );
        assert!(!model.exists());
    }
    // the neurons are compared with the number of cases in the set
    let line = "train rbf --yes --profile matched --neurons 25 --dataset {} --case {} --out {}";
    let message = done(&words(line, &paths));
    assert!(message.contains("20 cases for 25 neurons"), "{message}");
}

#[test]
fn a_picture_of_sets_without_a_load_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    // a set without any other file: nothing else is read before
    std::fs::write(folder.path().join("truth.csv"), "0,0\n-0,0\n").unwrap();
    let picture = folder.path().join("figure.png");
    let line = "evaluate --set {} --method one-step --picture {}";
    let message = refused(line, &[folder.path(), &picture]);
    assert!(
        message.contains("no frame of the sets has a load"),
        "{message}"
    );
}
