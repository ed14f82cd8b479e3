//! The program's commands: output and errors.

use crate::program::{done, lab, numbers, words};

fn refused(line: &str, paths: &[&std::path::Path]) -> (Option<i32>, String) {
    let output = lab(&words(line, paths));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success(), "{message}");
    (output.status.code(), message)
}

fn largest_error(found: &[Vec<f64>], exact: &[Vec<f64>]) -> f64 {
    assert_eq!(found.len(), exact.len());
    let mut error = 0.0_f64;
    let mut size = 0.0_f64;
    for (found, exact) in found.iter().flatten().zip(exact.iter().flatten()) {
        error = error.max((found - exact).abs());
        size = size.max(exact.abs());
    }
    error / size
}

#[test]
fn the_solved_case_by_the_command_line() {
    let case = needs::case("disc16");
    let folder = tempfile::tempdir().unwrap();
    let (v, u, j) = (
        folder.path().join("v.csv"),
        folder.path().join("U.csv"),
        folder.path().join("J.csv"),
    );
    for name in ["homog", "one", "random"] {
        let line = format!(
            "forward --force --case {{}} --sigma {name} --out {{}} --potentials {{}} --timing"
        );
        let message = done(&words(&line, &[&case, &v, &u]));
        assert!(message.contains("forward "), "{message}");
        let exact = |letter: &str| numbers(&case.join(format!("{letter}_exact_{name}.csv")));
        assert!(largest_error(&numbers(&v), &exact("v")) < 1e-13);
        if name != "random" {
            assert!(largest_error(&numbers(&u), &exact("U")) < 1e-13);
        }
    }
    done(&words(
        "jacobian --case {} --sigma homog --out {}",
        &[&case, &j],
    ));
    let exact = numbers(&case.join("J_homog_every_13th.csv"));
    let found: Vec<_> = numbers(&j).into_iter().step_by(13).collect();
    assert_eq!((found.len(), exact.len()), (16, 16));
    assert!(largest_error(&found, &exact) < 1e-11);
    for (prior, lambda) in [
        ("tikhonov", "0.001"),
        ("noser", "0.03"),
        ("laplace", "0.001"),
    ] {
        let line = format!(
            "reconstruct --force --case {{}} --method one-step --prior {prior} --lambda {lambda} --frames {{}} --baseline {{}} --out {{}}"
        );
        let maps = folder.path().join("maps.csv");
        let (frame, baseline) = (case.join("v_exact_one.csv"), case.join("v_exact_homog.csv"));
        done(&words(&line, &[&case, &frame, &baseline, &maps]));
        let map = numbers(&maps);
        assert_eq!((map.len(), map[0].len()), (1, 780));
        let solved = numbers(&case.join(format!("recon_{prior}_one.csv")));
        let column: Vec<Vec<f64>> = map[0].iter().map(|value| vec![*value]).collect();
        let error = largest_error(&column, &solved);
        println!("{prior}: {error:.1e}");
        assert!(error < 1e-11, "{prior}: {error:e}");
    }
}

#[test]
fn a_small_network_is_trained_kept_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    done(&words(
        "mesh --preset disc-tank --set electrodes=8 --set fineness=0.5 --out {}",
        &[&path("tank")],
    ));
    done(&words(
        "forward --case {} --sigma homog --out {}",
        &[&path("tank"), &path("v.csv")],
    ));
    let train =
        "train rbf --yes --profile matched --cases 60 --neurons 12 --seed 3 --case {} --out {}";
    done(&words(train, &[&path("tank"), &path("a.safetensors")]));
    done(&words(train, &[&path("tank"), &path("b.safetensors")]));
    assert_eq!(
        std::fs::read(path("a.safetensors")).unwrap(),
        std::fs::read(path("b.safetensors")).unwrap()
    );
    let use_it = "reconstruct --force --case {} --model {} --frames {} --out {} --json";
    let output = lab(&words(
        use_it,
        &[
            &path("tank"),
            &path("a.safetensors"),
            &path("v.csv"),
            &path("maps.csv"),
        ],
    ));
    assert!(output.status.success());
    let message = String::from_utf8(output.stdout).unwrap();
    assert!(message.contains("\"method\":\"rbf matched\""), "{message}");
    assert!(message.contains("\"quality\":{"), "{message}");

    // a case with another ring or another mesh is refused, and the error names both
    done(&words(
        "mesh --preset disc-tank --set electrodes=9 --set fineness=0.5 --out {}",
        &[&path("nine")],
    ));
    done(&words(
        "forward --case {} --sigma homog --out {}",
        &[&path("nine"), &path("v9.csv")],
    ));
    let (code, message) = refused(
        use_it,
        &[
            &path("nine"),
            &path("a.safetensors"),
            &path("v9.csv"),
            &path("maps.csv"),
        ],
    );
    assert_eq!(code, Some(1));
    assert!(
        message.contains("40 readings of 8") && message.contains("54 of 9"),
        "{message}"
    );

    // a truncated file, and a file of another format
    let whole = std::fs::read(path("a.safetensors")).unwrap();
    std::fs::write(path("cut.safetensors"), &whole[..whole.len() / 2]).unwrap();
    for (model, word) in [
        ("cut.safetensors", "truncated"),
        ("v.csv", "not a model file"),
    ] {
        let (code, message) = refused(
            use_it,
            &[
                &path("tank"),
                &path(model),
                &path("v.csv"),
                &path("maps.csv"),
            ],
        );
        assert_eq!(code, Some(1));
        assert!(
            message.contains(word) && message.contains(model),
            "{message}"
        );
    }
}

#[test]
fn a_small_deep_network_is_trained_kept_and_used() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    done(&words(
        "mesh --preset disc-tank --set electrodes=8 --set fineness=0.5 --out {}",
        &[&path("tank")],
    ));
    done(&words(
        "forward --case {} --sigma homog --out {}",
        &[&path("tank"), &path("v.csv")],
    ));
    std::fs::write(
        path("small.toml"),
        "[data]\ncases = 60\nrepeats = 2\n[deep]\nwidth = 20\nbatch = 16\nheld_out = 20\nepochs = 9\n",
    )
    .unwrap();
    let train = "train dnn --yes --profile matched --settings {} --set hidden_layers=2 --epochs 3 --seed 3 --case {} --out {}";
    let settings = path("small.toml");
    for name in ["a", "b"] {
        done(&words(
            train,
            &[
                &settings,
                &path("tank"),
                &path(&format!("{name}.safetensors")),
            ],
        ));
    }
    assert_eq!(
        std::fs::read(path("a.safetensors")).unwrap(),
        std::fs::read(path("b.safetensors")).unwrap()
    );
    assert!(!path("a.checkpoint").exists());
    let use_it = "reconstruct --case {} --model {} --frames {} --out {} --json";
    let files = [
        path("tank"),
        path("c.safetensors"),
        path("v.csv"),
        path("maps.csv"),
    ];
    let output = lab(&words(
        &format!("{train} --precision int8 --json"),
        &[&settings, &files[0], &files[1]],
    ));
    let message = String::from_utf8(output.stdout).unwrap();
    for word in [
        "\"epochs\":3",
        "\"precision\":\"int8\"",
        "\"hidden_layers\":2",
        "\"samples\":120",
    ] {
        assert!(message.contains(word), "{word}: {message}");
    }
    let output = lab(&words(use_it, &files.each_ref().map(|path| path.as_path())));
    assert!(output.status.success());
    let message = String::from_utf8(output.stdout).unwrap();
    assert!(message.contains("\"method\":\"dnn matched\""), "{message}");
    for (wrong, why) in [
        ("--set breadth=3", "breadth"),
        ("--set width=0", "deep.width must be 1 or more"),
        ("--set width", "KEY=VALUE"),
        ("--set colour.width=3", "colour"),
    ] {
        let (code, message) = refused(
            &format!("{train} --force {wrong}"),
            &[&settings, &files[0], &files[1]],
        );
        assert_eq!(code, Some(2), "{message}");
        assert!(message.contains(why), "{message}");
    }
}

#[test]
fn a_wrong_column_count_names_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    done(&words(
        "mesh --preset disc-tank --set electrodes=4 --set fineness=0.5 --out {}",
        &[&path("tank")],
    ));
    std::fs::write(path("frames.csv"), "m0,m1,m2,m3\n1,2,3,4\n1,2,3\n").unwrap();
    let (code, message) = refused(
        "reconstruct --case {} --frames {} --out {}",
        &[&path("tank"), &path("frames.csv"), &path("maps.csv")],
    );
    assert_eq!(code, Some(1));
    assert!(message.contains("frames.csv:3"), "{message}");
}

#[test]
fn what_cannot_be_meant_is_a_usage_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    done(&words(
        "mesh --preset disc-tank --set electrodes=8 --set fineness=0.5 --out {}",
        &[&path("tank")],
    ));
    done(&words(
        "forward --case {} --sigma homog --out {}",
        &[&path("tank"), &path("v.csv")],
    ));
    for (options, word) in [
        ("--method tv --gap 0", "--gap"),
        ("--method tv --prior noser", "--prior"),
        ("--method tv-paper --noise-v 1e-6", "--noise-v"),
        ("--method one-step --gap 1e-3", "--gap"),
        ("--method dnn", "--model"),
        ("--method rbf --lambda 1", "--lambda"),
        ("--prior quadratic", "quadratic"),
        ("--choose evidence --lambda 1", "--lambda"),
        ("--baseline first:0", "first:0"),
        ("--noise-v 0", "2e-6"),
        ("--noise-v=-1", "2e-6"),
        ("--noise-v nan", "2e-6"),
        ("--lambda 0", "--lambda"),
        ("--metod one-step", "--metod"),
    ] {
        let line = format!("reconstruct --case {{}} {options} --frames {{}} --out {{}}");
        let (code, message) = refused(&line, &[&path("tank"), &path("v.csv"), &path("maps.csv")]);
        assert_eq!(code, Some(2), "{options}: {message}");
        assert!(message.contains(word), "{options}: {message}");
    }
    for set in ["radius=3", "radius_mm", "electrodes=sixteen"] {
        let line = format!("mesh --preset disc-tank --set {set} --out {{}}");
        let (code, message) = refused(&line, &[&path("other")]);
        assert_eq!(code, Some(2), "{message}");
        assert!(message.contains("--set"), "{message}");
    }
    let shells = lab(&words("completions bash", &[]));
    assert!(String::from_utf8_lossy(&shells.stdout).contains("tactus-lab"));
}

#[test]
fn with_json_errors_are_objects() {
    for (line, code, kind, says) in [
        ("frobnicate --json", 2, "usage", "frobnicate"),
        ("scene explain nowhere --json", 1, "failed", "nowhere"),
        ("evaluate --count 0 --json", 2, "usage", "--count"),
    ] {
        let output = lab(&words(line, &[]));
        assert_eq!(output.status.code(), Some(code), "{line}");
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        let error: serde_json::Value =
            serde_json::from_str(message.lines().last().unwrap()).unwrap();
        assert_eq!(error["event"], "error", "{message}");
        assert_eq!(error["kind"], kind, "{message}");
        assert_eq!(error["code"], code, "{message}");
        assert!(error["text"].as_str().unwrap().contains(says), "{message}");
    }
}

/// Frames without noise have good maps for any stated noise, even an implausibly small one.
#[test]
fn frames_without_noise_make_good_maps() {
    let case = needs::case("disc16");
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let exact = |name: &str| -> Vec<String> {
        numbers(&case.join(format!("v_exact_{name}.csv")))
            .iter()
            .map(|row| row[0].to_string())
            .collect()
    };
    let rows = [exact("homog").join(","), exact("one").join(",")].join("\n");
    std::fs::write(path("two.csv"), rows + "\n").unwrap();
    let truth: Vec<f64> = numbers(&case.join("sigma_one.csv"))
        .iter()
        .map(|row| row[0] - 1.0)
        .collect();
    let (one, homog) = (case.join("v_exact_one.csv"), case.join("v_exact_homog.csv"));
    for noise in [
        "",
        " --noise-v 1e-8",
        " --loss-only --choose noise --noise-v 1e-9",
        " --loss-only --choose noise --noise-v 1e-15",
    ] {
        let alone = format!(
            "reconstruct --force --case {{}} --frames {{}} --baseline {{}} --out {{}}{noise}"
        );
        let message = done(&words(&alone, &[&case, &one, &homog, &path("alone.csv")]));
        assert_eq!(
            message.contains("lambda is raised to"),
            noise.contains("--choose noise"),
            "{message}"
        );
        let both = format!("reconstruct --force --case {{}} --frames {{}} --out {{}}{noise}");
        done(&words(&both, &[&case, &path("two.csv"), &path("both.csv")]));
        let both = numbers(&path("both.csv"));
        assert!(both[0].iter().all(|x| *x == 0.0));
        for map in [&numbers(&path("alone.csv"))[0], &both[1]] {
            assert!(map.iter().all(|x| (-1.0..=0.0).contains(x)));
            let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
            let likeness = dot(map, &truth) / (dot(map, map) * dot(&truth, &truth)).sqrt();
            println!("{noise}: {likeness:.3}");
            // linear maps allow for their own error and so reach less of a strong load; shapes reach 0.95
            let least = if noise == " --noise-v 1e-8" {
                0.95
            } else {
                0.93
            };
            assert!(likeness > least, "{noise}: {likeness}");
        }
    }
}

#[test]
fn output_without_a_reader_ends_no_command() {
    // a broken pipe, as after `| head`
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(["scene", "list"])
        .stdout(writer)
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && message.is_empty(), "{message}");
}

/// A sheet that conducts 3 % more than at its baseline, without a load: its map shows that unless drift is removed.
#[test]
fn drift_of_a_frame_is_removed_and_deviation_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (case, baseline, frame) = (path("sheet"), path("v.csv"), path("frame.csv"));
    done(&words(
        "mesh --preset paper-sheet --set fineness=0.4 --out {}",
        &[&case],
    ));
    done(&words(
        "forward --case {} --sigma homog --out {}",
        &[&case, &baseline],
    ));
    let volts = numbers(&baseline).into_iter().flatten();
    let drifted: String = volts.map(|volts| format!("{}\n", volts / 1.03)).collect();
    std::fs::write(&frame, drifted).unwrap();
    let maps = path("maps.csv");
    let largest = |options: &str| {
        let line = format!(
            "reconstruct --force --json --case {{}} --method one-step --noise-v 2e-3{options} --frames {{}} --baseline {{}} --out {{}}"
        );
        let output = lab(&words(&line, &[&case, &frame, &baseline, &maps]));
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{message}");
        let line: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let values = numbers(&maps).into_iter().flatten();
        let largest = values.fold(0.0_f64, |most, value| most.max(value.abs()));
        (largest, line["map_sd"].clone())
    };
    let (left, none) = largest("");
    let (removed, sd) = largest(" --drift frame --sd");
    println!("{left} {removed} {sd}");
    assert!(none.is_null());
    assert!(left > 0.02 && removed < 0.2 * left, "{left} {removed}");
    // the frame has no load: only near electrodes do the readings resolve a change of 5 %
    let resolved = sd["resolved"].as_f64().unwrap();
    assert!((0.01..0.5).contains(&resolved), "{sd}");
    let deviations = numbers(&path("maps.sd.csv"));
    assert_eq!(deviations[0].len(), numbers(&maps)[0].len());
    assert!(deviations[0].iter().any(|value| *value > 0.0));
    largest("");
    assert!(!path("maps.sd.csv").exists(), "it is that of other maps");
    let both = "reconstruct --case {} --drift frame --tracked --period-s 1 --frames {} --out {}";
    let (code, message) = refused(both, &[&case, &frame, &path("other.csv")]);
    assert_eq!(code, Some(2), "{message}");
    assert!(message.contains("--tracked"), "{message}");
}

#[test]
fn a_frame_without_a_map_does_not_end_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (tank, frames, maps) = (path("tank"), path("frames.csv"), path("maps.csv"));
    let mesh = "mesh --preset disc-tank --set electrodes=8 --set fineness=0.5 --out {}";
    done(&words(mesh, &[&tank]));
    let forward = "forward --case {} --sigma homog --out {}";
    done(&words(forward, &[&tank, &path("v.csv")]));
    let volts: Vec<f64> = numbers(&path("v.csv")).into_iter().flatten().collect();
    let row = |scale: f64| -> String { volts.iter().map(|v| format!(",{}", scale * v)).collect() };
    let heading: String = (0..volts.len()).map(|m| format!(",m{m}")).collect();
    let nothing = ",".repeat(volts.len());
    let table = format!(
        "frame{heading}\nf7{}\nf8{nothing}\nf9{}\n",
        row(1.0),
        row(1.2)
    );
    std::fs::write(&frames, table).unwrap();
    let line =
        "reconstruct --json --sd --noise-v 2e-6 --case {} --frames {} --baseline first:1 --out {}";
    let output = lab(&words(line, &[&tank, &frames, &maps]));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("'f8' has no map: "), "{message}");
    assert!(message.contains("1 of 3 frames have no map"), "{message}");
    let lines: Vec<serde_json::Value> = String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines[1]["largest_loss"], serde_json::Value::Null);
    assert!(
        lines[1]["no_map"].as_str().unwrap().contains("missing"),
        "{}",
        lines[1]
    );
    assert_eq!(lines[2]["no_map"], serde_json::Value::Null);
    // the same keys as of `tactus replay`
    assert_eq!(lines[2]["significant"], true);
    assert!(lines[2]["noise"].as_f64().unwrap() > 0.0, "{}", lines[2]);
    let missing = |row: &Vec<f64>| row.iter().all(|value| value.is_nan());
    let maps: Vec<bool> = numbers(&maps).iter().map(missing).collect();
    assert_eq!(maps, [false, true, false]);
    assert_eq!(numbers(&path("maps.sd.csv")).len(), 3);
    let rows = std::fs::read_to_string(path("maps.frames.csv")).unwrap();
    let columns: Vec<usize> = rows.lines().map(|row| row.split(',').count()).collect();
    assert_eq!(columns, [14; 4], "{rows}");
    assert!(rows.contains("\n8,f8,,,,,,,,,,,none,"), "{rows}");

    // if no frame has a map, no file is written
    let label = "\u{1b}[2J";
    std::fs::write(
        path("none.csv"),
        format!("frame{heading}\n{label}{nothing}\n"),
    )
    .unwrap();
    let line = "reconstruct --case {} --frames none.csv --baseline {} --out {}";
    std::fs::rename(path("none.csv"), tank.join("none.csv")).unwrap();
    let (code, message) = refused(line, &[&tank, &path("v.csv"), &path("none.maps.csv")]);
    assert_eq!(code, Some(1));
    assert!(
        message.contains("none of the 1 frames has a map"),
        "{message}"
    );
    assert!(message.contains("'\\u{1b}[2J' has no map"), "{message}");
    assert!(!path("none.maps.csv").exists());
}
