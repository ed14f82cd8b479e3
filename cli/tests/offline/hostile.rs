//! Hostile text in a record is displayed harmlessly.

use chrono::{DateTime, Utc};
use logbook::{DaemonLog, Event, SessionHeader, SessionWriter};
use serde_json::Value;
use survey::Protocol;

use crate::scene::tactus;

/// A line end, a carriage return, a cleared screen, reversed text, a C1 control, NUL, quotes of TOML.
const HOSTILE: &str =
    "a\n2027-01-15 08:00:09  alarm  all is well\r\u{1b}[2J\u{202e}\u{9b}2J\0\"\"\"\\";

fn at(second: i64) -> DateTime<Utc> {
    DateTime::from_timestamp_nanos(1_800_000_000_000_000_000 + second * 1_000_000_000)
}

#[test]
fn a_hostile_record_prints_no_control_characters() {
    let folder = tempfile::tempdir().unwrap();
    let long = HOSTILE.to_owned() + &"long ".repeat(10_000);
    let mut header = SessionHeader::new("m1", at(0), Protocol::sheffield(4).unwrap());
    header.note = HOSTILE.to_owned();
    let mut writer = SessionWriter::create(folder.path(), &header).unwrap();
    writer.event(at(1), HOSTILE, &long).unwrap();
    writer.close(at(2), HOSTILE).unwrap();
    let event = Event {
        at: at(3),
        kind: HOSTILE.into(),
        text: HOSTILE.into(),
    };
    DaemonLog::open(folder.path())
        .unwrap()
        .append(&event)
        .unwrap();
    std::fs::write(folder.path().join("\u{1b}[2J\n.tactus"), "no session").unwrap();
    for words in [
        &["sessions"][..],
        &["sessions", "verify", "m1"],
        &["sessions", "verify", "--all"],
        &["sessions", "repair", "m1"],
        &["sessions", "prune", "--older-than", "1d", "--dry-run"],
        &["log"],
        &["events", "m1"],
        &["events", "no\u{1b}[2J\nsuch"],
        &["replay", "m1"],
        &["export", "m1", "--format", "png", "--out", "x\u{1b}[2J.png"],
    ] {
        for json in [false, true] {
            let mut words = words.to_vec();
            words.extend(json.then_some("--json"));
            let output = tactus(folder.path(), &words);
            for (stream, bytes) in [("out", &output.stdout), ("err", &output.stderr)] {
                let text = std::str::from_utf8(bytes).unwrap();
                let bad = text
                    .chars()
                    .find(|letter| letter.is_control() && *letter != '\n' || *letter == '\u{202e}');
                assert_eq!(bad, None, "{words:?} {stream}: {text:?}");
                let forged = text
                    .lines()
                    .any(|line| line.starts_with("2027-01-15 08:00:09"));
                assert!(!forged, "{words:?} {stream}: {text}");
            }
        }
    }
    // JSON preserves every character
    let lines = |words: &[&str]| -> Vec<Value> {
        let output = tactus(folder.path(), words);
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    };
    let listed = lines(&["sessions", "--json"]);
    let m1 = listed.iter().find(|session| session["id"] == "m1").unwrap();
    assert_eq!(m1["note"], HOSTILE);
    assert_eq!(m1["reason"], HOSTILE);
    let events = lines(&["events", "m1", "--json"]);
    assert_eq!(events[0]["kind"], HOSTILE);
    assert_eq!(events[0]["text"], long);
}
