//! Errors of case folders.

use std::fmt;
use std::path::{Path, PathBuf};

use survey::ProtocolError;

use crate::MeshError;

/// Reasons for refusing a case folder or one of its files. Lines are counted from 1.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// A file cannot be written, or exists and must not be replaced.
    #[error(transparent)]
    Unwritten(#[from] outfile::OutFileError),
    /// The file cannot be read.
    #[error("{}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        #[source]
        cause: std::io::Error,
    },
    /// A file of another format.
    #[error("{} is {what}, not a CSV file: {remedy}", .path.display())]
    NotCsv {
        /// The file.
        path: PathBuf,
        /// The detected format.
        what: String,
        /// How to convert it to a CSV file.
        remedy: String,
    },
    /// A line, or the whole file, that does not follow the format.
    #[error("{}: {fault}", Place(.path, .line))]
    Refused {
        /// The file.
        path: PathBuf,
        /// The line, if one is at fault.
        line: Option<usize>,
        /// The fault, in words.
        fault: String,
    },
    /// A conductance that does not exist.
    #[error("no conductance '{name}': it is neither a file nor one of {}", .known.join(", "))]
    NoSigma {
        /// The name given.
        name: String,
        /// The names in the case.
        known: Vec<String>,
    },
    /// The mesh is faulty.
    #[error("{}: the mesh is refused", Place(.path, .line))]
    Mesh {
        /// The file.
        path: PathBuf,
        /// The line, if known.
        line: Option<usize>,
        /// Why.
        #[source]
        cause: MeshError,
    },
    /// The protocol is faulty.
    #[error("{}: the protocol is refused", .path.display())]
    Protocol {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        cause: ProtocolError,
    },
}

impl CaseError {
    pub(super) fn refused(path: &Path, line: impl Into<Option<usize>>, fault: String) -> Self {
        Self::Refused {
            path: path.to_owned(),
            line: line.into(),
            fault,
        }
    }
}

/// A file, and the line if known.
struct Place<'a>(&'a PathBuf, &'a Option<usize>);

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.display())?;
        self.1.map_or(Ok(()), |line| write!(f, ":{line}"))
    }
}
