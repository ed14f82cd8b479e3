//! How a study or a command ends when it does not succeed.

use std::fmt;
use std::path::Path;

use imaging::recorded::RecordedError;
use outfile::{Existing, OutFileError};
use training::TrainError;
use training::dataset::DataSetError;

/// A failure with its whole chain of causes, and whether the command line is to blame.
#[derive(Debug)]
pub struct Failure {
    message: String,
    usage: bool,
}

impl Failure {
    /// The options cannot be followed.
    pub fn usage(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            usage: true,
        }
    }

    /// What was attempted, and why it failed.
    pub fn of(attempt: &str, cause: &dyn std::error::Error) -> Self {
        Self {
            message: format!("{attempt}: {}", survey::error_chain(cause)),
            usage: false,
        }
    }

    /// A failure without a deeper cause.
    pub fn because(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            usage: false,
        }
    }

    /// Whether the command line is to blame.
    pub fn is_usage(&self) -> bool {
        self.usage
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl From<DataSetError> for Failure {
    fn from(fault: DataSetError) -> Self {
        Self::because(survey::error_chain(&fault))
    }
}

impl From<TrainError> for Failure {
    fn from(fault: TrainError) -> Self {
        Self::of("the training", &fault)
    }
}

impl From<RecordedError> for Failure {
    fn from(error: RecordedError) -> Self {
        match error {
            RecordedError::Frames(cause) => Self::of("cannot read the frames", &cause),
            RecordedError::First { .. } => Self::because(format!("--{error}")),
            other => Self::of("cannot use the recording", &other),
        }
    }
}

impl From<OutFileError> for Failure {
    fn from(refused: OutFileError) -> Self {
        // the error names the file; only a cause of the system follows
        match std::error::Error::source(&refused) {
            Some(cause) => Self::of(&refused.to_string(), &cause),
            None => Self::because(refused.to_string()),
        }
    }
}

/// Writes a result file.
///
/// # Errors
/// The file exists and `existing` refuses that, or it cannot be written.
pub fn write(path: &Path, existing: Existing, text: String) -> Result<(), Failure> {
    Ok(outfile::write(path, existing, text.as_bytes())?)
}
