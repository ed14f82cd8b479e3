//! Unmodified third-party clients, in virtual environments of their own.
//!
//! They are fetched and run only on request: pyvisa-py with TACTUS_REQUIRE_PYVISA=1, all clients with
//! TACTUS_REQUIRE_CLIENTS=1; a client that cannot be fetched then fails the test.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::program::Served;

const PYVISA: (&str, &[&str]) = ("pyvisa", &["pyvisa-py==0.8.1", "pyvisa==1.16.2"]);
const ZEROCONF: (&str, &[&str]) = ("zeroconf", &["zeroconf==0.154.0"]);
const PYMEASURE: (&str, &[&str]) = ("pymeasure", &["pymeasure==0.16.0", "pyvisa-py==0.8.1"]);
const INSTRO: (&str, &[&str]) = ("instro", &["instro==1.22.0", "pyvisa-py==0.8.1"]);
const QCODES: (&str, &[&str]) = ("qcodes", &["qcodes==0.58.0", "pyvisa-py==0.8.1"]);

fn run(command: &mut Command) -> Result<Output, String> {
    let ended = command
        .output()
        .map_err(|fault| format!("{command:?} cannot be run: {fault}"))?;
    if ended.status.success() {
        return Ok(ended);
    }
    let reported = String::from_utf8_lossy(&ended.stderr);
    let last: Vec<&str> = reported.lines().rev().take(15).collect();
    let last: Vec<&str> = last.into_iter().rev().collect();
    Err(format!("{command:?} failed:\n{}", last.join("\n")))
}

fn is_requested(client: &str) -> bool {
    let requested = needs::required("CLIENTS") || client == "pyvisa" && needs::required("PYVISA");
    if !requested {
        let why = format!("{client} is fetched and run only with TACTUS_REQUIRE_CLIENTS=1");
        needs::lacking("CLIENTS", &why);
    }
    requested
}

/// The Python of an environment with the packages; a complete environment is reused.
fn python((name, packages): (&str, &[&str])) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("venv-{name}"));
    let python = folder.join("bin/python");
    let complete = folder.join("complete");
    let wanted = packages.join(" ");
    if std::fs::read_to_string(&complete).is_ok_and(|found| found == wanted) {
        return python;
    }
    let fetch = || {
        let venv = ["-m", "venv", "--clear"];
        run(Command::new("python3").args(venv).arg(&folder))?;
        let pip = [
            "-m",
            "pip",
            "install",
            "--quiet",
            "--disable-pip-version-check",
        ];
        run(Command::new(&python).args(pip).args(packages))
    };
    if let Err(reason) = fetch() {
        panic!("{name} is required and cannot be had: {reason}");
    }
    std::fs::write(&complete, wanted).unwrap();
    python
}

/// Runs a script of this folder with a client's packages, if requested.
fn script(client: (&str, &[&str]), script: &str, arguments: &[&str]) {
    // Each environment is made once.
    static ONE_AT_A_TIME: std::sync::Mutex<()> = std::sync::Mutex::new(());
    let python = {
        let _turn = ONE_AT_A_TIME.lock();
        python(client)
    };
    let home = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("home-{}", client.0));
    std::fs::create_dir_all(&home).unwrap();
    let ended = run(Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join(script))
        .args(arguments)
        .current_dir(&home)
        .env("HOME", &home));
    match ended {
        Ok(ended) => print!("{}", String::from_utf8_lossy(&ended.stdout)),
        Err(fault) => panic!("{fault}"),
    }
}

fn socket(served: &Served, instrument: &str) -> String {
    let (host, port) = served.address(instrument).rsplit_once(':').unwrap();
    format!("TCPIP::{host}::{port}::SOCKET")
}

#[test]
fn examples_without_arguments_print_their_usage() {
    for example in ["pymeasure_resistor", "pyvisa_speed", "qcodes_matrix"] {
        let file = format!("examples/{example}.py");
        let ended = Command::new("python3")
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join(file))
            .output();
        let Ok(ended) = ended else {
            return needs::lacking("PYTHON", "there is no python3");
        };
        let reported = String::from_utf8_lossy(&ended.stderr).into_owned();
        assert_eq!(ended.status.code(), Some(1), "{reported}");
        assert!(
            reported.contains(&format!("python {example}.py ")),
            "{reported}"
        );
        assert!(!reported.contains("Traceback"), "{reported}");
    }
}

#[test]
fn pyvisa_finds_ohms_law() {
    if !is_requested("pyvisa") {
        return;
    }
    let served = Served::start_in_time(&[]);
    let addresses = [served.address("6221"), served.address("34980a")];
    script(PYVISA, "tests/clients/ohms_law.py", &addresses);
}

#[test]
fn pyvisa_takes_a_frame_through_both_instruments() {
    if !is_requested("pyvisa") {
        return;
    }
    let served = Served::start_in_time(&["--port-vxi11", "0"]);
    let source = socket(&served, "6221");
    // One power-line cycle for each of 676 readings is 13.5 s by itself.
    let mainframe = socket(&served, "34980a");
    script(
        PYVISA,
        "tests/clients/frame.py",
        &[&source, &mainframe, "13.5"],
    );
}

#[test]
fn pyvisa_takes_the_same_frame_over_vxi_11() {
    if !is_requested("pyvisa") {
        return;
    }
    let served = Served::start(&["--port-vxi11", "0"]);
    let (host, port) = served.address("vxi11").rsplit_once(':').unwrap();
    let mainframe = format!("TCPIP::{host},{port}::inst0::INSTR");
    let source = socket(&served, "6221");
    script(
        PYVISA,
        "tests/clients/frame.py",
        &[&source, &mainframe, "0"],
    );
    script(PYVISA, "tests/clients/vxi11.py", &[served.address("vxi11")]);
}

#[test]
fn zeroconf_and_avahi_find_every_service() {
    if !is_requested("zeroconf") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let profile = folder.path().join("announced.toml");
    let serial = format!("B{}", std::process::id());
    std::fs::write(&profile, format!("[mainframe]\nserial = \"{serial}\"\n")).unwrap();
    let profile = profile.to_str().unwrap();
    let served = Served::start(&["--announce", "--port-vxi11", "0", "--profile", profile]);
    let services = [
        ("_scpi-raw._tcp", "34980a"),
        ("_lxi._tcp", "http"),
        ("_http._tcp", "http"),
        ("_vxi-11._tcp", "vxi11"),
    ]
    .map(|(kind, key)| format!("{kind}={}", served.address(key).rsplit(':').next().unwrap()));
    let arguments: Vec<&str> = [serial.as_str()]
        .into_iter()
        .chain(services.iter().map(String::as_str))
        .collect();
    script(ZEROCONF, "tests/clients/announced.py", &arguments);
    let avahi = Avahi::start().unwrap_or_else(|reason| {
        panic!("avahi-daemon and dbus-daemon are required and cannot be started: {reason}")
    });
    let browse = ["--resolve", "--terminate", "--parsable", "_lxi._tcp"];
    let reported = avahi.ask("avahi-browse", &browse);
    let wanted = ["txtvers=1", "Model=34980A", serial.as_str()];
    assert!(
        wanted.iter().all(|word| reported.contains(word)),
        "{reported}"
    );
    let reported = avahi.ask("lxi", &["discover", "--mdns", "--timeout", "3"]);
    assert!(
        reported.contains(&format!("34980A #{serial}")),
        "{reported}"
    );
    assert!(reported.contains("vxi-11 service on port"), "{reported}");
    assert_eq!(served.terminate(), Some(0));
    // A clean stop withdraws the announcement; without that it would live for 120 s (RFC 6762 section 10).
    let stopped = Instant::now();
    let browse = ["--terminate", "--parsable", "_lxi._tcp"];
    while avahi.ask("avahi-browse", &browse).contains(&serial) {
        assert!(stopped.elapsed() < Duration::from_secs(90));
    }
}

/// An avahi-daemon with its own message bus.
struct Avahi {
    bus: Child,
    daemon: Child,
    folder: tempfile::TempDir,
}

impl Avahi {
    fn start() -> Result<Self, String> {
        let reported = |what: &'static str| move |fault: std::io::Error| format!("{what}: {fault}");
        let folder = tempfile::tempdir().map_err(reported("a folder"))?;
        let mut bus = Command::new("dbus-daemon")
            .args(["--config-file=/usr/share/dbus-1/system.conf", "--nopidfile"])
            .args(["--nofork", "--print-address"])
            .arg(format!("--address={}", address(&folder)))
            .stdout(Stdio::piped())
            .spawn()
            .map_err(reported("dbus-daemon (package dbus)"))?;
        let mut line = String::new();
        let out = bus.stdout.take().ok_or("dbus-daemon has no output")?;
        let message = BufReader::new(out).read_line(&mut line);
        let daemon = Command::new("avahi-daemon")
            .args(["--no-drop-root", "--no-chroot", "--no-rlimits"])
            .env("DBUS_SYSTEM_BUS_ADDRESS", address(&folder))
            .stderr(Stdio::piped())
            .spawn();
        let (Ok(1..), Ok(mut daemon)) = (message, daemon) else {
            bus.kill().ok();
            bus.wait().ok();
            return Err(
                "dbus-daemon or avahi-daemon (package avahi-daemon) ended at once".to_owned(),
            );
        };
        let message = daemon.stderr.take().ok_or("avahi-daemon has no output")?;
        let mut received = Vec::new();
        let up = BufReader::new(message)
            .lines()
            .map_while(Result::ok)
            .any(|line| {
                let complete = line.contains("startup complete");
                received.push(line);
                complete
            });
        let avahi = Self {
            bus,
            daemon,
            folder,
        };
        match up {
            true => Ok(avahi),
            false => Err(received.join("\n")),
        }
    }

    fn ask(&self, program: &str, arguments: &[&str]) -> String {
        let bus = ("DBUS_SYSTEM_BUS_ADDRESS", address(&self.folder));
        let ended = run(Command::new(program).args(arguments).env(bus.0, bus.1)).unwrap();
        String::from_utf8_lossy(&ended.stdout).into_owned()
    }
}

fn address(folder: &tempfile::TempDir) -> String {
    format!("unix:path={}", folder.path().join("bus").display())
}

impl Drop for Avahi {
    fn drop(&mut self) {
        for child in [&mut self.daemon, &mut self.bus] {
            child.kill().ok();
            child.wait().ok();
        }
    }
}

#[test]
fn lxi_tools_ask_who_is_there() {
    if !is_requested("lxi") {
        return;
    }
    if let Err(fault) = Command::new("lxi").arg("--version").output() {
        panic!("lxi (package lxi-tools) is required and cannot be run: {fault}");
    }
    let served = Served::start(&[]);
    for (instrument, model) in [("6221", "MODEL 6221"), ("34980a", "34980A")] {
        let (host, port) = served.address(instrument).rsplit_once(':').unwrap();
        let requested = ["scpi", "--raw", "--address", host, "--port", port, "*IDN?"];
        let reported = run(Command::new("lxi").args(requested)).unwrap();
        let reported = String::from_utf8_lossy(&reported.stdout);
        assert!(reported.contains(model), "{reported}");
    }
}

/// Every usable property of PyMeasure's class.
#[test]
fn pymeasure_uses_every_property_of_a_served_source() {
    if !is_requested("pymeasure") {
        return;
    }
    let served = Served::start_in_time(&["--load", "resistor 1 2 500"]);
    // The injecting relay of pair 1 connects to the resistor.
    let mut mainframe = TcpStream::connect(served.address("34980a")).unwrap();
    mainframe.write_all(b"ROUT:CLOS (@1036);*OPC?\n").unwrap();
    BufReader::new(mainframe)
        .read_line(&mut String::new())
        .unwrap();
    let script_file = "../drivers/keithley-6221/tests/pymeasure_client.py";
    script(PYMEASURE, script_file, &[served.address("6221")]);
}

#[test]
fn qcodes_drives_a_served_34934a() {
    if !is_requested("qcodes") {
        return;
    }
    let slots = [
        "--slot",
        "1=34934A,8x64",
        "--slot",
        "2=34921A",
        "--slot",
        "3=34934A,none",
    ];
    let served = Served::start_in_time(&slots);
    let port = served.address("34980a").rsplit(':').next().unwrap();
    let script_file = "../drivers/keysight-34980a/tests/clients/qcodes_34934a.py";
    script(QCODES, script_file, &[port]);
}

#[test]
fn instro_reads_scans_and_switches_what_is_served() {
    if !is_requested("instro") {
        return;
    }
    let slots = [
        "--load", "nothing", "--slot", "1=34922A", "--slot", "2=34931A",
    ];
    let served = Served::start_in_time(&slots);
    let port = served.address("34980a").rsplit(':').next().unwrap();
    let script_file = "../drivers/keysight-34980a/tests/clients/instro_34980a.py";
    // Without a load an ideal meter reads zero.
    script(INSTRO, script_file, &[port, "0.0"]);
}

#[test]
fn the_pymeasure_example_works_as_written() {
    if !is_requested("pymeasure") {
        return;
    }
    let served = Served::start_in_time(&["--load", "resistor 1 2 470"]);
    let addresses = [socket(&served, "6221"), socket(&served, "34980a")];
    let addresses = addresses.each_ref().map(String::as_str);
    script(PYMEASURE, "examples/pymeasure_resistor.py", &addresses);
}

#[test]
fn the_qcodes_example_works_as_written() {
    if !is_requested("qcodes") {
        return;
    }
    let served = Served::start_in_time(&["--profile", "matrix-34934a", "--load", "mesh 100"]);
    let addresses = [socket(&served, "6221"), socket(&served, "34980a")];
    let addresses = addresses.each_ref().map(String::as_str);
    script(QCODES, "examples/qcodes_matrix.py", &addresses);
}
