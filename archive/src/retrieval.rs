//! Takes parts out of the archive, and checks what the store holds against the catalogue.

use std::path::{Path, PathBuf};

use logbook::sha256_of;
use serde::Serialize;

use crate::catalogue::ArchivedPart;
use crate::store::{PartName, Store, StoreError, WholeFileError, write_whole};

/// Why a part cannot be taken out.
#[derive(Debug, thiserror::Error)]
pub enum RetrievalError {
    /// The store refuses.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// What the store holds is not what the catalogue says, or the file cannot be written.
    #[error("{part}")]
    File {
        /// The part.
        part: String,
        /// What is wrong.
        #[source]
        source: WholeFileError,
    },
    /// A row of the catalogue would lead to another folder.
    #[error(
        "'{0}' in the catalogue is not the name of a site, machine, session or part: nothing is read or written"
    )]
    Name(String),
    /// Another file has its name.
    #[error("{} exists already and is not this part: name another folder", .0.display())]
    Exists(PathBuf),
}

/// Whoever may insert rows chooses their names: none may lead out of a folder.
pub(crate) fn check_names(part: &PartName) -> Result<(), RetrievalError> {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-".contains(&byte);
    let is_good = |name: &String| !name.is_empty() && name.len() <= 128 && name.bytes().all(plain);
    let names = [&part.site, &part.daq, &part.session, &part.part];
    match names.into_iter().find(|name| !is_good(name)) {
        None => Ok(()),
        Some(wrong) => Err(RetrievalError::Name(wrong.clone())),
    }
}

/// Writes a part to `folder/PART.tactus`, if it is not there; returns its path.
///
/// # Errors
/// The store does not hold it, or holds something else; the file cannot be written.
pub fn pull(
    store: &dyn Store,
    part: &ArchivedPart,
    folder: &Path,
) -> Result<PathBuf, RetrievalError> {
    let name = &part.name;
    check_names(name)?;
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

/// What the store holds of a part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "state", rename_all = "kebab-case")]
pub enum Holding {
    /// The content that the catalogue names.
    Whole,
    /// Another content.
    Damaged {
        /// Its SHA-256.
        found: String,
    },
    /// Nothing.
    Missing,
}

/// Reads a part in the store and compares its hash with the catalogue's.
///
/// # Errors
/// The store cannot be read.
pub fn verify(store: &dyn Store, part: &ArchivedPart) -> Result<Holding, RetrievalError> {
    let name = &part.name;
    check_names(name)?;
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
        true => Holding::Whole,
        false => Holding::Damaged { found },
    })
}
