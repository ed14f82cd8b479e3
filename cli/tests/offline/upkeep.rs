//! Verification, repair and pruning of records, and verification of their maps.

use std::path::Path;

use logbook::MapRecord;
use survey::Map;

use crate::scene::{done, lines, refused, session, session_of, session_with, tactus};

/// Configuration of the sessions in these tests.
const NOISE: &str = "[model]\nnoise_uv = 3.0\n";

/// Flips a bit of a file, `behind` bytes after a given text.
fn bend(path: &Path, near: &[u8], behind: usize) {
    let mut bytes = std::fs::read(path).unwrap();
    let place = bytes
        .windows(near.len())
        .rposition(|window| window == near)
        .expect("the file has it");
    bytes[place + behind] ^= 0x40;
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn a_whole_record_is_verified_and_a_damaged_one_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = session(folder.path());
    let message = lines(&done(
        folder.path(),
        &["sessions", "verify", "m2027", "--json"],
    ));
    assert_eq!(message.len(), 1);
    assert_eq!(
        (
            &message[0]["intact"],
            &message[0]["frames"],
            &message[0]["session"]
        ),
        (&true.into(), &3.into(), &"m20270115_1".into())
    );
    let keys: Vec<_> = message[0].as_object().unwrap().keys().collect();
    assert_eq!(
        keys,
        [
            "intact", "session", "parts", "frames", "closed", "gaps", "findings"
        ]
    );
    let message = done(folder.path(), &["sessions", "verify", "--all"]);
    assert!(
        message.contains("m20270115_1: intact: 3 frames in 1 part"),
        "{message}"
    );

    // the note is in the header
    bend(&path, b"three frames", 1);
    let output = tactus(folder.path(), &["sessions", "verify", "--all"]);
    assert_eq!(output.status.code(), Some(1));
    let message = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        message.contains("DAMAGED") && message.contains("header"),
        "{message}"
    );
    assert!(refused(folder.path(), &["sessions", "verify"], 2).contains("SESSIONS"));
}

#[test]
fn verify_of_all_fails_where_a_file_is_no_session_any_more() {
    let folder = tempfile::tempdir().unwrap();
    let path = session(folder.path());
    let whole = std::fs::read(&path).unwrap();
    let damages: [(&str, Vec<u8>); 4] = [
        ("empty", Vec::new()),
        ("a damaged beginning", [b"x", &whole[1..]].concat()),
        ("another application id", {
            let mut bytes = whole.clone();
            bytes[68] ^= 1;
            bytes
        }),
        ("cut off", whole[..50].to_vec()),
    ];
    for (name, bytes) in damages {
        std::fs::write(&path, bytes).unwrap();
        for format in [
            &["sessions", "verify", "--all"][..],
            &["sessions", "verify", "--all", "--json"],
        ] {
            let output = tactus(folder.path(), format);
            let message = String::from_utf8_lossy(&output.stdout).into_owned();
            assert_eq!(output.status.code(), Some(1), "{name}: {message}");
            assert!(message.contains("unreadable"), "{name}: {message}");
            if format.contains(&"--json") {
                let line = &lines(&message)[0];
                assert_eq!(line["intact"], false, "{name}: {message}");
                assert_eq!(line["session"], "m20270115_1", "{name}: {message}");
                assert_eq!(
                    line["findings"][0]["part"], "m20270115_1",
                    "{name}: {message}"
                );
            }
        }
    }
}

#[test]
fn repair_writes_good_frames_to_new_file_and_keeps_the_old() {
    let folder = tempfile::tempdir().unwrap();
    let path = session_of(folder.path(), "m1", NOISE);
    let before = std::fs::read(&path).unwrap();
    let message = done(folder.path(), &["sessions", "repair", "m1"]);
    assert!(
        message.contains("m1_repaired.tactus: 3 frames"),
        "{message}"
    );
    assert!(
        message.contains("baseline kept") && !message.contains("cut"),
        "{message}"
    );
    assert_eq!(std::fs::read(&path).unwrap(), before);
    let whole = lines(&done(
        folder.path(),
        &["sessions", "verify", "m1_repaired", "--json"],
    ));
    assert_eq!(whole[0]["intact"], true);
    // the records of the maps are kept too
    done(folder.path(), &["replay", "m1_repaired", "--verify"]);
    let again = refused(folder.path(), &["sessions", "repair", "m1"], 1);
    assert!(again.contains("exists already"), "{again}");
    done(
        folder.path(),
        &["sessions", "repair", "m1", "--out", "good.tactus"],
    );
    assert!(folder.path().join("good.tactus").exists());
}

#[test]
fn only_what_was_exported_goes_and_a_dry_run_removes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let first = session(folder.path());
    let second = session_of(folder.path(), "m2", "");
    let exported_only = ["sessions", "prune", "--exported-only"];
    assert!(done(folder.path(), &exported_only).contains("0 sessions were removed"));
    done(
        folder.path(),
        &["export", "m2027", "--format", "csv", "--out", "out.csv"],
    );
    let message = done(
        folder.path(),
        &[&exported_only[..], &["--dry-run"]].concat(),
    );
    assert!(
        message.contains("m20270115_1 would be removed"),
        "{message}"
    );
    assert!(first.exists());
    let message = lines(&done(
        folder.path(),
        &[&exported_only[..], &["--json"]].concat(),
    ));
    let what: Vec<_> = message
        .iter()
        .map(|line| (&line["what"], &line["id"]))
        .collect();
    assert_eq!(
        what,
        [
            (&"removed".into(), &"m20270115_1".into()),
            (&"spared".into(), &"m2".into())
        ]
    );
    assert!(!first.exists() && second.exists());
    assert!(!first.with_extension("exported.json").exists());
    let message = std::fs::read_to_string(folder.path().join("pruned.jsonl")).unwrap();
    assert!(message.contains("m20270115_1"), "{message}");
    // all sessions of these tests are dated 2027, so that none counts as old; a limit of zero bytes cannot be reached
    assert!(refused(folder.path(), &["sessions", "prune"], 2).contains("--older-than"));
    let message = done(folder.path(), &["sessions", "prune", "--keep-bytes", "0"]);
    assert!(message.contains("m2 was removed"), "{message}");
    assert!(!second.exists());
}

#[test]
fn sessions_removed_in_spite_of_a_failure_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let first = session_of(folder.path(), "m1", "");
    let second = session_of(folder.path(), "m2", "");
    let third = session_of(folder.path(), "m3", "");
    // a folder in place of a file, which cannot be removed like one
    std::fs::create_dir(folder.path().join("m2-failed-1.json")).unwrap();
    let prune = ["sessions", "prune", "--keep-bytes", "0"];
    let output = tactus(folder.path(), &prune);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("m2-failed-1.json"), "{message}");
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        printed.contains("m1 was removed") && printed.contains("m3 was removed"),
        "{printed}"
    );
    assert!(printed.contains("2 sessions were removed"), "{printed}");
    assert!(!first.exists() && second.exists() && !third.exists());
}

#[test]
fn maps_are_verified_against_what_was_kept_of_them() {
    let folder = tempfile::tempdir().unwrap();
    session_of(folder.path(), "m1", NOISE);
    let message = done(folder.path(), &["replay", "m1", "--verify", "--no-map"]);
    assert!(
        message.contains("3 maps are identical to the recorded ones"),
        "{message}"
    );
    session_with(
        folder.path(),
        "m2",
        NOISE,
        |_, record, second| match second {
            3 => MapRecord {
                hash: "0".repeat(64),
                ..record
            },
            _ => record,
        },
    );
    let message = refused(folder.path(), &["replay", "m2", "--verify"], 1);
    assert!(
        message.contains("1 of m2's maps") && message.contains("frame 3"),
        "{message}"
    );
    let output = tactus(folder.path(), &["replay", "m2", "--verify", "--json"]);
    let last = lines(&String::from_utf8_lossy(&output.stdout))
        .pop()
        .unwrap();
    assert_eq!(
        (&last["same"], &last["different"][0]),
        (&2.into(), &3.into())
    );
    session(folder.path());
    let message = refused(
        folder.path(),
        &["replay", "m20270115_1", "--verify", "--preset", "disc-tank"],
        1,
    );
    assert!(message.contains("nothing to verify"), "{message}");
}

/// Another processor may add in another order: the bits differ, but the map is the same up to rounding.
#[test]
fn maps_of_another_build_are_verified_within_a_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    // as if made by another build: first with a small deviation, then with a large one
    let elsewhere = |beside: f64| {
        move |map: &Map, record, _| MapRecord {
            hash: "0".repeat(64),
            sum: Some((map.signed_sum(0) * (1.0 + beside)) as f32),
            build: "tactusd 0.0.7".into(),
            ..record
        }
    };
    session_with(folder.path(), "near", NOISE, elsewhere(1e-5));
    let message = done(folder.path(), &["replay", "near", "--verify", "--no-map"]);
    assert!(
        message.contains("3 of another build or processor are within")
            && message.contains("of them (allowed: 1e-4); the other build: tactusd 0.0.7"),
        "{message}"
    );
    session_with(folder.path(), "far", NOISE, elsewhere(0.1));
    let message = refused(folder.path(), &["replay", "far", "--verify"], 1);
    assert!(message.contains("2 of far's maps"), "{message}");
    session_with(folder.path(), "untold", NOISE, |_, record, _| MapRecord {
        hash: "0".repeat(64),
        sum: None,
        build: "tactusd 0.0.7".into(),
        ..record
    });
    let message = done(folder.path(), &["replay", "untold", "--verify", "--no-map"]);
    assert!(message.contains("cannot be verified"), "{message}");
}

/// Tests the claim about the tolerance in `replay.rs`: far above rounding, far below noise.
#[test]
fn the_tolerance_of_a_map_lies_between_rounding_and_noise() {
    let folder = tempfile::tempdir().unwrap();
    session_of(folder.path(), "m1", NOISE);
    let export = ["export", "m1", "--format", "csv", "--out", "out.csv"];
    done(folder.path(), &export);
    let written = std::fs::read_to_string(folder.path().join("out.case/frames.csv")).unwrap();
    for method in ["one-step", "tv"] {
        let map = |change: &dyn Fn(f64, usize) -> f64| -> Vec<f64> {
            let altered: Vec<String> = written
                .lines()
                .map(|line| {
                    let fields = line.split(',').enumerate().map(|(column, field)| {
                        let number: Option<f64> = field.parse().ok();
                        number.map_or(field.to_owned(), |x| change(x, column).to_string())
                    });
                    fields.collect::<Vec<_>>().join(",")
                })
                .collect();
            std::fs::write(folder.path().join("altered.csv"), altered.join("\n") + "\n").unwrap();
            let mut words = vec!["replay", "out.case", "--frames", "altered.csv"];
            words.extend(["--baseline", "out.case/baseline.csv", "--no-map"]);
            words.extend(["--preset", "disc-tank", "--noise-v", "3e-6"]);
            words.extend(["--method", method, "--force", "--out", "maps.csv"]);
            done(folder.path(), &words);
            let maps = std::fs::read_to_string(folder.path().join("maps.csv")).unwrap();
            let last = maps.lines().last().unwrap();
            // the first column is the frame's label
            let values = last.split(',').skip(1);
            values.map(|value| value.parse().unwrap()).collect()
        };
        let as_it_is = map(&|x, _| x);
        let apart = |other: &[f64]| {
            let squares = as_it_is.iter().zip(other).map(|(a, b)| (a - b).powi(2));
            let length: f64 = as_it_is.iter().map(|a| a * a).sum();
            (squares.sum::<f64>() / length).sqrt()
        };
        let sign = |column: usize| if column.is_multiple_of(3) { 1.0 } else { -1.0 };
        let rounded = apart(&map(&|x, column| x * (1.0 + sign(column) * f64::EPSILON)));
        let noisy = apart(&map(&|x, column| x + sign(column) * 2e-6));
        println!("{method}: {rounded:.1e} by rounding, {noisy:.1e} by 2 uV");
        assert!(rounded < 1e-9, "{rounded:e}");
        assert!(noisy > 1e-3, "{noisy:e}");
    }
}
