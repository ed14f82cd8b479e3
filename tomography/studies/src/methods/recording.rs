//! Frames and their baseline as options name them.

use std::path::Path;

use imaging::recorded::{BaselineRule, FrameTable, RecordedError};

use crate::failure::Failure;

/// Reads frames of so many readings, and the baseline by its rule: `first:N` or a file.
///
/// # Errors
/// A rule that is none, a file that cannot be read, or too few frames for the baseline.
pub fn read_frames(
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
