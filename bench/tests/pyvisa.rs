//! A third party's client: pyvisa-py in a virtual environment of its own. Skips, with its reason, where Python or the
//! packages cannot be had, unless TACTUS_REQUIRE_PYVISA=1.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// An environment with pyvisa and pyvisa-py, kept between runs.
fn environment() -> Result<PathBuf, String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("pyvisa");
    let python = folder.join("bin/python");
    let has_pyvisa = |python: &Path| {
        let asked = Command::new(python)
            .args(["-c", "import pyvisa, pyvisa_py"])
            .stderr(Stdio::null())
            .status();
        asked.is_ok_and(|status| status.success())
    };
    if has_pyvisa(&python) {
        return Ok(python);
    }
    let succeed = |command: &mut Command| -> Result<(), String> {
        let ended = command
            .output()
            .map_err(|fault| format!("{command:?}: {fault}"))?;
        if ended.status.success() {
            return Ok(());
        }
        let told = String::from_utf8_lossy(&ended.stderr);
        let last = told.lines().last().unwrap_or_default().to_owned();
        Err(format!("{command:?} failed: {last}"))
    };
    succeed(
        Command::new("python3")
            .args(["-m", "venv", "--clear"])
            .arg(&folder),
    )?;
    succeed(Command::new(&python).args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "pyvisa>=1.14,<2",
        "pyvisa-py>=0.7,<1",
    ]))?;
    Ok(python)
}

#[test]
fn a_strangers_client_finds_ohms_law() {
    if std::env::var_os("TACTUS_REQUIRE_PYVISA").is_none() {
        println!("skipped: pyvisa-py is fetched and run only with TACTUS_REQUIRE_PYVISA=1");
        return;
    }
    let python = match environment() {
        Ok(python) => python,
        Err(reason) => {
            let required = std::env::var_os("TACTUS_REQUIRE_PYVISA").is_some_and(|set| set == "1");
            assert!(
                !required,
                "pyvisa-py is required and cannot be had: {reason}"
            );
            println!("skipped: pyvisa-py cannot be had ({reason})");
            return;
        }
    };
    let mut bench = Command::new(env!("CARGO_BIN_EXE_tactus-bench"))
        .args(["serve", "--port-6221", "0", "--port-34980a", "0"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(bench.stdout.take().unwrap())
        .read_line(&mut line)
        .unwrap();
    let ready: serde_json::Value = serde_json::from_str(&line).unwrap();
    let client = Command::new(python)
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ohms_law.py"))
        .args([
            ready["6221"].as_str().unwrap(),
            ready["34980a"].as_str().unwrap(),
        ])
        .output();
    bench.kill().unwrap();
    bench.wait().unwrap();
    let client = client.unwrap();
    print!("{}", String::from_utf8_lossy(&client.stdout));
    assert!(
        client.status.success(),
        "{}",
        String::from_utf8_lossy(&client.stderr)
    );
}
