//! Networks compute the daemon's maps: a deep one, trained here in seconds, and an ONNX network.

use std::path::Path;

use crate::test_rig::{self, Needs, ask, baseline, measure};

/// A training too small to learn much, but enough to run the network.
const TRAIN: &str = "tactus-lab train dnn --yes --profile matched --cases 400 --repeats 1 --epochs 2 --set width=24 \
                     --set hidden_layers=2 --set batch=16 --set held_out=8 --precision f16 --out";

#[test]
fn a_deep_network_makes_the_daemons_maps() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let file = folder.path().join("deep.safetensors");
    let words = TRAIN
        .split_whitespace()
        .map(Into::into)
        .chain([file.clone().into_os_string()]);
    assert_eq!(lab::run(words), std::process::ExitCode::SUCCESS);
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        with_model(config, &file)
    }) else {
        return;
    };
    let _guard = test_rig::start(&stage);
    baseline(&stage, 3);
    let id = measure(&stage, 1);
    let found = &ask(&stage, &["replay", &id, "--no-map"])[0];
    assert_eq!(
        found["verified"], true,
        "the map that the network made is made again, bit for bit: {found}"
    );
    let method = found["method"].as_str().unwrap_or_default();
    assert!(method.contains("dnn matched"), "{found}");
}

/// The configuration with a model file in place of the method.
fn with_model(config: &str, file: &Path) -> String {
    let method = "method = \"one-step\"\nnoise_uv = 2.0\n";
    assert!(config.contains(method), "{config}");
    config.replace(method, &format!("file = \"{}\"\n", file.display()))
}

#[cfg(not(feature = "onnx"))]
#[test]
fn build_without_onnx_refuses_an_onnx_model() {
    let file = Path::new("/no/such/network.onnx");
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        with_model(config, file)
    }) else {
        return;
    };
    let text = test_rig::refused_by_check(&stage);
    assert!(
        text.contains("network.onnx") && text.contains("--features onnx"),
        "{text}"
    );
}

/// Needs ONNX Runtime (`ORT_DYLIB_PATH`) and a `python3` with onnx; otherwise it prints that and passes, unless
/// TACTUS_REQUIRE_ONNX is set.
#[cfg(feature = "onnx")]
#[test]
fn a_network_trained_elsewhere_makes_the_daemons_maps() {
    use std::process::Command;

    let python = |args: &[&std::ffi::OsStr]| Command::new("python3").args(args).output();
    let there = std::env::var_os("ORT_DYLIB_PATH").is_some()
        && python(&["-c".as_ref(), "import onnx".as_ref()]).is_ok_and(|run| run.status.success());
    if !there {
        return needs::lacking("ONNX", "no ORT_DYLIB_PATH, or no python3 with onnx");
    }
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let at = |name: &str| folder.path().join(name);
    let lab = |line: &str| lab::run(line.split_whitespace().map(Into::into));
    let done = std::process::ExitCode::SUCCESS;
    let (set, file, judged) = (at("set"), at("elsewhere.onnx"), at("judged"));
    let made = lab(&format!(
        "tactus-lab dataset --cases 400 --out {}",
        set.display()
    ));
    assert_eq!(made, done);
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../lab/examples/onnx_network.py"
    );
    let run = python(&[script.as_ref(), set.as_os_str(), file.as_os_str()]).expect("python3 runs");
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    // offline
    let maps = at("maps.csv");
    let judge = format!(
        "tactus-lab judge --set presses-30 --count 4 --out {}",
        judged.display()
    );
    assert_eq!(lab(&judge), done);
    let reconstruct = format!(
        "tactus-lab reconstruct --case {0} --frames {0}/frames.csv --model {1} --out {2}",
        judged.display(),
        file.display(),
        maps.display()
    );
    assert_eq!(lab(&reconstruct), done);
    // in the daemon, and recomputed from its record
    let Some(stage) = test_rig::set_with(Needs::SIMULATED, test_rig::NOISY, |config| {
        with_model(config, &file)
    }) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 3);
    let id = measure(&stage, 1);
    let found = &ask(&stage, &["replay", &id, "--no-map"])[0];
    assert_eq!(found["verified"], true, "{found}");
    assert_eq!(found["method"], "onnx elsewhere", "{found}");
    drop(daemon);
    // a network for another sheet is refused before anything moves, and the error names both
    let config = std::fs::read_to_string(stage.config_path()).expect("the stage is there");
    let other = config.replace(
        "preset = \"paper-sheet\"",
        "preset = \"paper-sheet\"\n[geometry.paper-sheet]\nfineness = 1.1",
    );
    assert_ne!(config, other, "{config}");
    stage.configure(&other).expect("the stage is there");
    let text = test_rig::refused_by_check(&stage);
    assert!(
        text.contains("elsewhere.onnx") && text.contains("output 'map'"),
        "{text}"
    );
}
