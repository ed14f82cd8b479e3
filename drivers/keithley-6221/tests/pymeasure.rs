//! PyMeasure's driver, unmodified, over TCP against the simulator. Fetched and run only with TACTUS_REQUIRE_CLIENTS=1.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use keithley_6221::{Resistor, Settings6221, Simulator6221};
use scpi::Framer;
use survey::Ohms;

/// An environment with PyMeasure and pyvisa-py, kept between runs.
fn environment() -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pymeasure");
    let python = folder.join("bin/python");
    let has_both = Command::new(&python)
        .args(["-c", "import pymeasure.instruments.keithley, pyvisa_py"])
        .stderr(Stdio::null())
        .status();
    if has_both.is_ok_and(|status| status.success()) {
        return Ok(python);
    }
    let make = ["-m", "venv", "--clear"];
    succeed(Command::new("python3").args(make).arg(&folder))?;
    succeed(Command::new(&python).args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "pymeasure==0.16.0",
        "pyvisa-py==0.8.1",
    ]))?;
    Ok(python)
}

fn succeed(command: &mut Command) -> Result<(), String> {
    let ended = command
        .output()
        .map_err(|fault| format!("{command:?}: {fault}"))?;
    if ended.status.success() {
        return Ok(());
    }
    let text = String::from_utf8_lossy(&ended.stderr);
    let last = text.lines().last().unwrap_or_default().to_owned();
    Err(format!("{command:?} failed: {last}"))
}

/// Serves one client, in real time.
fn serve(mut client: TcpStream) -> std::io::Result<()> {
    client.set_nodelay(true)?;
    let start = Instant::now();
    let mut source = Simulator6221::new(Settings6221 {
        command_time: Duration::ZERO,
        range_time: Duration::ZERO,
        ..Settings6221::default()
    });
    let mut load = Resistor::new(Ohms(500.0));
    let mut framer = Framer::new(4096);
    let mut bytes = [0; 512];
    loop {
        let count = client.read(&mut bytes)?;
        if count == 0 {
            return Ok(());
        }
        framer.push(&bytes[..count]);
        for line in framer.by_ref() {
            let line = String::from_utf8_lossy(&line.expect("lines are short")).into_owned();
            let reply = source.receive(&line, start.elapsed(), &mut load);
            // the time that the instrument needs, which is part of the simulation
            thread::sleep(reply.busy);
            if let Some(text) = reply.text {
                client.write_all(format!("{text}\n").as_bytes())?;
            }
        }
    }
}

fn run(python: &Path) -> Output {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    thread::spawn(move || {
        while let Ok((client, _)) = listener.accept() {
            // A client that disconnects ends its conversation.
            serve(client).unwrap_or(());
        }
    });
    Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/pymeasure_client.py"))
        .arg(address)
        .output()
        .unwrap()
}

#[test]
fn pymeasure_finds_a_6221() {
    if !needs::required("CLIENTS") {
        let why = "PyMeasure is fetched and run only with TACTUS_REQUIRE_CLIENTS=1";
        return needs::lacking("CLIENTS", why);
    }
    let python = environment()
        .unwrap_or_else(|reason| panic!("PyMeasure is required and cannot be had: {reason}"));
    let client = run(&python);
    print!("{}", String::from_utf8_lossy(&client.stdout));
    assert!(
        client.status.success(),
        "{}",
        String::from_utf8_lossy(&client.stderr)
    );
}
