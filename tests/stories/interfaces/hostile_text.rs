//! An instrument with a hostile serial number and a session with a hostile note: displayed text never controls the
//! terminal or imitates a line of output.

use crate::test_rig::{self, Needs, ask, baseline};

/// As passed on a command line: an argument cannot contain NUL.
const NOTE: &str = "a\n2027-01-15 08:00:09  alarm  forged\r\u{1b}[2J\u{202e}\u{9b}2J\"\"\"\\";

fn assert_shown(what: &str, text: &str) {
    let acts = |letter: &char| letter.is_control() && *letter != '\n' || *letter == '\u{202e}';
    let bad = text.chars().find(acts);
    assert_eq!(bad, None, "{what}: {text:?}");
    let forged = text
        .lines()
        .find(|line| line.starts_with("2027-01-15 08:00:09"));
    assert_eq!(forged, None, "{what}: {text}");
}

#[test]
fn hostile_identity_and_note_are_shown_escaped() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let profile = stage.path().join("profile.toml");
    let text = std::fs::read_to_string(&profile).expect("the stage wrote it");
    let serial = "[source]\nserial = \"7\\u001b[2J\\u202e\\u009b2J\\u0000\\r\\\"\\\"\\\"\"\n";
    std::fs::write(&profile, format!("{text}\n{serial}")).expect("the folder is there");
    let daemon = test_rig::start(&stage);
    baseline(&stage, 2);
    ask(&stage, &["start", "--count", "2", "--note", NOTE, "--wait"]);
    for words in [
        &["status"][..],
        &["instruments"],
        &["sessions"],
        &["log"],
        &["baseline", "show"],
        &["transcript"],
        &["doctor"],
        &["start", "--count", "1", "--note", NOTE, "--wait"],
        &["start", "--count", "1", "--baseline", NOTE],
        &["stop", NOTE],
        &["watch", NOTE],
    ] {
        for json in [false, true] {
            let mut words = words.to_vec();
            words.extend(json.then_some("--json"));
            let spoken = stage.tactus(&words).expect("it runs");
            assert_shown(&format!("{words:?}"), &spoken.stdout);
            assert_shown(&format!("{words:?}"), &spoken.stderr);
        }
    }
    let instruments = ask(&stage, &["instruments"]);
    let shown = instruments[0]["identity"].as_str().expect("an identity");
    assert!(shown.contains("7\\u{1b}[2J\\u{202e}"), "{shown}");
    let sessions = ask(&stage, &["sessions"]);
    assert!(
        sessions.iter().any(|session| session["note"] == NOTE),
        "{sessions:?}"
    );
    drop(daemon);
    let log = std::fs::read_to_string(stage.path().join("tactusd.log")).expect("its log");
    assert_shown("the daemon's log", &log);
}
