//! How a command ends when it does not succeed.

use std::fmt;
use std::path::Path;
use std::process::ExitCode;

use outfile::{Existing, OutFileError};

/// A failure with its whole chain of causes, and whether the command line is to blame.
#[derive(Debug)]
pub(crate) struct Failure {
    message: String,
    usage: bool,
}

impl Failure {
    /// The command line cannot be followed: exit code 2.
    pub(crate) fn usage(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            usage: true,
        }
    }

    /// What was attempted, and why it failed: exit code 1.
    pub(crate) fn of(attempt: &str, cause: &dyn std::error::Error) -> Self {
        Self {
            message: format!("{attempt}: {}", survey::error_chain(cause)),
            usage: false,
        }
    }

    /// A failure without a deeper cause.
    pub(crate) fn because(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            usage: false,
        }
    }

    pub(crate) fn code(&self) -> ExitCode {
        ExitCode::from(if self.usage { 2 } else { 1 })
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
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
pub(crate) fn write(path: &Path, existing: Existing, text: String) -> Result<(), Failure> {
    Ok(outfile::write(path, existing, text.as_bytes())?)
}
