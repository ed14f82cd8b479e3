//! Self-test over TCP and serial lines: a sound rig passes, each fault is named, and the source is off afterwards.

use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};

use serde_json::Value;
use tactus_tests::Stage;

use crate::test_rig::{self, Needs, ask, number};

/// A served rig; killed when dropped.
struct Served {
    child: Child,
    ready: Value,
}

impl Served {
    fn start(stage: &Stage, profile: &str, more: &[&str]) -> Self {
        let path = stage.path().join("served.toml");
        std::fs::write(&path, profile).expect("the story's folder can be written");
        let mut child = stage
            .command("tactus-sim")
            .args([
                "serve",
                "--port-6221",
                "0",
                "--port-34980a",
                "0",
                "--instant",
                "--profile",
            ])
            .arg(path)
            .args(more)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the bench starts");
        let mut line = String::new();
        let out = child.stdout.take().expect("it was asked for");
        BufReader::new(out)
            .read_line(&mut line)
            .expect("it says when it is ready");
        let ready = serde_json::from_str(&line).unwrap_or_else(|fault| panic!("{line}: {fault}"));
        Self { child, ready }
    }

    fn address(&self, of: &str) -> &str {
        self.ready[of]
            .as_str()
            .unwrap_or_else(|| panic!("no {of} in {}", self.ready))
    }

    fn fault(&self, stage: &Stage, words: &str) {
        let mut args = vec!["fault", "--control", self.address("control")];
        args.extend(words.split(' '));
        let reported = stage
            .run("tactus-sim", &args)
            .and_then(|reported| reported.succeeded());
        reported.unwrap_or_else(|fault| panic!("{fault}"));
    }

    /// The actual state of the instruments.
    fn status(&self, stage: &Stage) -> Value {
        let args = ["status", "--json", "--control", self.address("control")];
        let reported = stage
            .run("tactus-sim", &args)
            .and_then(|reported| reported.succeeded());
        reported
            .unwrap_or_else(|fault| panic!("{fault}"))
            .json()
            .remove(0)
    }

    fn assert_off(&self, stage: &Stage) {
        let status = self.status(stage);
        assert_eq!(status["source"]["output"], false, "{status}");
        assert_eq!(number(&status["source"], "flowing_a"), 0.0, "{status}");
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The simulated rig's configuration with real instruments at these addresses.
fn configuration(
    simulated: &str,
    kind: &str,
    wiring: &str,
    addresses: &[(&str, String)],
) -> String {
    let mut config: toml::Table = simulated
        .parse()
        .expect("the stories' configuration is TOML");
    let rig: toml::Table = format!("[rig]\nkind = \"{kind}\"\n")
        .parse()
        .expect("written here");
    config.extend(rig);
    let wiring: toml::Table = format!("[wiring]\nkind = \"{wiring}\"\n")
        .parse()
        .expect("written here");
    config.extend(wiring);
    for (role, address) in addresses {
        let section: toml::Table = format!("[{role}]\naddress = \"{address}\"\n")
            .parse()
            .expect("written here");
        config.extend(section);
    }
    config.to_string()
}

/// The last line of `instruments test --json`, and the exit code.
fn tested(stage: &Stage) -> (Value, Option<i32>) {
    let spoken = stage
        .tactus(&["instruments", "test", "--json"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    let report = spoken
        .json()
        .pop()
        .unwrap_or_else(|| panic!("no report: {}", spoken.stderr));
    (report, spoken.code)
}

#[test]
fn self_test_over_tcp_passes_and_names_each_fault() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let served = Served::start(&stage, "[slots]\n1 = \"34924A\"\n", &[]);
    let tcp = |of: &str| format!("tcp:{}", served.address(of));
    let addresses = [("source", tcp("6221")), ("switch", tcp("34980a"))];
    let config = configuration(
        tactus_tests::SIMULATED,
        "instruments",
        "pairs-34924a",
        &addresses,
    );
    stage
        .configure(&config)
        .expect("the configuration can be written");
    let daemon = test_rig::start(&stage);

    let (report, code) = tested(&stage);
    assert_eq!(
        (code, &report["passed"]),
        (Some(0), &Value::Bool(true)),
        "{report}"
    );
    let (sheet, pauw) = (number(&report, "sheet_ohm"), number(&report, "pauw_ohm"));
    println!(
        "a sheet of 1000 ohm: {sheet:.2} by the fit, {pauw:.2} by van der Pauw ({:.2} raw)",
        number(&report, "pauw_raw_ohm")
    );
    for ohms in [sheet, pauw] {
        assert!((ohms / 1000.0 - 1.0).abs() < 0.015, "{report}");
    }
    assert!(number(&report, "reciprocity") < 1e-3, "{report}");
    served.assert_off(&stage);

    for (fault, finding) in [
        (
            "stuck-open 1042",
            "relay 1042 stays open: it joins electrodes 7 and 8 to the source",
        ),
        (
            "stuck-closed 1042",
            "relay 1042 stays closed: it joins electrodes 7 and 8 to the source",
        ),
        (
            "stuck-open 1020",
            "relay 1020 stays open: it joins electrodes 20 and 21 to the voltmeter",
        ),
        (
            "stuck-closed 1020",
            "relay 1020 stays closed: it joins electrodes 20 and 21 to the voltmeter",
        ),
    ] {
        served.fault(&stage, fault);
        let (report, code) = tested(&stage);
        assert_eq!(code, Some(5), "{fault}: {report}");
        assert_eq!(report["findings"], serde_json::json!([finding]), "{fault}");
        served.assert_off(&stage);
        served.fault(&stage, "none");
    }
    // the text output names the same fault
    served.fault(&stage, "stuck-open 1042");
    let spoken = stage
        .tactus(&["instruments", "test"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert!(
        spoken.stdout.contains("FOUND  relay 1042 stays open"),
        "{}",
        spoken.stdout
    );
    served.fault(&stage, "none");

    // an instrument lost in the middle is a fault, not a finding; the daemon reconnects it
    served.fault(&stage, "wire 34980a cut");
    let spoken = stage
        .tactus(&["instruments", "test"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert_eq!(spoken.code, Some(5), "{}", spoken.stderr);
    assert!(spoken.stderr.contains("34980A"), "{}", spoken.stderr);
    served.assert_off(&stage);
    served.fault(&stage, "wire 34980a sound");
    let (report, code) = tested(&stage);
    assert_eq!(code, Some(0), "{report}");
    let worn = ask(&stage, &["instruments", "relays"]);
    assert_eq!(worn.len(), 52);
    assert!(
        worn.iter().all(|relay| number(relay, "cycles") > 0.0),
        "{worn:?}"
    );
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn source_on_rs232_and_board_on_usb_form_a_rig() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let served = Served::start(&stage, "[board]\n", &["--serial-6221"]);
    let addresses = [
        (
            "source",
            format!("serial:{}@9600", served.address("6221-serial")),
        ),
        ("switch", format!("serial:{}", served.address("serial"))),
        ("voltmeter", format!("tcp:{}", served.address("34980a"))),
    ];
    let config = configuration(
        tactus_tests::SIMULATED,
        "instruments",
        "gpio-board",
        &addresses,
    );
    // the board's supply of 5 V allows at most 4.5 V
    let config = config.replace("compliance_v = 10.0", "compliance_v = 4.0");
    stage
        .configure(&config)
        .expect("the configuration can be written");
    let daemon = test_rig::start(&stage);
    let recorded = test_rig::baseline(&stage, 1);
    let ended = recorded.last().expect("it says how it ended");
    assert_eq!(number(ended, "frames"), 1.0, "{recorded:?}");
    let shown = ask(&stage, &["baseline", "show"]).remove(0);
    assert_eq!(
        (number(&shown, "readings"), number(&shown, "missing")),
        (598.0, 0.0)
    );
    assert_eq!(
        shown["simulated"], false,
        "the daemon knows of no simulation"
    );
    let spoken = stage
        .tactus(&["instruments", "relays"])
        .unwrap_or_else(|fault| panic!("{fault}"));
    assert!(
        spoken.stderr.contains("chips do not wear"),
        "{}",
        spoken.stderr
    );
    served.assert_off(&stage);
    daemon.stop().unwrap_or_else(|fault| panic!("{fault}"));
}

#[test]
fn simulated_source_beside_a_real_switch_is_reported() {
    let Some(stage) = test_rig::set(Needs::SIMULATED, test_rig::NOISY) else {
        return;
    };
    let served = Served::start(&stage, "[slots]\n1 = \"34924A\"\n", &[]);
    let addresses = [
        ("source", "simulated".to_owned()),
        ("switch", format!("tcp:{}", served.address("34980a"))),
    ];
    let config = configuration(tactus_tests::SIMULATED, "mixed", "pairs-34924a", &addresses);
    stage
        .configure(&config)
        .expect("the configuration can be written");
    let _guard = test_rig::start(&stage);
    let instruments = ask(&stage, &["instruments"]);
    let simulated = |role: &str| {
        let found = instruments.iter().find(|found| found["role"] == role);
        found.unwrap_or_else(|| panic!("{instruments:?}"))["simulated"].clone()
    };
    assert_eq!(
        (simulated("source"), simulated("switch+voltmeter")),
        (true.into(), false.into())
    );
    assert_eq!(ask(&stage, &["status"])[0]["simulated"], true);
    // its current does not reach the sheet: the self-test reports that, and names no relay
    let (report, code) = tested(&stage);
    assert_eq!(code, Some(5));
    let found = report["findings"].to_string();
    assert!(found.contains("no pair carries current"), "{found}");
}
