//! Studies in shards: the merged result equals that of one process, for any number of threads.

use std::path::Path;
use std::process::{Command, Output};

use crate::program::{done, words};

/// Runs the program with the given number of threads.
fn with_threads(threads: &str, line: &str, paths: &[&Path]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(words(line, paths))
        .env("RAYON_NUM_THREADS", threads)
        .output()
        .unwrap()
}

fn text(output: Output) -> String {
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    String::from_utf8(output.stdout).unwrap()
}

/// The output without measured times, which depend on the machine.
fn without_times(text: &str) -> Vec<serde_json::Value> {
    text.lines()
        .map(|line| {
            let mut value: serde_json::Value = serde_json::from_str(line).unwrap();
            value.as_object_mut().unwrap().remove("frame_ms");
            value
        })
        .collect()
}

/// Makes all shards of a study in reverse order, each with another number of threads; returns the list of missing
/// shards before the last one.
fn make_shards(study: &str, of: usize, fixed: &[&Path], parts: &Path) -> String {
    let with_parts = [fixed, &[parts]].concat();
    let mut listed = String::new();
    for index in (0..of).rev() {
        if index == 0 {
            let line = format!("{study} --missing {of} --parts {{}}");
            listed = text(with_threads("1", &line, &with_parts));
        }
        let line = format!("{study} --shard {index}/{of} --parts {{}}");
        let threads = ["1", "2", "8"][index % 3];
        text(with_threads(threads, &line, &with_parts));
    }
    listed
}

#[test]
fn merged_evaluation_equals_that_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let (set, parts) = (folder.path().join("set"), folder.path().join("parts"));
    done(&words(
        "judge --set presses-30 --count 2 --seed 11 --out {}",
        &[&set],
    ));
    let line = "evaluate --json --set {} --set {} --method one-step --method tv-paper";
    let whole = text(with_threads("2", line, &[&set, &set]));
    let listed = make_shards(line, 3, &[&set, &set], &parts);
    assert_eq!(listed, "0\n");
    let merge = format!("{line} --merge 3 --parts {{}}");
    let merged = text(with_threads("8", &merge, &[&set, &set, &parts]));
    assert_eq!(without_times(&merged), without_times(&whole));
    assert_eq!(merged.lines().count(), 4);
    // another set in the same folder is another study
    done(&words(
        "judge --set presses-30 --count 2 --seed 12 --force --out {}",
        &[&set],
    ));
    let refused = with_threads("1", &merge, &[&set, &set, &parts]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{message}");
    assert!(
        message.contains("shard-0-of-3.jsonl") && message.contains("settings.sets"),
        "{message}"
    );
}

#[test]
fn merged_test_set_equals_that_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let line = "judge --set polygons --count 3 --seed 5 --spray 0.1";
    for (threads, name) in [("1", "whole-1"), ("8", "whole-8")] {
        let line = format!("{line} --out {{}}");
        text(with_threads(threads, &line, &[&at(name)]));
    }
    assert_eq!(make_shards(line, 2, &[], &at("parts")), "0\n");
    let merge = format!("{line} --merge 2 --parts {{}} --out {{}}");
    text(with_threads("2", &merge, &[&at("parts"), &at("merged")]));
    for file in ["frames.csv", "truth.csv", "judged.json", "nodes.csv"] {
        let read = |name: &str| std::fs::read(at(name).join(file)).unwrap();
        assert!(read("merged") == read("whole-1"), "{file}");
        assert!(read("whole-8") == read("whole-1"), "{file}");
    }
}

#[test]
fn merged_hard_cases_equal_those_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // cases whose naive implementation is inaccurate, accurate, or failing
    let line = "stability --only 8 --only 25 --only 30 --only 31 --only 33 --only 35 --only 40";
    for (threads, name) in [("1", "whole-1"), ("2", "whole-2"), ("8", "whole-8")] {
        let line = format!("{line} --out {{}}");
        text(with_threads(threads, &line, &[&at(name)]));
    }
    make_shards(line, 4, &[], &at("parts"));
    let merge = format!("{line} --merge 4 --parts {{}} --out {{}}");
    text(with_threads("2", &merge, &[&at("parts"), &at("merged")]));
    for file in ["table.txt", "table.json", "contrast.png"] {
        let read = |name: &str| std::fs::read(at(name).join(file)).unwrap();
        for other in ["whole-1", "whole-2", "whole-8"] {
            assert!(read("merged") == read(other), "{file} of {other}");
        }
    }
}

#[test]
fn merged_diagrams_equal_those_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let line = "tradeoff --quick --only acquisition --only uncertainty --out {}";
    text(with_threads("2", line, &[&at("whole")]));
    make_shards(line, 2, &[&at("shared")], &at("parts"));
    // merging into another folder uses only the results in the shards
    let merge = format!("{line} --merge 2 --parts {{}}");
    text(with_threads("1", &merge, &[&at("merged"), &at("parts")]));
    for file in ["acquisition.json", "uncertainty.json"] {
        let read = |name: &str| {
            let bytes = std::fs::read(at(name).join(file)).unwrap();
            let mut table: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
            table["settings"]["threads"].take();
            table
        };
        assert_eq!(read("merged"), read("whole"), "{file}");
    }
    let picture = |name: &str| std::fs::read(at(name).join("acquisition.svg")).unwrap();
    assert!(picture("merged") == picture("whole"));
}

#[test]
fn shards_without_a_folder_are_refused() {
    for line in [
        "stability --shard 0/2",
        "evaluate --shard 2/2 --parts {}",
        "judge --set presses-10 --merge 2",
        "stability --only 40 --merge 2",
        "evaluate --missing 2 --merge 2 --parts {}",
        "evaluate --shard 0/2 --parts {} --picture {}",
        "judge --set presses-10 --shard 0/2 --parts {} --out {}",
        "stability --only 40 --parts {}",
    ] {
        let folder = tempfile::tempdir().unwrap();
        let (parts, other) = (folder.path().join("parts"), folder.path().join("other"));
        let refused = with_threads("1", line, &[&parts, &other]);
        assert_eq!(refused.status.code(), Some(2), "{line}");
        assert!(!parts.exists() && !other.exists(), "{line}");
    }
}

#[test]
fn merged_figure_equals_that_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let line = "paper --quick --figure 7 --out {}";
    text(with_threads("2", line, &[&at("whole")]));
    // both shards run at the same time: each model and each test set is made by only one of them
    let shards: Vec<_> = ["0/2", "1/2"]
        .into_iter()
        .map(|shard| {
            Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
                .args(words(
                    &format!("{line} --shard {shard} --parts {{}}"),
                    &[&at("shared"), &at("parts")],
                ))
                .stderr(std::process::Stdio::piped())
                .spawn()
                .unwrap()
        })
        .collect();
    let mut messages = String::new();
    for shard in shards {
        let output = shard.wait_with_output().unwrap();
        messages += &String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{messages}");
    }
    for made in ["judge --set test-2", "train dnn", "train linear"] {
        let runs = messages
            .lines()
            .filter(|line| line.starts_with(&format!("tactus-lab {made}")));
        assert_eq!(runs.count(), 1, "{made}: {messages}");
    }
    let merge = format!("{line} --merge 2 --parts {{}}");
    text(with_threads("8", &merge, &[&at("merged"), &at("parts")]));
    for file in ["figure-7.png", "figure-7.svg", "figure-7-each.svg"] {
        let read = |name: &str| std::fs::read(at(name).join(file)).unwrap();
        assert!(read("merged") == read("whole"), "{file}");
    }
    // the report of the merge neither evaluates nor trains
    assert!(!at("merged").join("sets/test-2-2uV").exists());
}
