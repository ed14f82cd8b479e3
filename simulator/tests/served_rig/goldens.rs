//! Goldens are reproduced, transcripts are replayed, and a difference is reported with its position.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Output};

use crate::program::Served;
use simulator::{Golden, GoldenError};

fn folder() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/goldens"))
}

fn program(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tactus-sim"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn every_golden_of_the_folder_is_held() {
    let mut held = 0;
    for file in std::fs::read_dir(folder()).unwrap() {
        let path = file.unwrap().path();
        let golden = Golden::read(&path).unwrap_or_else(|fault| panic!("{fault}"));
        assert!(!golden.lines.is_empty(), "{} says nothing", path.display());
        let played = golden.play(&path.display().to_string());
        played.unwrap_or_else(|fault| panic!("{fault}"));
        // The written text parses to the same golden, except for line numbers.
        let text = golden.to_string();
        assert_eq!(Golden::parse("again", &text).unwrap().to_string(), text);
        held += 1;
    }
    assert!(held >= 5, "{held}");
}

#[test]
fn a_deviation_from_a_golden_names_its_line() {
    let parse = |text: &str| Golden::parse("a.golden", text);
    let golden = parse("instrument gpio\ncites nothing\n> OFF\n< ON\n").unwrap();
    let fault = golden.play("a.golden").unwrap_err();
    assert_eq!(
        fault.to_string(),
        "a.golden:4: 'ON' is expected as the reply to 'OFF', the simulator replies 'OFF,OFF,OFF,OFF'"
    );
    let unheld = [
        "> *RST\n< 1\n",
        "> *IDN?\n.\n",
        "> *IDN?\n~ KEITHLEY INSTRUMENTS INC.,MODEL 62210,1234567,D04\n",
    ];
    for lines in unheld {
        let golden = parse(&format!("instrument 6221\ncites x\n{lines}")).unwrap();
        assert!(
            matches!(golden.play("x"), Err(GoldenError::Differs { line: 4, .. })),
            "{lines}"
        );
    }
    // An overload does not match a reading, whatever its digits.
    let overload = "slot 1 34924A\nvolts 1e9\n> MEAS:VOLT:DC? 1,(@1001)\n";
    for (expected, holds) in [("+9.90000000E+37", true), ("+1.00000000E+00", false)] {
        let text = format!("instrument 34980a\ncites x\n{overload}~ {expected}\n");
        assert_eq!(parse(&text).unwrap().play("x").is_ok(), holds, "{expected}");
    }
    for (wrong, reported) in [
        ("cites x\n> A\n", "no line 'instrument ...'"),
        ("instrument 6221\n> A\n", "no line 'cites ...'"),
        ("instrument 2400\n", "a.golden:1: '2400' is none of"),
        (
            "instrument 6221\ncites x\n< A\n",
            "a.golden:3: a reply must follow",
        ),
        (
            "instrument 6221\ncites x\n> A\nslot 1 34924A\n",
            "a.golden:4: 'slot' is none of",
        ),
        (
            "instrument 6221\ncites x\n@ -1\n",
            "a.golden:3: '-1' is not a time",
        ),
        ("slot 9 34924A\n", "a.golden:1: there is no slot"),
        (
            "slot 1 34924A\nslot 1 34932A\n",
            "a.golden:2: slot 1 is given twice; delete one line",
        ),
        ("ohms -3\n", "a.golden:1: ohms cannot be -3"),
    ] {
        let fault = parse(wrong).unwrap_err().to_string();
        assert!(fault.contains(reported), "{wrong}: {fault}");
    }
}

/// Talks to a served rig that records the conversation.
fn recorded(transcript: &Path) {
    let arguments = [
        "--profile",
        "showcase",
        "--record",
        transcript.to_str().unwrap(),
    ];
    let served = Served::start(&arguments);
    for (key, lines) in [
        (
            "34980a",
            &[
                "*IDN?",
                "SYST:CTYP? 1",
                "SYST:CTYP? 2",
                "ROUT:CLOS (@2001)",
                "MEAS:VOLT:DC? 1,(@2002)",
            ][..],
        ),
        (
            "6221",
            &["*IDN?", "SOUR:CURR 1e-3;CURR?", "BLAH?", "SYST:ERR?"][..],
        ),
    ] {
        let mut stream = TcpStream::connect(served.address(key)).unwrap();
        let mut reader = BufReader::new(stream.try_clone().unwrap());
        for line in lines {
            stream.write_all(format!("{line}\n").as_bytes()).unwrap();
            if line.contains('?') && *line != "BLAH?" {
                reader.read_line(&mut String::new()).unwrap();
            }
        }
    }
    assert_eq!(served.terminate(), Some(0));
}

#[test]
fn what_was_recorded_is_replayed_and_made_a_golden() {
    let folder = tempfile::tempdir().unwrap();
    let transcript = folder.path().join("talk.jsonl");
    let file = transcript.to_str().unwrap();
    recorded(&transcript);
    // A recording is not overwritten.
    let again = program(&["serve", "--record", file]);
    assert_eq!(again.status.code(), Some(78));
    let reported = String::from_utf8_lossy(&again.stderr);
    assert!(reported.contains("exists already: name another file"));

    let together = ["replay", file, "--profile", "showcase", "--exact"];
    for arguments in [&["replay", file][..], &together] {
        let played = program(arguments);
        let reported = String::from_utf8_lossy(&played.stderr).into_owned();
        assert!(played.status.success(), "{reported}");
        let message = String::from_utf8_lossy(&played.stdout).into_owned();
        assert!(message.starts_with("9 messages, 7 replies: "), "{message}");
    }

    let golden = folder.path().join("unit.golden");
    let out = golden.to_str().unwrap();
    let make = [
        "golden",
        file,
        "--instrument",
        "34980a",
        "--cites",
        "keysight-34980a, section 1",
        "-o",
        out,
    ];
    let made = program(&make);
    assert!(made.status.success() && made.stderr.is_empty(), "{made:?}");
    assert_eq!(
        program(&make).status.code(),
        Some(78),
        "it is not written over"
    );
    let text = std::fs::read_to_string(&golden).unwrap();
    for line in [
        "instrument 34980a",
        "cites keysight-34980a, section 1",
        "cites the transcript talk.jsonl",
        "slot 1 34934A,8x64",
        "slot 2 34921A",
        "> *IDN?",
    ] {
        assert!(
            text.lines().any(|candidate| candidate == line),
            "{line} in\n{text}"
        );
    }
    assert_eq!(
        text.matches("\n~ ").count(),
        4,
        "identity, modules and reading in their shape:\n{text}"
    );
    Golden::read(&golden).unwrap().play(out).unwrap();

    // A changed byte is found, with its line.
    let changed = std::fs::read_to_string(&transcript).unwrap();
    let changed = changed.replace(
        "\"received\":\"1.000000E-03\"",
        "\"received\":\"1.000001E-03\"",
    );
    let other = folder.path().join("other.jsonl");
    std::fs::write(&other, changed).unwrap();
    let played = program(&["replay", other.to_str().unwrap()]);
    assert_eq!(played.status.code(), Some(1));
    let reported = String::from_utf8_lossy(&played.stderr).into_owned();
    assert!(
        reported.contains("other.jsonl:13: the 6221 replied '1.000001E-03' to 'SOUR:CURR 1e-3;CURR?', the simulator replies '1.000000E-03'"),
        "{reported}"
    );
}

#[test]
fn unplayable_transcripts_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("talk.jsonl");
    let sent = r#"{"t_s":0,"instrument":"6221","sent":"OUTP ON"}"#;
    for (text, code, reported) in [
        ("{}\n".to_owned(), 78, "talk.jsonl:1: missing field"),
        (
            sent.replace("6221", "2400 at home"),
            1,
            "talk.jsonl:1: there is no simulated '2400 at home'",
        ),
        (
            sent.replace("sent", "received"),
            1,
            "talk.jsonl:1: the reply 'OUTP ON' has no message before it",
        ),
        (
            sent.replace("OUTP ON", "OUTP?"),
            1,
            "talk.jsonl:1: the 6221 replied nothing to 'OUTP?', the simulator replies '0'",
        ),
        (
            format!("{sent}\n{}", sent.replace("sent", "received")),
            1,
            "talk.jsonl:2: the 6221 replied 'OUTP ON' to 'OUTP ON', the simulator replies nothing",
        ),
    ] {
        std::fs::write(&file, text).unwrap();
        let played = program(&["replay", file.to_str().unwrap()]);
        let message = String::from_utf8_lossy(&played.stderr).into_owned();
        assert_eq!(played.status.code(), Some(code), "{message}");
        assert!(message.contains(reported), "{reported}: {message}");
    }
    std::fs::write(&file, sent).unwrap();
    let made = program(&["golden", file.to_str().unwrap(), "--instrument", "gpio"]);
    assert_eq!(made.status.code(), Some(78));
    assert!(program(&["replay", "/nowhere/at.all"]).status.code() == Some(78));
}
