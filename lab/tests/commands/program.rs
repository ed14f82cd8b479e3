//! Shared functions: running the program, tables of numbers.

use std::ffi::OsString;
use std::path::Path;
use std::process::{Command, Output};

/// Runs the program; returns its exit code and output.
pub fn lab<S: AsRef<std::ffi::OsStr>>(words: &[S]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(words)
        .output()
        .unwrap()
}

/// Runs the program and expects success; returns standard error.
pub fn done<S: AsRef<std::ffi::OsStr>>(words: &[S]) -> String {
    let output = lab(words);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    message
}

/// Words of a command line: text split at spaces, with paths put in place of `{}`.
pub fn words(line: &str, paths: &[&Path]) -> Vec<OsString> {
    let mut paths = paths.iter();
    line.split(' ')
        .map(|word| match word {
            "{}" => paths.next().expect("a path for each {}").into(),
            word => word.into(),
        })
        .collect()
}

/// Rows of numbers of a CSV file, without its header.
pub fn numbers(path: &Path) -> Vec<Vec<f64>> {
    std::fs::read_to_string(path)
        .unwrap()
        .lines()
        .filter_map(|line| line.split(',').map(|field| field.parse().ok()).collect())
        .collect()
}
