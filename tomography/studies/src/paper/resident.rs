//! Memory used by loading a model.

use std::path::Path;

use eit::model;

use crate::failure::{Attempt, Failure};

/// Largest growth of the resident memory of this process while it loads a model, bytes; `None` if the system does not
/// report it. Correct only in a new process, because an older one reuses memory that was freed before.
///
/// # Errors
/// The model cannot be loaded.
pub fn resident_growth(file: &Path) -> Result<Option<u64>, Failure> {
    let before = memory("VmRSS:");
    let loaded = model::load(file).attempt("cannot use a trained model")?;
    let peak = memory("VmHWM:");
    drop(loaded);
    Ok(before
        .zip(peak)
        .map(|(before, peak)| peak.saturating_sub(before)))
}

/// Resident memory of this process, bytes, from `/proc/self/status`: `VmRSS:` is the present value, `VmHWM:` the peak.
fn memory(which: &str) -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(which))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kilobytes)
}
