//! The files of sessions: their names, their parts, SQLite's companion files, and the files that this process writes.
//! Their content is handled by `reader` and `writer`.

pub(crate) mod lines;
pub(crate) mod open_files;

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;

use crate::LogbookError;

/// How a session's file name ends.
pub(crate) const EXTENSION: &str = "tactus";
/// Extension of an unfinished copy; see [`crate::SessionWriter::rescue`].
pub(crate) const COPY_EXTENSION: &str = "rescue";

/// The file of a session or part.
pub(crate) fn path_of(dir: &Path, id: &str) -> PathBuf {
    dir.join(format!("{id}.{EXTENSION}"))
}

/// The session that a part belongs to, and its number: 1 for the first, which is named like the session.
pub fn part_of(id: &str) -> (&str, u32) {
    id.rsplit_once("_p")
        .and_then(|(session, number)| {
            let number = number.parse().ok().filter(|number| *number > 1)?;
            Some((session, number))
        })
        .unwrap_or((id, 1))
}

/// The entries of a folder; a missing folder has none.
pub(crate) fn entries(dir: &Path) -> Result<Vec<PathBuf>, LogbookError> {
    let failed = |source| LogbookError::io(dir, "list", source);
    let entries = match std::fs::read_dir(dir) {
        Ok(entries) => entries,
        Err(absent) if absent.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(failed(source)),
    };
    entries
        .map(|entry| Ok(entry.map_err(failed)?.path()))
        .collect()
}

/// The session files and parts in a folder, by name.
pub(crate) fn in_folder(dir: &Path) -> Result<Vec<PathBuf>, LogbookError> {
    let mut files = entries(dir)?;
    files.retain(|path| path.extension().is_some_and(|end| end == EXTENSION));
    files.sort();
    Ok(files)
}

pub(crate) fn id_of(path: &Path) -> &str {
    path.file_stem()
        .and_then(|stem| stem.to_str())
        .unwrap_or_default()
}

/// Opens a file for reading without waiting, should a FIFO or a terminal have replaced it.
pub(crate) fn open_at_once(path: &Path) -> std::io::Result<File> {
    let flags = OFlags::NONBLOCK | OFlags::NOCTTY;
    OpenOptions::new()
        .read(true)
        .custom_flags(flags.bits() as i32)
        .open(path)
}

/// `<file>-wal` and the like, as SQLite names them.
pub(crate) fn companion(path: &Path, end: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(end);
    name.into()
}

/// The existing files of the session that a file is a part of, in order.
///
/// # Errors
/// The folder cannot be read.
pub fn parts(path: impl AsRef<Path>) -> Result<Vec<PathBuf>, LogbookError> {
    let path = path.as_ref();
    // not id_of: names that are not UTF-8 would all be parts of one session
    let name = |path: &Path| -> String {
        let stem = path.file_stem().unwrap_or_default();
        stem.to_string_lossy().into_owned()
    };
    let own = name(path);
    let session = part_of(&own).0;
    let mut parts = in_folder(outfile::folder_of(path))?;
    parts.retain(|other| part_of(&name(other)).0 == session);
    parts.sort_by_key(|other| part_of(&name(other)).1);
    Ok(parts)
}
