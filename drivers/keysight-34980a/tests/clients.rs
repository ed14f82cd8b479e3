//! Third-party clients use the simulator unmodified, over TCP, in a separate virtual environment.
//!
//! They are fetched and run only with TACTUS_REQUIRE_CLIENTS=1; a client that cannot be fetched then fails the test.

mod stand_in;

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use keysight_34980a::{Session, Simulator34980a};
use scpi::Framer;
use stand_in::{Sheet, mainframe};

/// A mainframe on a port of this machine, in real time.
struct Served {
    port: u16,
}

struct Rig {
    unit: Simulator34980a,
    sheet: Sheet,
}

impl Served {
    fn new(modules: &[&str], volts: f64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let sheet = Sheet {
            volts: Some(volts),
            ..Sheet::default()
        };
        let unit = mainframe(modules);
        let rig = Arc::new(Mutex::new(Rig { unit, sheet }));
        let start = Instant::now();
        std::thread::spawn(move || {
            for (number, stream) in (1..).zip(listener.incoming().flatten()) {
                let rig = Arc::clone(&rig);
                std::thread::spawn(move || converse(stream, Session(number), &rig, start));
            }
        });
        Self { port }
    }
}

fn converse(mut stream: TcpStream, session: Session, rig: &Mutex<Rig>, start: Instant) {
    let mut framer = Framer::new(65_536);
    let mut bytes = [0; 4096];
    while let Ok(count @ 1..) = stream.read(&mut bytes) {
        framer.push(&bytes[..count]);
        for line in framer.by_ref().flatten() {
            let line = String::from_utf8_lossy(&line).into_owned();
            let response = {
                let Rig { unit, sheet } = &mut *rig.lock().unwrap();
                unit.receive_from(session, &line, start.elapsed(), sheet)
            };
            // the time that the instrument needs
            std::thread::sleep(response.busy);
            if let Some(text) = response.text
                && stream.write_all(format!("{text}\n").as_bytes()).is_err()
            {
                return;
            }
        }
    }
    rig.lock().unwrap().unit.end_session(session);
}

fn run(command: &mut Command) -> Result<Output, String> {
    let output = command
        .output()
        .map_err(|fault| format!("{command:?} cannot be run: {fault}"))?;
    if output.status.success() {
        return Ok(output);
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let end: Vec<&str> = text.lines().rev().take(12).collect();
    let end: Vec<&str> = end.into_iter().rev().collect();
    Err(format!("{command:?} failed:\n{}", end.join("\n")))
}

/// A virtual environment with the packages; a complete one is reused.
fn environment(name: &str, packages: &[&str]) -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let python = folder.join("bin/python");
    let complete = folder.join("complete");
    let requested = packages.join(" ");
    if std::fs::read_to_string(&complete).is_ok_and(|found| found == requested) {
        return Ok(python);
    }
    run(Command::new("python3")
        .args(["-m", "venv", "--clear"])
        .arg(&folder))?;
    let pip = [
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--retries",
        "1",
    ];
    run(Command::new(&python).args(pip).args(packages))?;
    std::fs::write(&complete, requested).map_err(|fault| format!("{complete:?}: {fault}"))?;
    Ok(python)
}

fn works(client: &str, packages: &[&str], script: &str, served: &Served) {
    if !needs::required("CLIENTS") {
        let why = format!("{client} is fetched and run only with TACTUS_REQUIRE_CLIENTS=1");
        return needs::lacking("CLIENTS", &why);
    }
    let python = environment(client, packages)
        .unwrap_or_else(|reason| panic!("{client} is required and cannot be had: {reason}"));
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/clients")
        .join(script);
    let scratch = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{client}-home"));
    std::fs::create_dir_all(&scratch).unwrap();
    let outcome = run(Command::new(python)
        .arg(script)
        .arg(served.port.to_string())
        .current_dir(&scratch)
        // The clients store files of their own in the home folder.
        .env("HOME", &scratch));
    if let Err(fault) = outcome {
        panic!("{fault}");
    }
}

#[test]
fn qcodes_drives_a_34934a() {
    let served = Served::new(&["34934A,8x64", "34921A", "34934A,none"], 0.0);
    let packages = ["qcodes==0.58.0", "pyvisa-py==0.8.1"];
    works("qcodes", &packages, "qcodes_34934a.py", &served);
}

#[test]
fn instro_reads_scans_and_switches() {
    let served = Served::new(&["34922A", "34931A"], 1.25);
    let packages = ["instro==1.22.0", "pyvisa-py==0.8.1"];
    works("instro", &packages, "instro_34980a.py", &served);
}
