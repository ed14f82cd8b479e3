//! Reads the frames that belong to a case, which is a folder or a MAT-file.

use std::path::Path;

use eit::Case;
use imaging::recorded::{self, FrameTable, TableOptions};
use studies::Failure;
use survey::Amps;

use super::eidors;

/// The folder of a case: the case itself, or the folder that contains its MAT-file.
pub(crate) fn folder(case: &Path) -> &Path {
    if !eidors::is_mat(case) {
        return case;
    }
    let beside = case.parent();
    let named = beside.filter(|folder| !folder.as_os_str().is_empty());
    named.unwrap_or(Path::new("."))
}

/// The frames of a table, or of the MAT-file if no table is named.
pub(crate) fn frames(
    case: &Path,
    table: &TableOptions<'_>,
    readings: usize,
) -> Result<FrameTable, Failure> {
    if eidors::is_mat(case) && table.frames.is_none() {
        return eidors::frames(case, table.baseline, readings, table.negate);
    }
    Ok(FrameTable::read(folder(case), table, readings)?)
}

/// The current of all readings of a case that was read from `path`. `attempt`: the purpose, for the error.
///
/// # Errors
/// Readings at several currents.
pub(crate) fn one_current(path: &Path, case: &Case, attempt: &str) -> Result<Amps, Failure> {
    let file = match eidors::is_mat(path) {
        true => path.to_owned(),
        false => path.join("protocol.csv"),
    };
    recorded::one_current(&file, &case.currents).map_err(|fault| Failure::of(attempt, &fault))
}
