//! Training sets in files, the trained linear map and test sets, by command lines.

use std::path::{Path, PathBuf};

use crate::program::{done, lab, numbers, words};
use sha2::{Digest, Sha256};

/// A very short deep training. Like the other trainings of these tests it is too short to learn anything, hence --yes.
const SMALL_DEEP: &str = "train dnn --yes --profile matched --epochs 2 --set width=24 --set hidden_layers=2 --set batch=16 --set held_out=20";

fn tank(folder: &Path) -> PathBuf {
    let case = folder.join("tank");
    let line = "mesh --preset disc-tank --set radius_mm=100.0 --set electrodes=8 --set fineness=0.5 --out {}";
    done(&words(line, &[&case]));
    case
}

fn refused(line: &str, paths: &[&Path]) -> String {
    let output = lab(&words(line, paths));
    assert!(!output.status.success());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_set_is_the_same_however_it_is_cut_stopped_and_read() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    let make = |shard: &str, out: &Path| {
        let line = format!("dataset --shard {shard} --seed 3 --cases 150 --case {{}} --out {{}}");
        done(&words(&line, &[&case, out]));
    };
    make("0/1", &whole);
    // a shard interrupted in the middle of a record is resumed, with the same resulting file
    make("0/2", &parts);
    let shard = parts.join("shard-0-of-2.tset");
    let bytes = std::fs::read(&shard).unwrap();
    std::fs::write(
        parts.join("shard-0-of-2.part"),
        &bytes[..bytes.len() * 2 / 3],
    )
    .unwrap();
    std::fs::remove_file(&shard).unwrap();
    std::fs::remove_file(parts.join("shard-0-of-2.json")).unwrap();
    make("0/2", &parts);
    assert!(std::fs::read(&shard).unwrap() == bytes);
    // incomplete sets are refused
    let model = folder.path().join("a.safetensors");
    let train = "train linear --yes --force --profile matched --dataset {} --case {} --out {}";
    let message = refused(train, &[&parts, &case, &model]);
    assert!(
        message.contains("75 of 150 cases") && message.contains("shard-1-of-2.tset"),
        "the missing shard is named: {message}"
    );
    make("1/2", &parts);
    // two of three shards: the error names the missing middle one
    let thirds = folder.path().join("thirds");
    make("0/3", &thirds);
    make("2/3", &thirds);
    let message = refused(train, &[&thirds, &case, &model]);
    assert!(message.contains("shard-1-of-3.tset"), "{message}");
    // a shard of another seed
    let other = folder.path().join("other");
    let line = "dataset --shard 1/3 --seed 4 --cases 150 --case {} --out {}";
    done(&words(line, &[&case, &other]));
    for name in ["shard-1-of-3.tset", "shard-1-of-3.json"] {
        std::fs::copy(other.join(name), thirds.join(name)).unwrap();
    }
    let message = refused(train, &[&thirds, &case, &model]);
    assert!(
        message.contains("shard-1-of-3.json") && message.contains("another set"),
        "{message}"
    );
    // equal cases give equal weights
    let other = folder.path().join("b.safetensors");
    done(&words(train, &[&parts, &case, &model]));
    done(&words(train, &[&whole, &case, &other]));
    assert!(std::fs::read(&model).unwrap() == std::fs::read(&other).unwrap());
    for train in [SMALL_DEEP, "train rbf --yes --profile matched --neurons 8"] {
        let line = format!("{train} --force --dataset {{}} --case {{}} --out {{}}");
        done(&words(&line, &[&parts, &case, &model]));
        done(&words(&line, &[&whole, &case, &other]));
        assert!(std::fs::read(&model).unwrap() == std::fs::read(&other).unwrap());
    }
    // a shard of another seed is not added to an existing set
    let line = "dataset --shard 0/2 --seed 4 --cases 150 --case {} --out {}";
    assert!(refused(line, &[&case, &parts]).contains("another set"));
    // a flipped bit, and a NaN with a matching checksum
    let mut spoilt = bytes.clone();
    let record = {
        let head = spoilt.iter().position(|byte| *byte == b'\n').unwrap() + 1;
        head + 8 * 40 // 8 electrodes have 40 readings
    };
    spoilt[record + 4..record + 8].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&shard, &spoilt).unwrap();
    assert!(refused(train, &[&parts, &case, &model]).contains("checksum"));
    let hash = |bytes: &[u8]| -> String {
        let digest = Sha256::digest(bytes);
        digest.iter().map(|byte| format!("{byte:02x}")).collect()
    };
    let manifest = parts.join("shard-0-of-2.json");
    let text = std::fs::read_to_string(&manifest).unwrap();
    std::fs::write(&manifest, text.replace(&hash(&bytes), &hash(&spoilt))).unwrap();
    let message = refused(train, &[&parts, &case, &model]);
    assert!(
        message.contains("shard-0-of-2.tset") && message.contains("reading 0 of case 0"),
        "{message}"
    );
    for train in [SMALL_DEEP, "train rbf --yes --profile matched --neurons 8"] {
        let line = format!("{train} --force --dataset {{}} --case {{}} --out {{}}");
        let message = refused(&line, &[&parts, &case, &model]);
        assert!(
            message.contains("shard-0-of-2.tset") && message.contains("reading 0 of case 0"),
            "{message}"
        );
    }
}

#[test]
fn a_set_made_for_another_sheet_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let [set, other, model] = ["set", "other", "x.model"].map(|name| folder.path().join(name));
    done(&words(
        "dataset --cases 20 --case {} --out {}",
        &[&case, &set],
    ));
    // the same mesh and protocol
    for measure in ["contact_ohm=77.0", "sheet_ohm=777.0"] {
        let line = format!(
            "mesh --force --preset disc-tank --set radius_mm=100.0 --set electrodes=8 --set fineness=0.5 --set {measure} --out {{}}"
        );
        done(&words(&line, &[&other]));
        let line = "train linear --yes --profile matched --dataset {} --case {} --out {}";
        let message = refused(line, &[&set, &other, &model]);
        assert!(
            message.contains("shard-0-of-1.json") && message.contains("other contacts"),
            "{measure}: {message}"
        );
        assert!(!model.exists(), "{measure}");
    }
}

#[test]
fn a_linear_map_is_trained_loaded_and_finds_a_press() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let at = |name: &str| folder.path().join(name);
    let model = at("linear.safetensors");
    let line = "train linear --yes --profile matched --cases 800 --symmetric --precision f16 --case {} --out {} --json";
    done(&words(line, &[&case, &model]));
    let kept = eit::model::load(&model)
        .unwrap()
        .metadata()
        .own_misfit
        .clone();
    assert!(kept.is_some_and(|misfit| misfit.classes.len() > 1));
    let read = eit::Case::read(&case).unwrap();
    let mesh = &read.mesh;
    let mut sigma = read.sigma["homog"].clone();
    let pressed = |t: usize| (mesh.centroid(t)[0] - 0.03).hypot(mesh.centroid(t)[1]) < 0.02;
    for (t, sigma) in sigma.iter_mut().enumerate() {
        *sigma *= if pressed(t) { 0.5 } else { 1.0 };
    }
    let text: String = sigma.iter().map(|s| format!("{s:e}\n")).collect();
    std::fs::write(at("pressed.csv"), text).unwrap();
    done(&words(
        "forward --case {} --sigma homog --out {}",
        &[&case, &at("v0.csv")],
    ));
    let line = "forward --case {} --sigma {} --out {}";
    done(&words(line, &[&case, &at("pressed.csv"), &at("v1.csv")]));
    let line = "reconstruct --case {} --model {} --frames {} --baseline {} --out {}";
    let paths: [&Path; 5] = [&case, &model, &at("v1.csv"), &at("v0.csv"), &at("map.csv")];
    done(&words(line, &paths));
    let map = &numbers(&at("map.csv"))[0];
    let truth: Vec<f64> = (0..map.len())
        .map(|t| if pressed(t) { -0.5 } else { 0.0 })
        .collect();
    let like = eit::metrics::likeness(map, &truth, &mesh.region_areas());
    println!("correlation {:.3}", like.correlation);
    let line = "reconstruct --case {} --model {} --frames {} --baseline {} --out {} --loss-only";
    let paths: [&Path; 5] = [&case, &model, &at("v1.csv"), &at("v0.csv"), &at("cut.csv")];
    done(&words(line, &paths));
    // the truth is within the bounds, so clipping increases no triangle's error
    let mut cut = 0;
    for ((cut_to, whole), truth) in numbers(&at("cut.csv"))[0].iter().zip(map).zip(&truth) {
        assert_eq!(*cut_to, whole.clamp(-1.0, 0.0));
        assert!((cut_to - truth).abs() <= (whole - truth).abs());
        cut += usize::from(cut_to != whole);
    }
    assert!(cut > 10, "{cut}");
    // 8 electrodes and 720 cases give 0.62; a map of the wrong sign, scale or order of readings gives a negative value
    assert!(like.correlation > 0.5, "{like:?}");
}

/// Small trainings of each kind of network for the tests below.
const KINDS: [&str; 3] = [
    "rbf --neurons 5 --repeats 2",
    "dnn --repeats 2 --epochs 1 --set width=8 --set hidden_layers=1 --set batch=10 --set held_out=4",
    "linear",
];

/// The JSON output of a training with the profile `matched`.
fn trained(line: &str, paths: &[&Path]) -> serde_json::Value {
    let output = lab(&words(
        &format!("train {line} --profile matched --cases 120 --yes --json --force"),
        paths,
    ));
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{line}: {errors}");
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn every_kind_trains_on_levels_and_on_measured_noise() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let model = folder.path().join("model.safetensors");
    // frames of the unloaded tank, more than readings
    let readings = eit::Case::read(&case).unwrap().protocol.len();
    let frames = folder.path().join("unloaded.csv");
    let row = |frame: usize| -> String {
        let value = |reading: usize| {
            let item = frame * readings + reading;
            0.1 + 1e-6 * ((item * item) as f64 * 0.618).fract()
        };
        let row: Vec<String> = (0..readings).map(|k| format!("{:e}", value(k))).collect();
        row.join(",") + "\n"
    };
    std::fs::write(&frames, (0..2 * readings).map(row).collect::<String>()).unwrap();
    for kind in KINDS {
        let line = format!("{kind} --noise-v 1e-6 --noise-v 1e-4 --case {{}} --out {{}}");
        let levels = trained(&line, &[&case, &model]);
        assert_eq!(levels["training"]["jitter"]["profile"], "levels", "{kind}");
        let line = format!("{kind} --noise-frames {{}} --case {{}} --out {{}}");
        let measured = trained(&line, &[&frames, &case, &model]);
        assert_eq!(measured["training"]["jitter"]["profile"], "measured");
        assert_ne!(levels["hash"], measured["hash"]);
    }
    for kind in ["rbf --neurons 5", "dnn --epochs 1 --set held_out=4"] {
        let line = format!(
            "train {kind} --profile matched --cases 40 --repeats 1 --noise-v 1e-6 --noise-v 1e-4 --case {{}} --out {{}} --force"
        );
        let message = refused(&line, &[&case, &model]);
        assert!(message.contains("levels of noise"), "{message}");
    }
}

#[test]
fn every_kind_trains_through_the_mirrors_of_a_sheet() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model.safetensors");
    for kind in KINDS {
        let count = |line: &str| {
            let report = &trained(&format!("{kind} {line}"), &[&model])["report"];
            report["samples"]
                .as_u64()
                .or_else(|| report["unchanged"].as_u64())
                .unwrap()
        };
        // the paper's sheet has two mirror symmetries and the half turn
        assert_eq!(
            count("--symmetric --out {}"),
            4 * count("--out {}"),
            "{kind}"
        );
    }
}

#[test]
fn methods_are_compared_on_frames_of_a_finer_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let (set, picture) = (folder.path().join("set"), folder.path().join("figure.png"));
    done(&words(
        "judge --set presses-30 --count 3 --seed 11 --out {}",
        &[&set],
    ));
    let output = lab(&words(
        "evaluate --set {} --method one-step --method best --method tv --json --picture {}",
        &[&set, &picture],
    ));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    let lines: Vec<serde_json::Value> = String::from_utf8(output.stdout)
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let of = |k: usize, name: &str| lines[k][name].as_f64().unwrap();
    println!("{lines:?}");
    assert!(of(0, "location_error_mm") < 3.0 && of(1, "location_error_mm") < 0.8);
    assert!(of(1, "correlation") > 0.95 && of(1, "dice") > 0.93);
    assert!(of(1, "correlation") > of(0, "correlation"));
    // computed by formula for the linear map, from random draws for the others
    assert!((0..3).all(|k| of(k, "noise_figure") > 0.0));
    assert!(std::fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
    let message = refused("evaluate --set {} --method one-step", &[folder.path()]);
    assert!(!message.is_empty());
}

#[test]
fn options_that_the_profile_would_ignore_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("x.model");
    for (profile, stated, option, advice) in [
        ("paper", "--noise-v 2e-6", "--noise-v", "--gamma"),
        ("paper", "--noise-frames f.csv", "--noise-frames", "--gamma"),
        ("matched", "--gamma 0.01", "--gamma", "--noise-v"),
        ("months", "--gamma 0.01", "--gamma", "--noise-v"),
        (
            "months",
            "--noise-frames f.csv",
            "--noise-frames",
            "span months",
        ),
        (
            "matched",
            "--noise-v 2e-6 --noise-frames f.csv",
            "--noise-v and --noise-frames",
            "leave one of them out",
        ),
    ] {
        for kind in ["rbf", "dnn", "linear"] {
            let line = format!("train {kind} --profile {profile} {stated} --out {{}}");
            let output = lab(&words(&line, &[&model]));
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{line}: {message}");
            for words in [option, &format!("--profile {profile}"), advice] {
                assert!(message.contains(words), "{line}: {message}");
            }
            assert!(!model.exists(), "{line}");
        }
    }
}

#[test]
fn a_model_is_not_written_where_its_checkpoint_is() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    for (name, options) in [
        ("x.checkpoint", ""),
        ("x.checkpoint", " --force"),
        ("x.model", " --checkpoint {}"),
    ] {
        let model = folder.path().join(name);
        let line = format!("{SMALL_DEEP} --cases 40 --case {{}} --out {{}}{options}");
        let output = lab(&words(&line, &[&case, &model, &model]));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{name}{options}: {message}");
        assert!(message.contains("by --checkpoint FILE"), "{message}");
        assert!(!model.exists());
    }
}

#[test]
fn slips_of_a_training_are_refused_before_work_begins() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("x.model");
    for (slip, says) in [
        ("--noise-v 2", "2e-6"),
        ("--noise-v 0", "2e-6"),
        (
            "--noise-v 0.002",
            "2 mV of noise in one reading is more than 1 mV",
        ),
        (
            "--noise-v 2e-6 --noise-v 0.002",
            "--yes trains for it nevertheless",
        ),
        ("--cases 1e11", "10000000"),
        ("--cases 100000000000", "10000000"),
    ] {
        let line = format!("train linear --profile matched {slip} --out {{}}");
        let message = refused(&line, &[&model]);
        assert!(message.contains(says), "{slip}: {message}");
        assert!(!message.contains("cases take about"), "{slip}: {message}");
    }
    assert!(!model.exists());
    // the next limit, the largest reading of the case, applies even with --yes
    let message = refused(
        "train linear --profile matched --noise-v 2 --yes --out {}",
        &[&model],
    );
    assert!(message.contains("the largest reading"), "{message}");
    // fewer cases than an RBF network has neurons
    let line = "train linear --profile matched --noise-v 0.002 --yes --cases 64 --out {}";
    done(&words(line, &[&model]));
    assert!(model.exists());
    let (case, nothing) = (tank(folder.path()), folder.path().join("nothing.model"));
    for kind in ["rbf", "linear"] {
        let line = format!("train {kind} --profile matched --cases 64 --case {{}} --out {{}}");
        let message = refused(&line, &[&case, &nothing]);
        assert!(message.contains("has learnt nothing"), "{message}");
        assert!(!nothing.exists(), "{kind}");
    }
}
