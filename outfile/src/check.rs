//! Checks which paths may be written, and how.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::OFlags;

use crate::{Existing, OutFileError};

/// The first bytes of every SQLite database, and so of every session. The main file of a running session may contain
/// nothing more yet.
const DATABASE: &[u8; 16] = b"SQLite format 3\0";
/// Endings of a session's files: its own, and those of SQLite's companion files.
const SESSION_ENDINGS: [&str; 4] = [".tactus", ".tactus-wal", ".tactus-shm", ".tactus-journal"];

/// How a path will be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Target {
    /// The name does not exist.
    New,
    /// A regular file or a link exists and is replaced.
    Replaced,
    /// A device, a FIFO or a standard stream: bytes are written to it directly.
    Stream(Stream),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stream {
    Named,
    Output,
    Error,
}

/// Refuses a path that [`crate::write`] would refuse, for a check before the work starts.
///
/// # Errors
/// See [`OutFileError`].
pub fn check(path: &Path, existing: Existing) -> Result<(), OutFileError> {
    target(path, existing)?;
    let folder = folder_of(path);
    match std::fs::metadata(folder) {
        Ok(found) if found.is_dir() => Ok(()),
        Ok(_) => Err(OutFileError::NotFolder(folder.to_owned())),
        Err(cause) => Err(OutFileError::io(path)(cause)),
    }
}

/// Refuses a folder that is a file, contains files (unless they may be replaced), or is reached through another user's
/// link.
///
/// # Errors
/// See [`OutFileError`].
pub fn check_folder(path: &Path, existing: Existing) -> Result<(), OutFileError> {
    refuse_foreign(path)?;
    match std::fs::read_dir(path) {
        Ok(mut entries) => match (existing, entries.next()) {
            (Existing::Replace, _) | (_, None) => Ok(()),
            (Existing::Refuse, Some(_)) => Err(OutFileError::NotEmpty(path.to_owned())),
        },
        Err(cause) if cause.kind() == ErrorKind::NotFound => Ok(()),
        Err(cause) if cause.kind() == ErrorKind::NotADirectory => {
            Err(OutFileError::NotFolder(path.to_owned()))
        }
        Err(cause) => Err(OutFileError::io(path)(cause)),
    }
}

/// Whether the path is a device, a FIFO or a standard stream: no companion file can be written next to it.
pub fn is_stream(path: &Path) -> bool {
    matches!(target(path, Existing::Refuse), Ok(Target::Stream(_)))
}

pub(crate) fn target(path: &Path, existing: Existing) -> Result<Target, OutFileError> {
    if let Some(stream) = standard_stream(path) {
        return Ok(Target::Stream(stream));
    }
    refuse_foreign(path)?;
    let link = match std::fs::symlink_metadata(path) {
        Ok(found) => found,
        Err(cause) if cause.kind() == ErrorKind::NotFound => {
            return match (path.file_name(), is_session_name(path)) {
                (None, _) => Err(OutFileError::Folder(path.to_owned())),
                (_, true) => Err(OutFileError::SessionName(path.to_owned())),
                _ => Ok(Target::New),
            };
        }
        Err(cause) => return Err(OutFileError::io(path)(cause)),
    };
    let found = match std::fs::metadata(path) {
        Ok(found) => found,
        // a dangling link is an existing name
        Err(cause) if cause.kind() == ErrorKind::NotFound => link,
        Err(cause) => return Err(OutFileError::io(path)(cause)),
    };
    let kind = found.file_type();
    if kind.is_char_device() || kind.is_fifo() {
        return Ok(Target::Stream(Stream::Named));
    }
    if kind.is_dir() {
        return Err(OutFileError::Folder(path.to_owned()));
    }
    if kind.is_block_device() || kind.is_socket() {
        return Err(OutFileError::Special(path.to_owned()));
    }
    if existing == Existing::Refuse {
        return Err(OutFileError::Exists(path.to_owned()));
    }
    if is_session_name(path) {
        return Err(OutFileError::SessionName(path.to_owned()));
    }
    if kind.is_file() && is_database(path).map_err(OutFileError::io(path))? {
        return Err(OutFileError::Session(path.to_owned()));
    }
    Ok(Target::Replaced)
}

/// Opens a device or FIFO; refuses any other kind of file that has its name by now.
pub(crate) fn open_stream(path: &Path) -> Result<File, OutFileError> {
    let flags = OFlags::NOCTTY | OFlags::CLOEXEC;
    let file = OpenOptions::new()
        .write(true)
        .custom_flags(flags.bits() as i32)
        .open(path)
        .map_err(OutFileError::io(path))?;
    let kind = file.metadata().map_err(OutFileError::io(path))?.file_type();
    if kind.is_char_device() || kind.is_fifo() {
        Ok(file)
    } else {
        Err(OutFileError::Exists(path.to_owned()))
    }
}

/// The folder of a path; `.` for a name without a folder.
pub fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder.as_os_str().is_empty() => Path::new("."),
        Some(folder) => folder,
        None => path,
    }
}

/// Recognises `/dev/stdout` and similar names of an open standard stream. Replacing the name, or the file to which the
/// shell has redirected the stream, would lose other output.
fn standard_stream(path: &Path) -> Option<Stream> {
    let mut place = path.to_owned();
    for _ in 0..8 {
        let folder = std::fs::canonicalize(folder_of(&place)).ok()?;
        if folder.starts_with("/proc") && folder.ends_with("fd") {
            let own = std::fs::canonicalize("/proc/self/fd").is_ok_and(|own| own == folder);
            return match place.file_name()?.to_str()? {
                "1" if own => Some(Stream::Output),
                "2" if own => Some(Stream::Error),
                _ => None,
            };
        }
        place = folder.join(std::fs::read_link(folder.join(place.file_name()?)).ok()?);
    }
    None
}

/// Refuses a path through a link or FIFO that another user (except root) made in a folder that everybody may write to.
fn refuse_foreign(path: &Path) -> Result<(), OutFileError> {
    let user = rustix::process::geteuid().as_raw();
    let whole = std::path::absolute(path).map_err(OutFileError::io(path))?;
    for place in whole.ancestors() {
        let foreign = |found: &Metadata| {
            let kind = found.file_type();
            (kind.is_symlink() || kind.is_fifo()) && ![0, user].contains(&found.uid())
        };
        let shared = |folder: &Path| {
            std::fs::metadata(folder).is_ok_and(|folder| folder.mode() & 0o002 != 0)
        };
        if std::fs::symlink_metadata(place).is_ok_and(|found| foreign(&found))
            && place.parent().is_some_and(shared)
        {
            return Err(OutFileError::Foreign {
                path: path.to_owned(),
                link: PathBuf::from(place),
            });
        }
    }
    Ok(())
}

fn is_session_name(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    SESSION_ENDINGS.iter().any(|ending| name.ends_with(ending))
}

fn is_database(path: &Path) -> std::io::Result<bool> {
    let file = OpenOptions::new()
        .read(true)
        // a FIFO that has taken the name since must not block the program
        .custom_flags((OFlags::NONBLOCK | OFlags::CLOEXEC).bits() as i32)
        .open(path)?;
    let mut begin = Vec::new();
    file.take(DATABASE.len() as u64).read_to_end(&mut begin)?;
    Ok(begin == DATABASE)
}
