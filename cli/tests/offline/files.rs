//! Lists, tables, errors.

use std::path::Path;
use std::process::Command;

use crate::scene::{
    baseline_session, done, lines, refused, session, session_at_thirds_of_a_second,
    session_in_parts_with_alarms, tactus,
};

#[test]
fn sessions_are_listed_without_a_daemon() {
    let folder = tempfile::tempdir().unwrap();
    assert!(done(folder.path(), &["sessions"]).contains("no session in"));
    assert_eq!(done(folder.path(), &["sessions", "--json"]), "");
    let path = session(folder.path());
    assert_eq!(
        done(folder.path(), &["sessions", "--json"]),
        format!(
            "{{\"id\":\"m20270115_1\",\"kind\":\"measurement\",\"started\":\"2027-01-15T08:00:00Z\",\
             \"last_frame\":\"2027-01-15T08:00:03Z\",\"frames\":3,\"simulated\":true,\"closed\":true,\
             \"closed_at\":\"2027-01-15T08:00:04Z\",\"reason\":\"count reached\",\"electrodes\":16,\"readings\":208,\
             \"note\":\"three frames\",\"path\":\"{}\"}}\n",
            path.display()
        )
    );
    let text = done(folder.path(), &["sessions"]);
    assert!(
        text.contains("measurement (SIMULATED)") && text.contains("count reached"),
        "{text}"
    );
    std::fs::write(folder.path().join("x.tactus"), "not a session").unwrap();
    let output = tactus(folder.path(), &["sessions"]);
    assert_eq!(output.status.code(), Some(0));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(message.contains("x.tactus is left out"), "{message}");
}

#[test]
fn overload_is_exported_as_blank_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let message = done(
        folder.path(),
        &[
            "export", "m2027", "--format", "csv", "--out", "out.csv", "--json",
        ],
    );
    let what: Vec<_> = lines(&message)
        .iter()
        .map(|line| line["what"].clone())
        .collect();
    assert_eq!(what, ["frames", "baseline", "case"]);
    let table = std::fs::read_to_string(folder.path().join("out.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table
        .lines()
        .map(|line| line.split(',').collect())
        .collect();
    assert_eq!(rows.len(), 4);
    assert_eq!(
        rows[0][..11],
        [
            "sequence",
            "wall_utc",
            "monotonic_s",
            "duration_s",
            "simulated",
            "current_A",
            "overloads",
            "not_measured",
            "compliance",
            "missing",
            "m0_V"
        ]
    );
    assert!(rows.iter().all(|row| row.len() == 10 + 208));
    assert_eq!(rows[2][0..2], ["2", "2027-01-15T08:00:02.000000Z"]);
    assert_eq!(rows[2][6], "1");
    assert_eq!(rows[2][9], "m7:overload");
    assert_eq!(rows[2][10 + 7], "");
    assert!(!table.contains("E37") && !table.contains("NaN"));
    // equal to the last bit
    let baseline = std::fs::read_to_string(folder.path().join("out.baseline.csv")).unwrap();
    let mean = baseline.lines().nth(1).unwrap().split(',').nth(6).unwrap();
    assert_eq!(mean, rows[1][10]);
    assert!(
        baseline
            .lines()
            .nth(1)
            .unwrap()
            .starts_with("m0,0,1,2,3,ok,"),
        "electrodes count from 0 in every file"
    );
}

#[test]
fn events_are_those_of_all_parts_of_a_session() {
    let folder = tempfile::tempdir().unwrap();
    session_in_parts_with_alarms(folder.path());
    let events = lines(&done(folder.path(), &["events", "m1", "--json"]));
    let alarms: Vec<&str> = events
        .iter()
        .filter(|event| event["kind"] == "alarm-active" && event["session"] == "m1")
        .map(|event| event["text"].as_str().unwrap())
        .collect();
    assert_eq!(alarms.len(), 2, "{events:?}");
    assert!(alarms[0].contains("frame 2") && alarms[1].contains("frame 3"));
    // the name of a later part stands for this part alone
    let events = done(folder.path(), &["events", "m1_p3", "--json"]);
    assert!(events.contains("load of frame 3") && !events.contains("load of frame 2"));
}

#[test]
fn the_last_frame_is_not_in_a_part_without_frames() {
    let folder = tempfile::tempdir().unwrap();
    session_in_parts_with_alarms(folder.path());
    let shown = done(folder.path(), &["sessions", "show", "m1", "--json"]);
    let shown = &lines(&shown)[0];
    assert_eq!(shown["parts"].as_array().unwrap().len(), 4);
    assert_eq!(shown["last_frame"], "2027-01-15T08:00:03Z");
}

/// One of several folders is unreadable, like the daemon's folder for an ordinary user.
#[test]
fn an_unreadable_folder_is_reported_where_last_is_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    let own = folder.path().join("home/.local/state/tactus");
    std::fs::create_dir_all(&own).unwrap();
    session(&own);
    std::fs::create_dir(folder.path().join("state")).unwrap();
    std::fs::write(folder.path().join("state/tactus"), "no folder").unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_tactus"))
        .args(["sessions", "show", "last"])
        .env_remove("TACTUS_STATE")
        .env("TACTUS_BUS", "unix:path=/nonexistent/bus")
        .env("XDG_STATE_HOME", folder.path().join("state"))
        .env("HOME", folder.path().join("home"))
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{message}");
    assert!(message.contains("state/tactus is left out"), "{message}");
    // the unreadable folder is the only one
    let only = ["sessions", "show", "last", "--state", "state/tactus"];
    let message = refused(folder.path(), &only, 1);
    assert!(message.contains("state/tactus"), "{message}");
}

#[test]
fn a_file_that_may_be_the_last_session_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    std::fs::write(folder.path().join("m20270116_1.tactus"), "damaged").unwrap();
    let output = tactus(folder.path(), &["sessions", "show", "last", "--json"]);
    assert_eq!(output.status.code(), Some(0));
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        message.contains("m20270116_1.tactus is left out: "),
        "{message}"
    );
    let shown = String::from_utf8(output.stdout).unwrap();
    assert_eq!(lines(&shown)[0]["id"], "m20270115_1");
}

#[test]
fn a_log_reports_a_folder_that_cannot_be_read() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "no folder").unwrap();
    let words = ["log", "--session", "m1", "--state", "file"];
    let output = tactus(folder.path(), &words);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(message.contains("file is left out"), "{message}");
    // a folder that does not exist is not reported
    let words = ["log", "--session", "m1", "--state", "none"];
    assert!(tactus(folder.path(), &words).stderr.is_empty());
}

/// Frames at whole and at fractional seconds. Readers infer the format of a time column from its first row.
#[test]
fn times_of_tables_have_six_digits_of_seconds() {
    let folder = tempfile::tempdir().unwrap();
    session_at_thirds_of_a_second(folder.path());
    let session = ["m20270115_1"];
    let export = ["export", session[0], "--format", "csv", "--out", "out.csv"];
    done(folder.path(), &export);
    let maps = ["--preset", "disc-tank", "--noise-v", "2e-6"];
    let replay = ["replay", session[0], "--no-map", "--out", "maps.csv"];
    done(folder.path(), &[&replay[..], &maps].concat());
    let quantities = ["quantities", session[0], "--csv", "--each-frame"];
    let quantities = done(folder.path(), &[&quantities[..], &maps].concat());
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let wanted = [
        "2027-01-15T08:00:01.000000Z",
        "2027-01-15T08:00:02.333333Z",
        "2027-01-15T08:00:03.666666Z",
    ];
    for (table, column) in [
        (read("out.csv"), 1),
        (read("maps.frames.csv"), 2),
        (quantities, 1),
    ] {
        let times = table
            .lines()
            .skip(1)
            .map(|line| line.split(',').nth(column));
        let mut times: Vec<&str> = times.map(|time| time.unwrap()).collect();
        times.dedup();
        assert_eq!(times, wanted, "{table}");
    }
}

#[test]
fn what_is_wrong_is_named_with_its_exit_code() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    session(path);
    let no_daemon = format!("unix:{}/peer", path.display());
    let message = refused(path, &["--bus", &no_daemon, "status"], 3);
    assert!(
        message.contains("tactusd --config") && message.contains("peer"),
        "{message}"
    );
    assert!(refused(path, &["--bus", "tcp:x", "status"], 2).contains("unix:PATH"));
    assert!(refused(path, &["frobnicate"], 2).contains("frobnicate"));
    assert!(refused(path, &["start", "--every", "10"], 2).contains("time unit needed"));
    let message = refused(
        path,
        &["export", "zzz", "--format", "csv", "--out", "x.csv"],
        3,
    );
    assert!(
        message.contains("'zzz'") && message.contains("--state"),
        "{message}"
    );
    let export = [
        "export",
        "m20270115_1",
        "--format",
        "png",
        "--out",
        "x.png",
        "--preset",
        "disc-tank",
    ];
    let message = refused(path, &[&export[..], &["--frame", "9"]].concat(), 2);
    assert!(
        message.contains("m20270115_1 has no frame 9; its frames have the numbers 1 to 3"),
        "{message}"
    );
    assert!(
        refused(path, &[&export[..], &["--electrodes", "8"]].concat(), 78).contains("8 electrodes")
    );
    let message = refused(path, &["replay", "m20270115_1", "--model", "no.model"], 1);
    assert!(message.contains("no.model"), "{message}");
    std::fs::write(path.join("no.model"), "not a model").unwrap();
    let message = refused(path, &["replay", "m20270115_1", "--model", "no.model"], 1);
    assert!(message.contains("no.model"), "{message}");
    let message = refused(
        path,
        &["replay", "m20270115_1", "--preset", "disc-tank", "--negate"],
        78,
    );
    assert!(message.contains("--negate"), "{message}");
}

#[test]
fn a_wrong_number_of_columns_names_the_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    session(path);
    done(
        path,
        &[
            "export",
            "m20270115_1",
            "--format",
            "csv",
            "--out",
            "out.csv",
        ],
    );
    let frames = path.join("out.case/frames.csv");
    let mut text = std::fs::read_to_string(&frames).unwrap();
    let last = text.trim_end().rfind(',').unwrap();
    text.truncate(last);
    std::fs::write(&frames, text + "\n").unwrap();
    let message = refused(
        path,
        &[
            "replay",
            "out.case",
            "--frames",
            "frames.csv",
            "--baseline",
            "first:1",
            "--preset",
            "disc-tank",
        ],
        1,
    );
    assert!(
        message.contains("frames.csv") && message.contains('4'),
        "{message}"
    );
    std::fs::remove_file(&frames).unwrap();
    let message = refused(path, &["replay", "out.case", "--preset", "disc-tank"], 2);
    assert!(message.contains("--frames FILE"), "{message}");
}

#[test]
fn completions_know_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = done(folder.path(), &["completions", shell]);
        for command in ["status", "baseline", "watch", "export", "replay"] {
            assert!(script.contains(command), "{shell}: {command}");
        }
    }
}

/// The completions of a shell for these words, the last of which is incomplete.
fn completed(folder: &Path, shell: &str, words: &[&str]) -> Option<Vec<String>> {
    let script = folder.join(format!("tactus.{shell}"));
    std::fs::write(&script, done(folder, &["completions", shell])).unwrap();
    let script = script.display();
    let asked = match shell {
        "bash" => {
            let words: Vec<String> = words.iter().map(|word| format!("'{word}'")).collect();
            let (count, last) = (words.len() - 1, &words[words.len() - 1]);
            let before = &words[count - 1];
            let words = words.join(" ");
            format!(
                "source {script}; COMP_WORDS=({words}); COMP_CWORD={count}; \
                 _tactus_and_ids tactus {last} {before}; printf '%s\\n' \"${{COMPREPLY[@]}}\""
            )
        }
        _ => format!("source {script}; complete -C '{}'", words.join(" ")),
    };
    let programs = Path::new(env!("CARGO_BIN_EXE_tactus")).parent().unwrap();
    let path = format!("{}:{}", programs.display(), std::env::var("PATH").unwrap());
    let output = std::process::Command::new(shell)
        .args(["-c", &asked])
        .env("PATH", path)
        .env("TACTUS_STATE", folder)
        .env("TACTUS_BUS", format!("unix:{}/peer", folder.display()))
        .env("HOME", folder)
        .output()
        .ok()?;
    let out = String::from_utf8(output.stdout).unwrap();
    Some(out.lines().map(str::to_owned).collect())
}

#[test]
fn session_ids_are_completed_where_one_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    session(path);
    for shell in ["bash", "fish"] {
        let Some(after) = completed(path, shell, &["tactus", "events", ""]) else {
            needs::lacking("SHELLS", &format!("{shell} is not installed"));
            continue;
        };
        for id in ["m20270115_1", "last"] {
            assert!(after.iter().any(|word| word == id), "{shell}: {after:?}");
        }
        for words in [
            &["tactus", "sessions", "show", "m2"][..],
            &["tactus", "log", "--session", "m2"],
        ] {
            let after = completed(path, shell, words).unwrap();
            assert_eq!(after, ["m20270115_1"], "{shell}: {words:?}");
        }
        for words in [&["tactus", "doctor", "m2"][..], &["tactus", "log", "m2"]] {
            let after = completed(path, shell, words).unwrap();
            assert!(
                !after.concat().contains("m20270115_1"),
                "{shell}: {after:?}"
            );
        }
    }
}

#[test]
fn every_place_looked_in_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let nobody = format!("unix:{}/peer", folder.path().display());
    let alone = |words: &[&str]| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_tactus"))
            .args(["--bus", &nobody])
            .args(words)
            .current_dir(folder.path())
            .env_remove("TACTUS_STATE")
            .env("XDG_STATE_HOME", folder.path().join("xdg"))
            .env("HOME", folder.path().join("home"))
            .output()
            .unwrap();
        (
            output.status.code(),
            String::from_utf8_lossy(&output.stderr).into_owned()
                + &String::from_utf8_lossy(&output.stdout),
        )
    };
    let (code, message) = alone(&["replay", "zzz"]);
    assert_eq!(code, Some(3), "{message}");
    for place in ["xdg/tactus", "home/.local/state/tactus", "/var/lib/tactus"] {
        assert!(message.contains(place), "{message}");
    }
    // a session in any of the directories is found
    let there = folder.path().join("home/.local/state/tactus");
    std::fs::create_dir_all(&there).unwrap();
    session(&there);
    let (code, message) = alone(&["sessions"]);
    assert_eq!(code, Some(0), "{message}");
    assert!(message.contains("m20270115_1"), "{message}");
    let (code, message) = alone(&["export", "m2027", "--format", "csv", "--out", "o.csv"]);
    assert_eq!(code, Some(0), "{message}");
}

#[test]
fn with_json_errors_are_objects() {
    let folder = tempfile::tempdir().unwrap();
    for (words, code, kind, says) in [
        (&["events", "nosuch", "--json"][..], 3, "missing", "nosuch"),
        (&["frobnicate", "--json"][..], 2, "usage", "frobnicate"),
        (
            &["start", "--count", "0", "--json"][..],
            2,
            "usage",
            "--count",
        ),
    ] {
        let message = refused(folder.path(), words, code);
        let error = lines(&message).pop().unwrap();
        assert_eq!(error["event"], "error", "{message}");
        assert_eq!(error["kind"], kind, "{message}");
        assert_eq!(error["code"], code, "{message}");
        assert!(error["text"].as_str().unwrap().contains(says), "{message}");
    }
    let message = refused(folder.path(), &["events", "nosuch"], 3);
    assert!(
        message.starts_with("tactus: no session 'nosuch'"),
        "{message}"
    );
}

#[test]
fn times_for_a_person_are_local_with_their_zone() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    for (zone, started) in [
        ("<+0530>-5:30", "2027-01-15 13:30:00 +05:30"),
        ("<-0800>8", "2027-01-15 00:00:00 -08:00"),
        ("UTC0", "2027-01-15 08:00:00 +00:00"),
    ] {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_tactus"))
            .args(["sessions"])
            .env("TACTUS_STATE", folder.path())
            .env("TZ", zone)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(text.contains(started), "{zone}: {text}");
    }
    let json = lines(&done(folder.path(), &["sessions", "--json"]));
    assert_eq!(json[0]["started"], "2027-01-15T08:00:00Z");
}

#[test]
fn baselines_are_listed_without_a_daemon() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    assert_eq!(done(folder.path(), &["baseline", "list", "--json"]), "");
    baseline_session(folder.path());
    let text = done(folder.path(), &["baseline", "list"]);
    assert!(
        text.contains("b20270115_1") && !text.contains("m20270115_1"),
        "{text}"
    );
    assert!(!text.contains("in use"), "{text}");
    let listed = lines(&done(folder.path(), &["baseline", "list", "--json"]));
    assert_eq!(listed.len(), 1);
    assert_eq!(listed[0]["kind"], "baseline");
    assert_eq!(listed[0]["in_use"], serde_json::Value::Null);
}
