//! Memory used by loading a model.

use std::path::Path;

use eit::model;

use crate::failure::Failure;

/// Growth of this process by loading a model, bytes; `None` if the system does not report it. Correct only in a new
/// process: an older one reuses memory freed by earlier work.
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

/// Resident memory of this process, bytes, from Linux.
fn resident() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kilobytes)
}
