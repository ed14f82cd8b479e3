//! Every command that prints data prints one JSON object per line, and fails with the documented exit code.

use crate::test_rig::{self, Needs, ask, baseline, measure, number};

/// The section of the reference page whose heading names the command.
fn documented(command: &[&str]) -> &'static str {
    let page = include_str!("../../../docs/reference/json.md");
    let of = |words: &[&str]| {
        let name = words.join(" ");
        page.split("\n## ").find(|section| {
            let heading = section.lines().next().unwrap_or_default();
            heading.split(", ").any(|named| named == name)
        })
    };
    let two = command.get(..2).and_then(of);
    two.or_else(|| of(&command[..1]))
        .unwrap_or_else(|| panic!("{command:?} has no section"))
}

#[test]
fn every_command_prints_json_on_request() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let daemon = test_rig::start(&stage);
    baseline(&stage, 2);
    let id = measure(&stage, 2);
    let picture = stage.path().join("map.png").display().to_string();
    let fields: [(&[&str], &[&str]); 14] = [
        (
            &["status"],
            &[
                "state",
                "simulated",
                "source",
                "method",
                "baseline",
                "session",
                "version",
                "bus",
            ],
        ),
        (
            &["instruments"],
            &["id", "role", "state", "identity", "address", "simulated"],
        ),
        (&["instruments", "test"], &["event"]),
        (
            &["instruments", "relays"],
            &["relay", "purpose", "cycles", "rated", "used", "left_s"],
        ),
        (
            &["instruments", "discover", "--no-mdns", "--no-broadcast"],
            &[
                "event", "address", "identity", "found_by", "name", "in_use", "proposal", "remark",
            ],
        ),
        (
            &["plan", "--reversal", "--averages", "4"],
            &[
                "duration_s",
                "reversal",
                "averages",
                "skip",
                "half",
                "costs",
            ],
        ),
        (
            &["baseline", "show"],
            &["id", "wall", "frames", "volts", "flags", "noise_v"],
        ),
        (
            &["sessions", "show", "last"],
            &[
                "id",
                "settings",
                "about",
                "method",
                "calibration",
                "baseline",
                "bytes",
                "duration_s",
            ],
        ),
        (
            &["sessions"],
            &["id", "kind", "frames", "simulated", "closed", "path"],
        ),
        (
            &["plan"],
            &[
                "wiring",
                "steps",
                "readings",
                "reading_messages",
                "duration_s",
                "lines",
            ],
        ),
        (
            &["replay", &id, "--no-map"],
            &["frame", "method", "found_mm", "map_hash", "verified"],
        ),
        (
            &["quantities", &id],
            &["begin", "region", "quantity", "unit", "min", "mean", "max"],
        ),
        (
            &["quantities", &id, "--each-frame"],
            &["frame", "known", "unit", "regions", "spots"],
        ),
        (
            &["export", &id, "--format", "png", "--out", &picture],
            &["what", "path", "session", "simulated"],
        ),
    ];
    for (command, wanted) in fields {
        let lines = ask(&stage, command);
        assert!(
            !lines.is_empty(),
            "tactus {} printed nothing",
            command.join(" ")
        );
        for line in &lines {
            for field in wanted {
                assert!(
                    line.get(field).is_some(),
                    "tactus {}: no '{field}' in {line}",
                    command.join(" ")
                );
            }
            let documented = documented(command);
            for field in line.as_object().expect("an object").keys() {
                assert!(
                    documented.contains(&format!("`{field}`")),
                    "tactus {}: '{field}' is not in the table of docs/reference/json.md",
                    command.join(" ")
                );
            }
        }
    }
    let plan = &ask(&stage, &["plan"])[0];
    assert_eq!(plan["reading_messages"], 26);
    assert_eq!(plan["readings"], 598);
    let dearer = &ask(&stage, &["plan", "--reversal", "--averages", "4"])[0];
    assert!(
        number(dearer, "duration_s") > 6.0 * number(plan, "duration_s"),
        "{dearer}"
    );
    let tested = ask(&stage, &["instruments", "test"]);
    let (report, lines) = tested.split_last().expect("a report");
    assert_eq!(
        (&report["event"], &report["passed"]),
        (&"report".into(), &true.into()),
        "{report}"
    );
    assert!(
        lines
            .iter()
            .all(|line| line["event"] == "line" && line["verdict"] == "ok"),
        "{lines:?}"
    );
    let instruments = ask(&stage, &["instruments"]);
    assert!(instruments.iter().any(|line| {
        line["identity"]
            .as_str()
            .is_some_and(|id| id.contains("6221"))
    }));
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn exit_codes_distinguish_kinds_of_failure() {
    let Some(stage) = test_rig::set(Needs::ANY, test_rig::NOISY) else {
        return;
    };
    let code = |args: &[&str]| stage.tactus(args).unwrap_or_else(|fault| panic!("{fault}"));
    let nobody = code(&["status"]);
    assert_eq!(nobody.code, Some(3), "{}", nobody.stderr);
    assert!(
        nobody.stderr.contains("tactusd"),
        "says how to start one: {}",
        nobody.stderr
    );
    assert_eq!(code(&["frobnicate"]).code, Some(2));
    let _guard = test_rig::start(&stage);
    assert_eq!(
        code(&["export", "nosuch", "--format", "csv", "--out", "x.csv"]).code,
        Some(3)
    );
    assert_eq!(code(&["stop", "nosuch"]).code, Some(3));
    assert_eq!(code(&["completions", "bash"]).code, Some(0));
}
