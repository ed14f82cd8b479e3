//! Frames and their baseline as the command line names them.

use std::path::Path;

use imaging::recorded::{BaselineRule, FrameTable, RecordedError};

use crate::failure::Failure;

/// Reads frames of so many readings, and the baseline by its rule: `first:N` or a file.
pub(crate) fn read(
    frames: &Path,
    baseline: &str,
    readings: usize,
    negate: bool,
) -> Result<FrameTable, Failure> {
    let rule: BaselineRule = baseline
        .parse()
        .map_err(|why| Failure::usage(format!("--baseline {baseline}: {why}")))?;
    FrameTable::read(frames, &rule, readings, negate).map_err(|error| match error {
        RecordedError::Frames(cause) => Failure::of("cannot read the frames", &cause),
        RecordedError::First { .. } => {
            Failure::because(format!("--{error} ({})", frames.display()))
        }
        other => Failure::of("cannot use the recording", &other),
    })
}
