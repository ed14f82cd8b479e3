//! Failures of commands, and their exit codes.

use std::process::ExitCode;

use survey::error_chain;

use crate::catalogue::CatalogueError;
use crate::reader::ReadError;
use crate::retrieval::RetrievalError;
use crate::settings::SettingsError;
use crate::store::StoreError;
use crate::upload::UploadError;

/// The failure of a command, with a text that names the remedy.
#[derive(Debug)]
pub enum Failure {
    /// Any other failure.
    Failed(String),
    /// The command line is wrong.
    Usage(String),
    /// There is no such session.
    Missing(String),
    /// Store or catalogue cannot be reached at present.
    Temporary(String),
    /// The configuration is wrong.
    Configuration(String),
}

impl Failure {
    fn of(text: String, temporary: bool) -> Self {
        match temporary {
            true => Self::Temporary(text),
            false => Self::Failed(text),
        }
    }

    /// Prints the failure on standard error, as text or as one JSON object.
    pub(super) fn report(&self, json: bool) -> ExitCode {
        let (kind, code, text) = match self {
            Self::Failed(text) => ("failed", 1, text),
            Self::Usage(text) => ("usage", 2, text),
            Self::Missing(text) => ("missing", 3, text),
            Self::Temporary(text) => ("temporary", 75, text),
            Self::Configuration(text) => ("configuration", 78, text),
        };
        match json {
            true => eprintln!("{}", survey::error_line(kind, code, text)),
            false => eprintln!("tactus-archive: {}", survey::printable_lines(text)),
        }
        ExitCode::from(code)
    }
}

impl From<SettingsError> for Failure {
    fn from(error: SettingsError) -> Self {
        Self::Configuration(error_chain(&error))
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::of(error_chain(&error), error.is_temporary())
    }
}

impl From<RetrievalError> for Failure {
    fn from(error: RetrievalError) -> Self {
        match error {
            RetrievalError::Store(error) => error.into(),
            other => Self::Failed(error_chain(&other)),
        }
    }
}

impl From<CatalogueError> for Failure {
    fn from(error: CatalogueError) -> Self {
        let text = error_chain(&error);
        match error {
            CatalogueError::Dsn(_) | CatalogueError::Ca(_) | CatalogueError::Password(_) => {
                Self::Configuration(text)
            }
            error => Self::of(text, error.is_temporary()),
        }
    }
}

impl From<ReadError> for Failure {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Settings(error) => error.into(),
            ReadError::Catalogue(error) => error.into(),
            ReadError::Retrieval(error) => error.into(),
            ReadError::NoSuchSession(_) => Self::Missing(error_chain(&error)),
            ReadError::Ambiguous { .. } => Self::Usage(error_chain(&error)),
            ReadError::Cache { .. } | ReadError::Record(_) | ReadError::Runtime(_) => {
                Self::Failed(error_chain(&error))
            }
        }
    }
}

impl From<UploadError> for Failure {
    fn from(error: UploadError) -> Self {
        match error {
            UploadError::Catalogue(error) => error.into(),
            UploadError::Store(error) => error.into(),
            other => Self::of(error_chain(&other), other.is_temporary()),
        }
    }
}
