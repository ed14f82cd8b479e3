//! How much memory loading a model takes.

use std::path::Path;

use eit::model;

use crate::failure::Failure;

/// By how many bytes loading a model makes this process larger; `None` where the system does not report it. Only a process
/// of its own measures it right: in a used one the model moves into memory that other work has left behind.
///
/// # Errors
/// The model cannot be loaded.
pub fn resident_growth(file: &Path) -> Result<Option<u64>, Failure> {
    let before = resident();
    let loaded =
        model::load(file).map_err(|fault| Failure::of("cannot use a trained model", &fault))?;
    let after = resident();
    drop(loaded);
    Ok(before
        .zip(after)
        .map(|(before, after)| after.saturating_sub(before)))
}

/// Resident memory of this process, bytes, as Linux says.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kilobytes)
}
