//! Errors of studies and commands.

use std::fmt;
use std::path::Path;

use imaging::recorded::RecordedError;
use outfile::{Existing, OutFileError};
use shards::ShardError;
use training::TrainError;
use training::dataset::DataSetError;

use crate::exit::Exit;

/// An error message with its chain of causes, and the exit code of the command.
#[derive(Debug)]
pub struct Failure {
    message: String,
    exit: Exit,
}

impl Failure {
    /// A usage error.
    pub fn usage(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            exit: Exit::Usage,
        }
    }

    /// A file with settings that cannot be used.
    pub fn configuration(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            exit: Exit::Configuration,
        }
    }

    /// An error that names the attempted action and its cause.
    pub fn of(attempt: &str, cause: &dyn std::error::Error) -> Self {
        Self {
            message: format!("{attempt}: {}", survey::error_chain(cause)),
            exit: Exit::Failed,
        }
    }

    /// An error without a cause.
    pub fn because(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            exit: Exit::Failed,
        }
    }

    /// The result of a command with this error.
    pub fn exit(&self) -> Exit {
        self.exit
    }
}

/// Adds the attempted action to the error of a result.
pub(crate) trait Attempt<T> {
    /// # Errors
    /// As [`Failure::of`].
    fn attempt(self, what: &str) -> Result<T, Failure>;
}

impl<T, E: std::error::Error> Attempt<T> for Result<T, E> {
    fn attempt(self, what: &str) -> Result<T, Failure> {
        self.map_err(|cause| Failure::of(what, &cause))
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl From<DataSetError> for Failure {
    fn from(fault: DataSetError) -> Self {
        match fault {
            DataSetError::Shard(fault) => fault.into(),
            other => Self::because(survey::error_chain(&other)),
        }
    }
}

impl From<ShardError> for Failure {
    fn from(fault: ShardError) -> Self {
        Self {
            message: survey::error_chain(&fault),
            exit: match fault {
                ShardError::Held(_) | ShardError::Stopped { .. } => Exit::TryAgain,
                ShardError::Differs { .. } => Exit::Usage,
                ShardError::Missing { .. }
                | ShardError::Damaged { .. }
                | ShardError::Io { .. }
                | ShardError::Output(_) => Exit::Failed,
            },
        }
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
        // the error names the file, so only the error of the system is appended
        match std::error::Error::source(&refused) {
            Some(cause) => Self::of(&refused.to_string(), &cause),
            None => Self::because(refused.to_string()),
        }
    }
}

/// Writes a result file.
///
/// # Errors
/// The file exists and `existing` does not allow replacing it, or it cannot be written.
pub fn write(path: &Path, existing: Existing, text: String) -> Result<(), Failure> {
    Ok(outfile::write(path, existing, text.as_bytes())?)
}

/// Rows of a table as JSON objects, each with the name of the table.
pub(crate) fn tagged<T: serde::Serialize>(
    table: &str,
    rows: &[T],
) -> impl Iterator<Item = serde_json::Value> {
    rows.iter()
        .map(move |row| serde_json::json!({ "table": table, "row": row }))
}

/// Writes the tables of a study into a folder: `NAME.txt`, and `NAME.json` with an object for each row.
pub(crate) fn write_tables(
    folder: &Path,
    name: &str,
    existing: Existing,
    text: String,
    lines: Vec<serde_json::Value>,
) -> Result<(), Failure> {
    outfile::make_folder(folder, existing)?;
    write(&folder.join(format!("{name}.txt")), existing, text)?;
    let lines = serde_json::Value::Array(lines);
    write(
        &folder.join(format!("{name}.json")),
        existing,
        format!("{lines:#}\n"),
    )
}
