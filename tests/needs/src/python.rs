//! A Python with the packages of a test, in a virtual environment of its own.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::lacking;

/// The Python of a virtual environment `folder/venv-NAME` with these packages; reuses a complete one. `None` (reported,
/// kind `PYTHON`) if it cannot be created, for example without a network.
pub fn python(folder: &Path, name: &str, packages: &[&str]) -> Option<PathBuf> {
    match environment(&folder.join(format!("venv-{name}")), packages) {
        Ok(python) => Some(python),
        Err(why) => {
            lacking("PYTHON", &format!("no Python with {packages:?}: {why}"));
            None
        }
    }
}

fn environment(folder: &Path, packages: &[&str]) -> Result<PathBuf, String> {
    let fault = |fault: std::io::Error| format!("{}: {fault}", folder.display());
    // tests of several threads and processes use the same environment
    let turn = folder.with_extension("lock");
    let turn = OpenOptions::new().append(true).create(true).open(turn);
    let turn = turn.map_err(fault)?;
    turn.lock().map_err(fault)?;
    let (python, complete) = (folder.join("bin/python"), folder.join("complete"));
    let wanted = packages.join(" ");
    if std::fs::read_to_string(&complete).is_ok_and(|found| found == wanted) {
        return Ok(python);
    }
    run(Command::new("python3")
        .args(["-m", "venv", "--clear"])
        .arg(folder))?;
    let pip = [
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ];
    run(Command::new(&python).args(pip).args(packages))?;
    std::fs::write(complete, wanted).map_err(fault)?;
    Ok(python)
}

/// Runs a program of a test to its end and returns what it printed.
///
/// # Errors
/// It cannot be run, or fails; with the end of its error stream.
pub fn run(command: &mut Command) -> Result<String, String> {
    let ended = command
        .output()
        .map_err(|fault| format!("{command:?} cannot be run: {fault}"))?;
    if ended.status.success() {
        return Ok(String::from_utf8_lossy(&ended.stdout).into_owned());
    }
    let printed = String::from_utf8_lossy(&ended.stderr).into_owned();
    let from = printed.len().saturating_sub(2000);
    let end = printed.get(from..).unwrap_or(&printed);
    Err(format!("{command:?} failed:\n{end}"))
}
