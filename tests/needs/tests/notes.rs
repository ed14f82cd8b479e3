//! A missing requirement is noted and listed once; it fails the test if `TACTUS_REQUIRE_<KIND>=1`.

use std::path::Path;
use std::process::Command;

/// Selects what a copy of this executable does.
const PART: &str = "TACTUS_NEEDS_PART";

/// Runs in copies of this executable, as selected by the variable.
#[test]
fn part() {
    match std::env::var(PART).as_deref() {
        Ok("lack") => needs::lacking("TRIAL", "a thing\tthat is\nnowhere"),
        Ok("list") => println!("{:?}", needs::not_run().unwrap()),
        _ => {}
    }
}

/// Runs a copy of this executable in a target folder of its own; whether it passed, and what it printed.
fn play(copy: &Path, part: &str, required: &str) -> (bool, String) {
    let run = Command::new(copy)
        .args(["--exact", "part", "--nocapture"])
        .env(PART, part)
        .env("TACTUS_REQUIRE_TRIAL", required)
        .output()
        .unwrap();
    let [out, err] = [run.stdout, run.stderr].map(|text| String::from_utf8(text).unwrap());
    (run.status.success(), out + &err)
}

#[test]
fn a_lack_is_listed_once_and_fails_where_required() {
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("notes");
    let deps = target.join("debug/deps");
    std::fs::create_dir_all(&deps).unwrap();
    let copy = deps.join("copy-0");
    std::fs::copy(std::env::current_exe().unwrap(), &copy).unwrap();
    // a note of another run
    let stale = "0\told\ttest\tTRIAL\tgone\n";
    std::fs::write(target.join("tests-not-run.tsv"), stale).unwrap();
    for _ in 0..2 {
        let (passed, printed) = play(&copy, "lack", "0");
        assert!(passed && printed.contains("a thing that is nowhere"));
    }
    let (passed, printed) = play(&copy, "list", "0");
    let list = "[\"copy | part | TRIAL | a thing that is nowhere\"]";
    assert!(passed && printed.contains(list), "{printed}");
    let (passed, printed) = play(&copy, "lack", "1");
    assert!(!passed && printed.contains("TACTUS_REQUIRE_TRIAL=1"));
}
