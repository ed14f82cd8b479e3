//! Errors in a configuration are reported with their positions, and nothing starts.

use std::path::Path;
use std::process::Command;

use crate::stage::{SMALL, Stage};

/// Exit code and standard error of `tactusd --check`.
fn check(config: &str) -> (Option<i32>, String) {
    let output = Stage::new(config).run(&["--check"]);
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

#[test]
fn the_shipped_example_is_valid_and_has_every_section() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config.toml");
    let text = std::fs::read_to_string(file).unwrap();
    let (code, message) = check(&text);
    assert_eq!((code, message.as_str()), (Some(0), ""));
    // the file with every commented-out key activated is parsed too, although it has too many errors to run
    for section in [
        "rig",
        "source",
        "switch",
        "voltmeter",
        "recording",
        "wiring",
        "survey",
        "geometry",
        "model",
        "record",
        "bus",
        "schedule",
    ] {
        assert!(
            text.contains(&format!("[{section}]")),
            "[{section}] is not shown"
        );
    }
}

#[test]
fn each_bad_input_is_named_at_its_place() {
    let with = |from: &str, to: &str| {
        assert!(SMALL.contains(from), "{from}");
        SMALL.replace(from, to)
    };
    let more = |text: &str| format!("{SMALL}{text}");
    let cases = [
        (
            with("kind =", "kinds ="),
            "config.toml:3:1: unknown key 'kinds'; did you mean 'kind'?",
        ),
        (
            with("[survey]\n", "[survey]\nsettle_us = 10\n"),
            ":11:1: unknown key 'settle_us'; did you mean 'settle_ms'?",
        ),
        (
            with("electrodes = 16\n[record]", "electrodes = 20\n[record]"),
            ":11:14: survey.electrodes: the survey has 20 electrodes, the geometry (preset disc-tank) has 16",
        ),
        (
            more("[wiring]\nelectrodes = 26\n"),
            ":20:14: wiring.electrodes: wiring '34924A pairs in slot 1' has 26 electrodes, the survey has 16",
        ),
        (
            more("[wiring]\nslot = 9\n"),
            "wiring.slot: 9 is not from 1 to 8",
        ),
        (
            more("[model]\nfile = \"nowhere.safetensors\"\n"),
            "nowhere.safetensors",
        ),
        (
            more("[model]\nfile = \"nowhere.safetensors\"\nloss_only = true\n"),
            "nowhere.safetensors cannot be accessed",
        ),
        (
            more(
                "[model]\nfile = \"m.safetensors\"\nprior = \"noser\"\nlambda = 1.0\nloss_only = true\n",
            ),
            ":21:9: model.prior: a model file has its own settings; delete prior, lambda, or delete file",
        ),
        (
            more("[model]\nmethod = \"tv-paper\"\nnoise_uv = 1.0\n"),
            "model.noise_uv: noise_uv belongs to method = \"one-step\" or \"best\" or \"tv\"",
        ),
        (
            more("[model]\nmethod = \"rbf\"\n"),
            "method rbf needs a model file: train one with tactus-lab train rbf",
        ),
        (
            more("[model]\ngap = 1e-3\n"),
            "model.gap: gap belongs to method = \"tv\"",
        ),
        (
            more("[model]\nmethod = \"one-step\"\nfile = \"m.safetensors\"\n"),
            "delete method, or delete file",
        ),
        (
            more("[model]\nnoise_uv = -2.0\n"),
            "model.noise_uv: -2 is not from 1e-6 to 1000000000",
        ),
        (
            more("[model]\nchoose = \"noise\"\nlambda = 1.0\n"),
            "one of lambda, noise_figure and choose",
        ),
        (
            more("[model]\nchoose = \"evidence\"\nmap_error = 1e-3\n"),
            "map_error needs one lambda for all frames",
        ),
        (
            more("[model]\nmethod = \"tv\"\nmap_error = 1e-3\n"),
            "model.map_error: map_error belongs to method = \"one-step\"",
        ),
        (
            more("[model]\nprior = \"gaussian\"\nloss_only = true\n"),
            "loss_only with the gaussian prior takes longer than a frame",
        ),
        (
            more("[model]\nmethod = \"best\"\nprior = \"gaussian\"\nloss_only = true\n"),
            "loss_only with the gaussian prior takes longer than a frame",
        ),
        (
            more("[model]\nprior = \"tikhonov\"\nexponent = 0.3\n"),
            "model.exponent: exponent belongs to prior = \"noser\"; delete it, or choose that prior",
        ),
        (
            more("[model]\nlength_mm = 15.0\n"),
            "model.length_mm: length_mm belongs to prior = \"gaussian\"",
        ),
        (
            more("[model]\nmap_error = 2.0\n"),
            "model.map_error: 2 is not above 0 and below 1",
        ),
        (with("[record]", "current_ua = 200000.0\n[record]"), "over"),
        (
            with("[record]", "nplc = 3.0\n[record]"),
            ":12:8: survey.nplc: 3 is none of",
        ),
        (
            with("PROFILE", "nowhere.toml"),
            ":4:11: rig.profile: profile",
        ),
        (
            with("PROFILE", "matrix-34932a"),
            ":4:11: rig.profile: profile matrix-34932a does not fit wiring pairs-34924a in slot 1: the 34932A in slot 1",
        ),
        (
            with("PROFILE", "gpio-board"),
            "slot 1 is empty, and relay 1036 joins electrodes 1 and 2 to the source; use profile = \"pairs-34924a\"",
        ),
        (
            with("PROFILE", "gpio-board"),
            "for its board set wiring.kind = \"gpio-board\"",
        ),
        (more("[wiring]\nslot = 2\n"), ":4:11: rig.profile: profile"),
        (
            more("[wiring]\nkind = \"matrix-34934a\"\n"),
            "the 34924A in slot 1 has no channel 101: relay 1101 joins electrode 1 to the source",
        ),
        (
            more("[wiring]\nkind = \"pairs-34922a\"\n"),
            "slot 1 holds a 34924A, the wiring is made for a 34922A",
        ),
        (
            more("[wiring]\nkind = \"fast-34925a\"\ninject_slot = 1\n"),
            "slot 1 cannot hold both the measuring and the injecting module",
        ),
        (
            more("[wiring]\ninject_slot = 2\n"),
            "only wiring.kind = \"fast-34925a\" has one",
        ),
        (
            more("[wiring]\nkind = \"file\"\n"),
            "kind = \"file\" needs file = \"PATH\"",
        ),
        (
            more("[wiring]\nkind = \"file\"\nfile = \"nowhere.toml\"\n"),
            "nowhere.toml: cannot be read",
        ),
        (
            more("[wiring]\nkind = \"gpio-board\"\n"),
            "wiring gpio-board needs the multiplexer board",
        ),
        (
            with("profile = \"PROFILE\"\n", "") + "[wiring]\nslot = 3\n",
            ":18:2: wiring: profile pairs-34924a does not fit wiring pairs-34924a in slot 3: slot 3 is empty",
        ),
        (
            with("scene = \"scene.toml\"", "scene = \"busy\""),
            "scene busy is neither a shipped scene nor a file",
        ),
        (with("\"simulated\"", "\"instruments\""), ":3:8: the rig"),
        (
            with("\"simulated\"", "\"recording\""),
            "needs a section [recording]",
        ),
        (
            more("[source]\naddress = \"tcp:10.0.0.1:1394\"\n"),
            "source: a simulated rig has no addresses",
        ),
        (
            with("peer_path = \"run/peer\"", "peer = false"),
            "no client could reach the daemon",
        ),
    ];
    for (config, says) in cases {
        let (code, message) = check(&config);
        assert_eq!(code, Some(78), "{config}\n{message}");
        if says == ":3:8: the rig" {
            // two missing instruments (the switch is also the voltmeter) and two keys of a simulated rig: all are
            // reported together
            assert_eq!(message.lines().count(), 4, "{message}");
            assert!(
                message.contains(":1:1: source: the rig has no [source]"),
                "{message}"
            );
            assert_eq!(message.matches("delete this key").count(), 2, "{message}");
            continue;
        }
        assert!(message.contains(says), "wanted {says:?} in\n{message}");
    }
}

#[test]
fn a_simulated_instrument_does_not_stand_in_for_a_real_one() {
    let real = "[rig]\nkind = \"instruments\"\n[source]\naddress = \"simulated\"\n[switch]\naddress = \"tcp:h:1\"\n\
                [voltmeter]\naddress = \"tcp:h:2\"\n";
    let (code, message) = check(real);
    assert_eq!(code, Some(78));
    assert!(message.contains("set rig.kind = \"mixed\""), "{message}");
    let alone = real.replace("\"simulated\"", "\"tcp:h:3\"");
    let alone = alone.split("[voltmeter]").next().unwrap();
    assert_eq!(check(alone).0, Some(0), "the voltmeter is the switch");
    let board = format!("{alone}[wiring]\nkind = \"gpio-board\"\n");
    let (_, message) = check(&board);
    assert!(message.contains("the rig has no [voltmeter]"), "{message}");
    let (_, message) = check(&real.replace("\"simulated\"", "\"tcp:h:3\""));
    assert!(message.contains("give both the same address"), "{message}");
}

#[test]
fn a_missing_instrument_is_an_error_and_nothing_else() {
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let config = format!(
        "[rig]\nkind = \"instruments\"\n[record]\ndirectory = \"state\"\n[bus]\npeer_path = \"run/peer\"\n[source]\naddress = \"tcp:{port}\"\n\
         [switch]\naddress = \"tcp:{port}\"\n[voltmeter]\naddress = \"tcp:{port}\"\n"
    );
    let stage = Stage::new(&config);
    for (args, code) in [(&[][..], 1), (&["--safe-off"], 5)] {
        let output = stage.run(args);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{message}");
        assert!(
            message.contains(&format!("source at tcp:{port} cannot be reached")),
            "{message}"
        );
    }
}

#[test]
fn a_record_directory_that_is_a_file_is_an_error() {
    let stage = Stage::new(SMALL);
    std::fs::write(stage.path().join("state"), "").unwrap();
    for args in [&["--check"][..], &[]] {
        let output = stage.run(args);
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(78), "{args:?}: {message}");
        assert!(
            message.contains("config.toml:13:13: record.directory: ")
                && message.contains("is not a folder"),
            "{args:?}: {message}"
        );
    }
    // `--safe-off` needs no record
    assert_eq!(stage.run(&["--safe-off"]).status.code(), Some(0));
}

#[test]
fn the_plan_is_printed_and_nothing_moves() {
    let stage = Stage::new(SMALL);
    let output = stage.run(&["--plan", "--json"]);
    let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(plan["readings"], 208);
    assert_eq!(plan["reading_messages"], 16);
    assert_eq!(
        plan["lines"].as_array().unwrap().len() as u64,
        plan["steps"].as_u64().unwrap()
    );
    let text = String::from_utf8(stage.run(&["--plan"]).stdout).unwrap();
    assert!(
        text.contains("nothing moved") && text.contains("16 injections"),
        "{text}"
    );
    assert!(text.contains("settle 2.0 ms"), "{text}");
    // no number is printed with more digits than are significant
    let mut words = text.split(|letter: char| !letter.is_ascii_digit() && letter != '.');
    assert!(
        !words.any(|word| word
            .split_once('.')
            .is_some_and(|(_, decimals)| decimals.len() > 3)),
        "{text}"
    );
}

#[test]
fn the_effective_configuration_is_a_configuration() {
    let stage = Stage::new(SMALL);
    let printed = String::from_utf8(stage.run(&["--print-config"]).stdout).unwrap();
    assert!(printed.contains("settle_ms = 2.0"), "{printed}");
    let (code, message) = check(&printed);
    assert_eq!(code, Some(0), "{message}");
    let again = Stage::new(&printed).run(&["--print-config"]).stdout;
    assert_eq!(String::from_utf8(again).unwrap(), printed);
}

#[test]
fn paths_are_absolute_wherever_the_daemon_is_started() {
    let stage = Stage::new(SMALL);
    let output = Command::new(env!("CARGO_BIN_EXE_tactusd"))
        .args(["--config", "config.toml", "--print-config"])
        .current_dir(stage.path())
        .output()
        .unwrap();
    let printed = String::from_utf8(output.stdout).unwrap();
    let state = stage.path().join("state");
    assert!(
        printed.contains(&format!("directory = \"{}\"", state.display())),
        "{printed}"
    );
}

#[test]
fn safe_off_verifies_both() {
    let output = Stage::new(SMALL).run(&["--safe-off"]);
    let message = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success());
    assert!(
        message.contains("source off, verified") && message.contains("relays open, verified"),
        "{message}"
    );
}

#[test]
fn usage_errors_have_their_own_exit_code() {
    let output = Command::new(env!("CARGO_BIN_EXE_tactusd"))
        .arg("--chekc")
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
}

/// The last line of standard error with `--json`.
fn error_line(stage: &Stage, args: &[&str], code: i32) -> serde_json::Value {
    let output = stage.run(args);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{args:?}: {message}");
    assert!(output.stdout.is_empty(), "{args:?}");
    let line = message.lines().last().unwrap_or_default();
    serde_json::from_str(line).unwrap_or_else(|_| panic!("{args:?}: {message}"))
}

#[test]
fn with_json_errors_are_objects() {
    let (sound, bad) = (Stage::new(SMALL), Stage::new("[rig]\nkinds = 1\n"));
    for (stage, args, code, kind, says) in [
        (
            &bad,
            &["--plan", "--json"][..],
            78,
            "configuration",
            "config.toml:2:1: unknown key 'kinds'",
        ),
        (
            &sound,
            &["--frobnicate", "--json"][..],
            2,
            "usage",
            "--frobnicate",
        ),
        (
            &sound,
            &["--discover", "nowhere", "--json"][..],
            2,
            "usage",
            "nowhere",
        ),
    ] {
        let error = error_line(stage, args, code);
        assert_eq!(error["event"], "error", "{error}");
        assert_eq!(error["kind"], kind, "{error}");
        assert_eq!(error["code"], code, "{error}");
        assert!(error["text"].as_str().unwrap().contains(says), "{error}");
    }
    // without --json: text, each problem with its position
    let output = bad.run(&["--plan"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        message.contains("config.toml:2:1:") && !message.contains('{'),
        "{message}"
    );
}
