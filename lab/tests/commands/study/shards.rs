//! Shards as the scheduler of a cluster starts them: two processes on one shard, SIGTERM, other settings, merging.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::program::{done, lab, words};

/// Timeout for the first records of a shard on a busy machine.
const DEADLINE: Duration = Duration::from_secs(120);

fn tank(folder: &Path) -> PathBuf {
    let case = folder.join("tank");
    let line = "mesh --preset disc-tank --set radius_mm=100.0 --set electrodes=8 --set fineness=0.5 --out {}";
    done(&words(line, &[&case]));
    case
}

/// Exit code and standard error.
fn ended(output: &Output) -> (Option<i32>, String) {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), text)
}

fn refused(line: &str, paths: &[&Path]) -> (Option<i32>, String) {
    ended(&lab(&words(line, paths)))
}

fn started(line: &str, paths: &[&Path]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(words(line, paths))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn wait_for(what: &str, holds: impl Fn() -> bool) {
    let begun = Instant::now();
    while !holds() {
        assert!(begun.elapsed() < DEADLINE, "{what}");
        std::thread::park_timeout(Duration::from_millis(5));
    }
}

fn length(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |found| found.len())
}

fn terminate(child: &Child) {
    let pid = child.id().to_string();
    let kill = Command::new("kill").args(["-TERM", &pid]).status().unwrap();
    assert!(kill.success());
}

const SET: &str = "dataset --shard 0/1 --seed 3 --cases 6000 --case {} --out {}";

#[test]
fn second_process_on_a_shard_ends_with_75() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let (alone, shared) = (folder.path().join("alone"), folder.path().join("shared"));
    let part = shared.join("shard-0-of-1.part");
    let first = started(SET, &[&case, &shared]);
    wait_for("no record is written", || length(&part) > 20_000);
    let (code, message) = refused(SET, &[&case, &shared]);
    assert_eq!(code, Some(75), "{message}");
    assert!(
        message.contains("shard-0-of-1.part") && message.contains("another process"),
        "{message}"
    );
    let (code, message) = ended(&first.wait_with_output().unwrap());
    assert_eq!(code, Some(0), "{message}");
    done(&words(SET, &[&case, &alone]));
    let bytes = |folder: &Path| std::fs::read(folder.join("shard-0-of-1.tset")).unwrap();
    assert!(bytes(&alone) == bytes(&shared));
}

#[test]
fn sigterm_leaves_whole_blocks_and_ends_with_75() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let (alone, stopped) = (folder.path().join("alone"), folder.path().join("stopped"));
    let part = stopped.join("shard-0-of-1.part");
    let child = started(SET, &[&case, &stopped]);
    wait_for("no record is written", || length(&part) > 20_000);
    terminate(&child);
    let (code, message) = ended(&child.wait_with_output().unwrap());
    assert_eq!(code, Some(75), "{message}");
    assert!(
        message.contains("SIGTERM") && message.contains("of 6000"),
        "{message}"
    );
    let completed: usize = message
        .split("SIGTERM: ")
        .nth(1)
        .and_then(|rest| rest.split(' ').next())
        .and_then(|number| number.parse().ok())
        .unwrap();
    assert!(completed > 0 && completed.is_multiple_of(64), "{message}");
    // the same command continues the existing shard
    let output = lab(&words(SET, &[&case, &stopped]));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains(&format!("{completed} of them from an earlier run")),
        "{text}"
    );
    done(&words(SET, &[&case, &alone]));
    let bytes = |folder: &Path| std::fs::read(folder.join("shard-0-of-1.tset")).unwrap();
    assert!(bytes(&alone) == bytes(&stopped));
}

#[test]
fn wrong_shards_end_with_2_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    for line in [
        "dataset --shard 4/4 --out {}",
        "dataset --shard 0 --out {}",
        "dataset --missing 0 --out {}",
        "dataset --merge 2 --out {}",
        "dataset --shard 0/2 --missing 2 --out {}",
    ] {
        let (code, message) = refused(line, &[&out]);
        assert_eq!(code, Some(2), "{line}: {message}");
        assert!(!out.exists(), "{line}");
    }
    let settings = folder.path().join("settings.toml");
    std::fs::write(&settings, "polygons = \"many\"\n").unwrap();
    let (code, message) = refused("dataset --settings {} --out {}", &[&settings, &out]);
    assert_eq!(code, Some(78), "{message}");
    assert!(message.contains("settings.toml") && !out.exists());
}

#[test]
fn missing_shards_are_listed_and_merged_when_made() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let at = |name: &str| folder.path().join(name);
    let make = |shard: &str, out: &Path| {
        let line = format!("dataset --shard {shard} --seed 3 --cases 150 --case {{}} --out {{}}");
        done(&words(&line, &[&case, out]));
    };
    let missing = |of: usize, seed: u64| {
        let line =
            format!("dataset --missing {of} --seed {seed} --cases 150 --case {{}} --out {{}}");
        lab(&words(&line, &[&case, &at("parts")]))
    };
    let listed = |output: Output| String::from_utf8(output.stdout).unwrap();
    assert_eq!(listed(missing(10, 3)), "0-9\n");
    for shard in [1, 2, 4, 5, 6] {
        make(&format!("{shard}/10"), &at("parts"));
    }
    assert_eq!(listed(missing(10, 3)), "0,3,7-9\n");
    let (code, message) = ended(&missing(10, 4));
    assert_eq!(code, Some(2), "{message}");
    assert!(
        message.contains("shard-1-of-10.json")
            && message.contains("settings.seed is 3 there and 4"),
        "{message}"
    );
    let merge = |seed: u64| {
        let line = format!(
            "dataset --merge 10 --seed {seed} --cases 150 --case {{}} --parts {{}} --out {{}}"
        );
        refused(&line, &[&case, &at("parts"), &at("merged")])
    };
    let (code, message) = merge(3);
    assert_eq!(code, Some(1), "{message}");
    assert!(
        message.contains("shard-0-of-10.tset, shard-3-of-10.tset"),
        "{message}"
    );
    assert!(!at("merged").exists());
    for shard in [0, 3, 7, 8, 9] {
        make(&format!("{shard}/10"), &at("parts"));
    }
    assert_eq!(listed(missing(10, 3)), "\n");
    let (code, message) = merge(4);
    assert_eq!(code, Some(2), "{message}");
    assert!(message.contains("settings.seed") && !at("merged").exists());
    assert_eq!(merge(3).0, Some(0));
    make("0/1", &at("whole"));
    for file in ["shard-0-of-1.tset", "shard-0-of-1.json"] {
        let read = |name: &str| std::fs::read(at(name).join(file)).unwrap();
        assert!(read("merged") == read("whole"), "{file}");
    }
    // a shard of another division of the same set is refused
    let line = "dataset --shard 0/2 --seed 3 --cases 150 --case {} --out {}";
    let (code, message) = refused(line, &[&case, &at("parts")]);
    assert_eq!(code, Some(2), "{message}");
}

#[test]
fn shards_made_at_the_same_time_do_not_disturb_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let case = tank(folder.path());
    let out = folder.path().join("set");
    let children: Vec<Child> = (0..60)
        .map(|index| {
            let line = format!("dataset --shard {index}/60 --cases 120 --case {{}} --out {{}}");
            started(&line, &[&case, &out])
        })
        .collect();
    for child in children {
        let (code, message) = ended(&child.wait_with_output().unwrap());
        assert_eq!(code, Some(0), "{message}");
    }
    let output = lab(&words(
        "dataset --missing 60 --cases 120 --case {} --out {}",
        &[&case, &out],
    ));
    assert_eq!(output.stdout, b"\n");
}

#[test]
fn held_shard_of_a_study_ends_with_75_until_released() {
    let folder = tempfile::tempdir().unwrap();
    let parts = folder.path().join("parts");
    std::fs::create_dir(&parts).unwrap();
    let held = std::fs::File::create(parts.join("shard-0-of-1.part")).unwrap();
    held.try_lock().unwrap();
    let line = "stability --only 40 --shard 0/1 --parts {}";
    let (code, message) = refused(line, &[&parts]);
    assert_eq!(code, Some(75), "{message}");
    assert!(message.contains("shard-0-of-1.part"), "{message}");
    let (code, message) = refused(&format!("{line} --json"), &[&parts]);
    assert_eq!(code, Some(75));
    assert!(message.contains(r#""kind":"busy","code":75"#), "{message}");
    drop(held);
    done(&words(line, &[&parts]));
    assert!(parts.join("shard-0-of-1.jsonl").is_file());
    assert!(!parts.join("shard-0-of-1.part").exists());
}

#[test]
fn sigterm_leaves_whole_items_of_a_study_and_ends_with_75() {
    // the baseline is an item too
    const SET: &str = "judge --set polygons --count 120 --seed 5 --shard 0/1 --parts {}";
    let folder = tempfile::tempdir().unwrap();
    let (alone, stopped) = (folder.path().join("alone"), folder.path().join("stopped"));
    let part = stopped.join("shard-0-of-1.part");
    let child = started(SET, &[&stopped]);
    wait_for("no item is written", || length(&part) > 20_000);
    terminate(&child);
    let (code, message) = ended(&child.wait_with_output().unwrap());
    assert_eq!(code, Some(75), "{message}");
    assert!(
        message.contains("SIGTERM") && message.contains("of 121"),
        "{message}"
    );
    let text = std::fs::read_to_string(&part).unwrap();
    assert!(text.ends_with('\n'), "the item in work is complete");
    // the first line describes the work
    let items = text.lines().count() - 1;
    assert!((1..121).contains(&items), "{items}");
    let output = lab(&words(SET, &[&stopped]));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        text.contains(&format!("121 items, {items} of them from an earlier run")),
        "{text}"
    );
    done(&words(SET, &[&alone]));
    let bytes = |folder: &Path| std::fs::read(folder.join("shard-0-of-1.jsonl")).unwrap();
    assert!(bytes(&alone) == bytes(&stopped));
}
