//! Requirements of tests that a machine may lack: recordings, programs, rights.
//!
//! A test that lacks something calls [`lacking`] and returns. The reason is printed and noted in a file of the target
//! folder; the last test executable of `cargo test --workspace` lists the notes ([`not_run`]).
//! `TACTUS_REQUIRE_<KIND>=1` makes the lack a failure.

mod python;

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

pub use python::{python, run};

/// Whether `TACTUS_REQUIRE_<kind>` is 1: what is missing then fails the test.
pub fn required(kind: &str) -> bool {
    std::env::var_os(format!("TACTUS_REQUIRE_{kind}")).is_some_and(|set| set == "1")
}

/// Reports that the current test cannot run here; `missing` states what is missing and how to get it. The caller
/// returns.
///
/// # Panics
/// With `TACTUS_REQUIRE_<kind>=1`, and if the note cannot be written.
pub fn lacking(kind: &str, missing: &str) {
    assert!(
        !required(kind),
        "TACTUS_REQUIRE_{kind}=1, and this test cannot run: {missing}"
    );
    let missing = missing.split_whitespace().collect::<Vec<_>>().join(" ");
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    eprintln!("skipped: {test}: {missing}");
    let line = format!("{}\t{}\t{test}\t{kind}\t{missing}\n", group(), executable());
    let noted = notes().and_then(|mut file| file.write_all(line.as_bytes()));
    noted.unwrap_or_else(|fault| panic!("{}: {fault}", path().display()));
}

/// A file or folder of `shared/` next to the project, for example `data/uottawa2005`; `None` (reported, kind `DATA`)
/// if it does not exist.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../../shared")
        .join(name);
    if path.exists() {
        return Some(path);
    }
    let missing = format!("the recordings shared/{name} are not beside the project's folder");
    lacking("DATA", &missing);
    None
}

/// A reference case of the project, for example `disc16`; it always exists.
pub fn case(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../cases")
        .join(name)
}

/// Whether a program is in the search path; reported if not.
pub fn program(kind: &str, name: &str) -> bool {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&folders).any(|folder| folder.join(name).is_file());
    if !found {
        lacking(kind, &format!("{name} is not installed"));
    }
    found
}

/// The tests of the current `cargo test` that did not run, one line each: executable, test, kind, what is missing.
/// Notes of other runs are deleted.
///
/// # Errors
/// The notes cannot be read or written.
pub fn not_run() -> std::io::Result<Vec<String>> {
    let mut file = notes()?;
    let mut text = String::new();
    file.seek(SeekFrom::Start(0))?;
    file.read_to_string(&mut text)?;
    let mark = format!("{}\t", group());
    let own: BTreeSet<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix(&mark))
        .collect();
    file.set_len(0)?;
    for line in &own {
        file.write_all(format!("{mark}{line}\n").as_bytes())?;
    }
    Ok(own
        .into_iter()
        .map(|line| line.replace('\t', " | "))
        .collect())
}

/// The processes of one command share their process group.
fn group() -> i32 {
    rustix::process::getpgrp().as_raw_nonzero().get()
}

fn executable() -> String {
    let own = std::env::current_exe().unwrap_or_default();
    let stem = own.file_stem().unwrap_or_default().to_string_lossy();
    // cargo appends a hash
    let name = stem.rsplit_once('-').map_or(&*stem, |(name, _)| name);
    name.to_owned()
}

/// Path of `tests-not-run.tsv` in the target folder; executables are in `target/debug/deps`.
fn path() -> PathBuf {
    let own = std::env::current_exe().unwrap_or_default();
    let target = own.ancestors().nth(3).unwrap_or(Path::new("."));
    target.join("tests-not-run.tsv")
}

/// The file of the notes, locked against other test executables until it is closed.
fn notes() -> std::io::Result<File> {
    let file = OpenOptions::new()
        .read(true)
        .append(true)
        .create(true)
        .open(path())?;
    file.lock()?;
    Ok(file)
}
