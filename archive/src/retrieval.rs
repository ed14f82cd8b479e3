//! Copies parts from the archive, and compares the content of the store with the catalogue.

use std::path::{Path, PathBuf};

use logbook::sha256_of;
use serde::Serialize;

use crate::catalogue::ArchivedPart;
use crate::store::{PartName, Store, StoreError, WholeFileError, write_whole};

/// Why a part cannot be copied from the archive.
#[derive(Debug, thiserror::Error)]
pub enum RetrievalError {
    /// The store refuses.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The content of the store differs from the catalogue, or the file cannot be written.
    #[error("{part}")]
    File {
        /// The part.
        part: String,
        /// What is wrong.
        #[source]
        source: WholeFileError,
    },
    /// A name in the catalogue could lead out of the folder.
    #[error(
        "'{0}' in the catalogue is not the name of a site, machine, session or part: nothing is read or written"
    )]
    Name(String),
    /// Another file of its name exists.
    #[error("{} exists already and is not this part: name another folder", .0.display())]
    Exists(PathBuf),
}

/// Checks the names of a part, see [`check_names`].
pub(crate) fn check_part(part: &PartName) -> Result<(), RetrievalError> {
    check_names([&part.site, &part.daq, &part.session, &part.part])
}

/// Checks names of the catalogue: any role that may insert rows chooses them, and none may lead out of a folder.
pub(crate) fn check_names<const N: usize>(names: [&String; N]) -> Result<(), RetrievalError> {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-".contains(&byte);
    let is_good = |name: &String| !name.is_empty() && name.len() <= 128 && name.bytes().all(plain);
    match names.into_iter().find(|name| !is_good(name)) {
        None => Ok(()),
        Some(wrong) => Err(RetrievalError::Name(wrong.clone())),
    }
}

/// Copies a part to `folder/PART.tactus`, unless it exists there; returns its path.
///
/// # Errors
/// The store lacks the part, or has another content; the file cannot be written; another file of that name exists.
pub fn pull(
    store: &dyn Store,
    part: &ArchivedPart,
    folder: &Path,
) -> Result<PathBuf, RetrievalError> {
    let name = &part.name;
    check_part(name)?;
    let path = folder.join(format!("{}.tactus", name.part));
    let file = |source| RetrievalError::File {
        part: name.part.clone(),
        source,
    };
    if !path.exists() {
        let mut from = store.open(name)?;
        match write_whole(&mut from, &path, &name.sha256) {
            Err(WholeFileError::Exists(_)) => {}
            written => return written.map(|_| path).map_err(file),
        }
    }
    let there = std::fs::File::open(&path).and_then(sha256_of);
    match there {
        Ok((found, _)) if found == name.sha256 => Ok(path),
        _ => Err(RetrievalError::Exists(path)),
    }
}

/// The state of a part in the store.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum Holding {
    /// The content that the catalogue names.
    Intact,
    /// Another content.
    Damaged {
        /// Its SHA-256.
        found: String,
    },
    /// The store lacks it.
    Missing,
}

/// Reads a part from the store and compares its hash with the catalogue's.
///
/// # Errors
/// The store cannot be read.
pub fn verify(store: &dyn Store, part: &ArchivedPart) -> Result<Holding, RetrievalError> {
    let name = &part.name;
    check_part(name)?;
    let from = match store.open(name) {
        Ok(from) => from,
        Err(StoreError::Missing { .. }) => return Ok(Holding::Missing),
        Err(error) => return Err(error.into()),
    };
    let (found, _) = sha256_of(from).map_err(|source| StoreError::Io {
        path: name.to_string().into(),
        attempt: "read",
        source,
    })?;
    Ok(match found == name.sha256 {
        true => Holding::Intact,
        false => Holding::Damaged { found },
    })
}
