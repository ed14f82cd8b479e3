//! Errors of training sets in files.

use std::path::{Path, PathBuf};

use outfile::OutFileError;
use shards::ShardError;

use crate::samples::{SampleError, TrainError};

/// Why a training set or a shard cannot be made or used.
#[derive(Debug, thiserror::Error)]
pub enum DataSetError {
    /// A file or folder is unusable.
    #[error("{}{why}", .path.display())]
    Unusable {
        /// The path.
        path: PathBuf,
        /// The problem and what to do; begins with a colon or a space.
        why: String,
    },
    /// The set cannot be simulated with these settings.
    #[error("the training set")]
    Settings(#[from] TrainError),
    /// A case cannot be solved.
    #[error("the training set")]
    Sample(#[from] SampleError),
    /// A shard that is locked by another process, was made with other settings, was interrupted, or is missing; a file
    /// or folder that cannot be read or written.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// An output file or folder cannot be written, for example because a file exists already.
    #[error(transparent)]
    Output(#[from] OutFileError),
}

impl DataSetError {
    pub(super) fn unusable(path: &Path, why: impl Into<String>) -> Self {
        Self::Unusable {
            path: path.to_owned(),
            why: why.into(),
        }
    }
}
