//! `tactus-lab paper`: existing outputs are reused, and outputs of other commands are refused by name.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant, SystemTime};

/// Timeout for the first network.
const DEADLINE: Duration = Duration::from_secs(120);

fn figure(number: &str, out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(["paper", "--quick", "--figure", number, "--out"])
        .arg(out)
        .output()
        .unwrap()
}

#[test]
fn the_mesh_is_drawn_once_and_made_again_only_by_other_words() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("paper");
    let first = figure("3", &out);
    assert!(
        first.status.success(),
        "{}",
        String::from_utf8_lossy(&first.stderr)
    );
    for file in [
        "figure-3.png",
        "figure-3.svg",
        "settings.json",
        "case/nodes.csv",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    // an output of the same command line is reused unchanged: an error put into it is reported
    let nodes = out.join("case/nodes.csv");
    let whole = std::fs::read_to_string(&nodes).unwrap();
    std::fs::write(&nodes, "x_m,y_m\n0,zero\n").unwrap();
    let spoiled = figure("3", &out);
    assert!(!spoiled.status.success());
    let message = String::from_utf8_lossy(&spoiled.stderr).into_owned();
    assert!(message.contains("nodes.csv"), "{message}");
    // an output of another command line is made again
    std::fs::write(out.join("case.command"), "mesh --preset disc-tank\n").unwrap();
    let again = figure("3", &out);
    assert!(
        again.status.success(),
        "{}",
        String::from_utf8_lossy(&again.stderr)
    );
    assert_eq!(std::fs::read_to_string(&nodes).unwrap(), whole);
}

/// Modification times of all files.
fn stamps(folder: &Path) -> BTreeMap<PathBuf, SystemTime> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.append(&mut stamps(&path));
        } else if let Ok(at) = entry.metadata().and_then(|about| about.modified()) {
            found.insert(path, at);
        }
    }
    found
}

#[test]
fn killed_run_resumes_with_missing_parts_and_names_damage() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("paper");
    let mut killed = Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(["paper", "--quick", "--figure", "6", "--out"])
        .arg(&out)
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    // kill -9 once the first two networks exist
    let there = out.join("models/rbf-paper.safetensors.command");
    let begun = Instant::now();
    while !there.exists() {
        assert!(begun.elapsed() < DEADLINE, "no RBF network was trained");
        assert!(killed.try_wait().unwrap().is_none(), "it ended by itself");
        std::thread::park_timeout(Duration::from_millis(5));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    let finished = |path: &Path| {
        let name = path
            .strip_prefix(&out)
            .unwrap()
            .to_string_lossy()
            .into_owned();
        name.starts_with("case") || name.contains("dnn-paper") || name.contains("rbf-paper")
    };
    let before: BTreeMap<_, _> = stamps(&out)
        .into_iter()
        .filter(|(path, _)| finished(path))
        .collect();
    assert!(before.len() > 6, "{before:?}");
    assert!(!out.join("figure-6.png").exists());
    let second = figure("6", &out);
    let message = String::from_utf8_lossy(&second.stderr).into_owned();
    assert!(second.status.success(), "{message}");
    assert!(out.join("figure-6.png").is_file());
    assert!(
        !message.contains("train dnn") && message.contains("judge --set test-1"),
        "{message}"
    );
    let after = stamps(&out);
    for (path, at) in &before {
        assert_eq!(
            after.get(path),
            Some(at),
            "{} was made again",
            path.display()
        );
    }
    // a third run makes no output again
    let third = figure("6", &out);
    let message = String::from_utf8_lossy(&third.stderr).into_owned();
    assert!(
        third.status.success() && !message.contains("--out"),
        "{message}"
    );

    let named = |file: &str, bytes: &[u8], words: &[&str]| {
        let path = out.join(file);
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let refused = figure("6", &out);
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(1), "{message}");
        for word in words.iter().chain([&file]) {
            assert!(message.contains(word), "{word}: {message}");
        }
        std::fs::write(&path, whole).unwrap();
    };
    let command = "models/rbf-paper.safetensors.command";
    named(
        command,
        b"train rbf --profile pap",
        &["damaged", "delete it"],
    );
    named(command, &[0xff, 0xfe, 0], &["damaged", "no text"]);
    let model = "models/rbf-paper.safetensors";
    let whole = std::fs::read(out.join(model)).unwrap();
    named(model, &whole[..whole.len() / 2], &["truncated"]);
    named("sets/test-1-2uV/frames.csv", b"1,2,3\n", &[]);
}

#[test]
fn a_figure_that_the_paper_does_not_have_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = figure("8", folder.path());
    assert_eq!(refused.status.code(), Some(2));
}
