//! Trainings that are killed, or whose disk is full, resume and give the same bits; a simulation on a full disk replaces
//! no earlier file.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use crate::program::{done, words};

const TRAIN: &str = "train dnn --yes --profile matched --cases 150 --epochs 300 --set patience=0 --set width=64 --set hidden_layers=2 --set batch=16 \
                     --set held_out=20 --case {} --out {}";

fn tank(folder: &Path) -> PathBuf {
    let case = folder.join("tank");
    let line = "mesh --preset disc-tank --set radius_mm=100.0 --set electrodes=8 --set fineness=0.5 --out {}";
    done(&words(line, &[&case]));
    case
}

/// Runs the program with a limit on file size in blocks of 512 bytes, which simulates a full disk.
fn with_little_space(blocks: u32, line: &str, paths: &[&Path]) -> Output {
    let limited = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
    Command::new("sh")
        .args(["-c", &limited, env!("CARGO_BIN_EXE_tactus-lab")])
        .args(words(line, paths))
        .output()
        .unwrap()
}

fn words_of(output: &Output) -> String {
    assert!(!output.status.success());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn killed_training_on_full_disk_resumes_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let [whole, broken] =
        ["whole", "broken"].map(|name| folder.path().join(name).with_extension("safetensors"));
    done(&words(TRAIN, &[&case, &whole]));
    // kill -9 after the second epoch
    let mut child = Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(words(TRAIN, &[&case, &broken]))
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let message = BufReader::new(child.stderr.take().unwrap());
    let second = message
        .lines()
        .map(Result::unwrap)
        .find(|line| line.starts_with("epoch 2 "));
    assert!(second.is_some());
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!broken.exists(), "it was killed before it ended");
    let checkpoint = broken.with_extension("checkpoint");
    let kept = std::fs::read(&checkpoint).unwrap();
    // no space for the next checkpoint: the training fails, and the last checkpoint is kept
    let blocks = u32::try_from(kept.len() / 1024 / 2).unwrap();
    let message = words_of(&with_little_space(blocks, TRAIN, &[&case, &broken]));
    for word in [
        "continuing from",
        "broken.checkpoint",
        "free space",
        "File too large",
    ] {
        assert!(message.contains(word), "{word}: {message}");
    }
    assert!(std::fs::read(&checkpoint).unwrap() == kept);
    // with enough space, training resumes from the checkpoint
    let message = done(&words(TRAIN, &[&case, &broken]));
    assert!(
        message.contains("continuing from the checkpoint"),
        "{message}"
    );
    assert!(std::fs::read(&whole).unwrap() == std::fs::read(&broken).unwrap());
    assert!(!checkpoint.exists());
}

#[test]
fn data_set_on_a_full_disk_continues_with_space() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let [whole, broken] = ["whole", "broken"].map(|name| folder.path().join(name));
    let line = "dataset --seed 3 --cases 300 --case {} --out {}";
    done(&words(line, &[&case, &whole]));
    let bytes = std::fs::read(whole.join("shard-0-of-1.tset")).unwrap();
    // the unit of `ulimit -f` is 512 or 1024 bytes, depending on the shell
    let blocks = u32::try_from(bytes.len() / 1024 * 3 / 4).unwrap();
    let message = words_of(&with_little_space(blocks, line, &[&case, &broken]));
    for word in ["shard-0-of-1.part", "free space", "same command"] {
        assert!(message.contains(word), "{word}: {message}");
    }
    let part = std::fs::metadata(broken.join("shard-0-of-1.part")).unwrap();
    assert!(part.len() > 0);
    done(&words(line, &[&case, &broken]));
    assert!(std::fs::read(broken.join("shard-0-of-1.tset")).unwrap() == bytes);
}

#[test]
fn a_scene_on_a_full_disk_leaves_an_earlier_set_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [set, scene] = ["set", "tank.toml"].map(|name| folder.path().join(name));
    done(&words("judge --set presses-10 --count 1 --out {}", &[&set]));
    let content = || {
        let files = std::fs::read_dir(&set).unwrap();
        let files = files.map(|file| file.unwrap().path());
        let mut files: Vec<_> = files
            .map(|path| (std::fs::read(&path).unwrap(), path))
            .collect();
        files.sort();
        files
    };
    let before = content();
    std::fs::write(&scene, "[disc-tank]\nelectrodes = 16\n").unwrap();
    let line = "scene run {} --frames 400 --force --out {}";
    let message = words_of(&with_little_space(1000, line, &[&scene, &set]));
    let full = "truth.csv cannot be written: File too large";
    assert!(message.contains(full), "{message}");
    assert!(content() == before);
}
