//! Errors of recorded frames.

use std::path::PathBuf;

use eit::CaseError;
use logbook::LogbookError;
use survey::BaselineError;

/// Why recorded frames cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordedError {
    /// The session file cannot be read.
    #[error("the recorded session cannot be read")]
    Session(#[from] LogbookError),
    /// The protocol of a case folder is invalid.
    #[error("the protocol of the recording")]
    Protocol(#[source] CaseError),
    /// The table of frames is invalid.
    #[error("the frames")]
    Frames(#[source] CaseError),
    /// Frames with different currents for different readings.
    #[error(
        "{} injects different currents; divide the readings by their current and omit the column current_A",
        .0.display()
    )]
    Currents(PathBuf),
    /// A file that is neither in the folder nor in the current directory.
    #[error("there is no {} in {} nor in the current directory", .file.display(), .folder.display())]
    Missing {
        /// The file as given.
        file: PathBuf,
        /// The case folder.
        folder: PathBuf,
    },
    /// A case folder without the default table.
    #[error("{} has no frames.csv: name the file of frames with --frames FILE", .0.display())]
    NoFrames(PathBuf),
    /// An invalid provenance file.
    #[error("{}: {why}", .path.display())]
    Provenance {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// `first:N` without a number, or with more frames than there are.
    #[error(
        "baseline '{requested}' asks for the first frames of a recording that has {frames}; write first:1 to first:{frames}"
    )]
    First {
        /// The rule as given.
        requested: String,
        /// Number of frames.
        frames: usize,
    },
    /// No baseline can be made from the frames.
    #[error("no baseline can be made from the frames of '{requested}'")]
    Baseline {
        /// The rule as given.
        requested: String,
        /// The reason.
        #[source]
        cause: BaselineError,
    },
    /// A session without a baseline, if no rule selects frames for one.
    #[error("session {0} has no baseline; name its frames: baseline = \"first:N\"")]
    NoBaseline(String),
}
