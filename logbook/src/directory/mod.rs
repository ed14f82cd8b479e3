//! The folder of sessions.

pub(crate) mod index;
mod index_file;
pub(crate) mod lock;
pub(crate) mod scan;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::files::{self, id_of, part_of};
use crate::{Index, LogbookError, SessionSummary};

/// The content of a folder.
#[derive(Debug, Default)]
pub struct Listing {
    /// Sessions, the oldest first.
    pub sessions: Vec<SessionSummary>,
    /// Files that look like sessions and cannot be read.
    pub unreadable: Vec<Unreadable>,
}

/// A file that looks like a session and cannot be read.
#[derive(Debug)]
pub struct Unreadable {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub why: Arc<LogbookError>,
}

/// Lists the sessions of a folder by start time; a missing folder holds none. Unreadable files are listed separately.
///
/// # Errors
/// The folder cannot be read.
pub fn list(dir: impl AsRef<Path>) -> Result<Listing, LogbookError> {
    Ok(index(dir)?.listing())
}

/// The up-to-date index of a folder; unchanged sessions are not opened again.
pub(crate) fn index(dir: impl AsRef<Path>) -> Result<Index, LogbookError> {
    let mut index = Index::load(dir);
    index.refresh()?;
    Ok(index)
}

/// Sessions that were not closed and that no other part continues, newest first: those that may be resumed.
///
/// # Errors
/// The folder cannot be read.
pub fn interrupted(dir: impl AsRef<Path>) -> Result<Vec<SessionSummary>, LogbookError> {
    Ok(index(dir)?.interrupted())
}

/// Finds a session's file by its id or a unique prefix of it. For a session in parts, returns the first part.
///
/// # Errors
/// No session of that name, or several.
pub fn find(dir: impl AsRef<Path>, id_or_prefix: &str) -> Result<PathBuf, LogbookError> {
    let dir = dir.as_ref();
    let mut matching = Vec::new();
    for path in files::in_folder(dir)? {
        let id = id_of(&path);
        if id == id_or_prefix {
            return Ok(path);
        }
        if id.starts_with(id_or_prefix) {
            matching.push(path);
        }
    }
    matching.sort_by(|a, b| part_of(id_of(a)).cmp(&part_of(id_of(b))));
    if let [first, others @ ..] = matching.as_slice() {
        let session = part_of(id_of(first)).0;
        if others
            .iter()
            .all(|other| part_of(id_of(other)).0 == session)
        {
            return Ok(first.clone());
        }
    }
    match matching.as_slice() {
        [] => Err(LogbookError::NoSuchSession {
            dir: dir.to_owned(),
            requested: id_or_prefix.to_owned(),
        }),
        several => {
            let mut candidates: Vec<&str> =
                several.iter().take(5).map(|path| id_of(path)).collect();
            if several.len() > candidates.len() {
                candidates.push("...");
            }
            Err(LogbookError::Ambiguous {
                dir: dir.to_owned(),
                requested: id_or_prefix.to_owned(),
                candidates: candidates.join(", "),
            })
        }
    }
}
