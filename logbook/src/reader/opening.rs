//! Opens a session's file without changing it or its companion files, whatever wrote it.
//!
//! | the file is | access |
//! |---|---|
//! | in rollback mode: closed and merged | `immutable`: no locks, and journals next to it are ignored |
//! | in WAL mode, its journal empty or missing, or without a header | the same |
//! | in WAL mode, with journal and index | read-only with a read-only index: sees what its writer has acknowledged |
//! | in WAL mode, with a journal but no index | the index is built in memory |
//! | in WAL mode, the header of its journal damaged | refused |
//!
//! A rollback journal is never applied: a session is in WAL mode from before its header until after its last entry,
//! so a rollback journal next to it cannot belong to its content.

use std::fs::{File, Metadata};
use std::io::{ErrorKind, Read};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, OpenFlags};

use super::log_header::{self, LogHeader};
use crate::LogbookError;
use crate::files::open_files::unless_being_written;
use crate::files::{companion, open_at_once};

/// The beginning of every SQLite file.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";
/// Bytes of SQLite's header that are checked.
const HEAD: usize = 100;
/// Offset of the header's read version: 1 with a rollback journal, 2 with a write-ahead log.
const READ_VERSION: usize = 19;
/// The longest text or blob of a row, bytes: the protocol of 256 electrodes takes 4 MB.
const LONGEST: u64 = 16 << 20;
/// Lower bound of the limit: even a small file must hold its schema.
const SHORTEST: u64 = 1 << 20;
/// The longest statement, and the longest entry of a schema, bytes.
const SQL: i32 = 20_000;

/// Journal mode according to the file's header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum JournalMode {
    /// Merged: complete without a journal.
    Rollback,
    /// The journal next to it is part of it.
    Wal,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum AccessMethod {
    Immutable,
    WithIndex,
    IndexInMemory,
}

/// An opened file.
pub(crate) struct Opened {
    pub(crate) connection: Connection,
    pub(crate) mode: JournalMode,
}

/// Opens a file for reading.
///
/// # Errors
/// The file is missing, not a regular file, not an SQLite file, an open session with a rollback journal next to it, or
/// one whose journal has a damaged header.
pub(crate) fn open(
    path: &Path,
    is_closed: impl Fn(&Connection) -> bool,
) -> Result<Opened, LogbookError> {
    let io = |source| LogbookError::io(path, "open", source);
    // SQLite looks for a journal next to the file itself, not next to a symbolic link to it.
    let real = std::fs::canonicalize(path).map_err(io)?;
    let found = std::fs::metadata(&real).map_err(io)?;
    check_regular(path, &found)?;
    let mode = match unless_being_written(&found, || look(path, &real)) {
        Some(mode) => mode?,
        None => JournalMode::Wal,
    };
    let [journal, wal, index] = ["-journal", "-wal", "-shm"].map(|end| companion(&real, end));
    if mode == JournalMode::Wal {
        for beside in [&wal, &index] {
            if let Ok(found) = std::fs::metadata(beside) {
                check_regular(beside, &found)?;
            }
        }
    }
    let log = match mode {
        JournalMode::Rollback => LogHeader::Empty,
        JournalMode::Wal => {
            log_header::of(&wal).map_err(|source| LogbookError::io(&wal, "read", source))?
        }
    };
    let way = match log {
        LogHeader::Empty => AccessMethod::Immutable,
        LogHeader::Intact if index.exists() => AccessMethod::WithIndex,
        LogHeader::Intact => AccessMethod::IndexInMemory,
        LogHeader::Damaged => {
            return Err(LogbookError::Damaged {
                path: path.to_owned(),
                place: "its journal".into(),
                why: format!(
                    "the first {} bytes of {} are not those of a journal; move that file away to read the frames that \
                     the session's own file holds",
                    log_header::LENGTH,
                    wal.display()
                ),
            });
        }
    };
    let size = found.len() + std::fs::metadata(&wal).map_or(0, |found| found.len());
    if way != AccessMethod::Immutable && journal.symlink_metadata().is_ok() {
        // If the closing entry is in the file itself, a power cut interrupted the merge: the file is complete.
        let alone = connect(path, &real, AccessMethod::Immutable, size)?;
        if is_closed(&alone) {
            return Ok(Opened {
                connection: alone,
                mode,
            });
        }
        return Err(LogbookError::Damaged {
            path: path.to_owned(),
            place: "its folder".into(),
            why: format!(
                "{} is next to it, and a session that is being written has no such file; move that file away",
                journal.display()
            ),
        });
    }
    let connection = connect(path, &real, way, size)?;
    Ok(Opened { connection, mode })
}

/// Opens a merged file that has lost its end; reading a missing page is an error.
///
/// # Errors
/// As [`open`].
pub(super) fn without_end(path: &Path) -> Result<Connection, LogbookError> {
    let size = std::fs::metadata(path).map_or(0, |found| found.len());
    let connection = connect(path, path, AccessMethod::Immutable, size)?;
    let lenient = || -> rusqlite::Result<()> {
        // SQLite refuses a file shorter than its header states, unless its schema may be edited
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, false)?;
        connection.pragma_update(None, "writable_schema", true)
    };
    lenient().map_err(|source| LogbookError::reading(path, "open", source))?;
    Ok(connection)
}

/// Refuses anything but a regular file: opening a FIFO would wait for its other end.
pub(crate) fn check_regular(path: &Path, found: &Metadata) -> Result<(), LogbookError> {
    let kind = found.file_type();
    let what = match kind {
        _ if kind.is_file() => return Ok(()),
        _ if kind.is_dir() => "a folder",
        _ if kind.is_fifo() => "a FIFO",
        _ if kind.is_socket() => "a socket",
        _ if kind.is_char_device() || kind.is_block_device() => "a device",
        _ => "no regular file",
    };
    Err(LogbookError::NotASession {
        path: path.to_owned(),
        why: format!("it is {what}"),
    })
}

fn look(path: &Path, real: &Path) -> Result<JournalMode, LogbookError> {
    let io = |source| LogbookError::io(path, "open", source);
    let refused = |why: &str| LogbookError::NotASession {
        path: path.to_owned(),
        why: why.to_owned(),
    };
    let mut file = open_at_once(real).map_err(io)?;
    check_regular(path, &file.metadata().map_err(io)?)?;
    let mut head = [0; HEAD];
    match file.read_exact(&mut head) {
        Ok(()) => {}
        Err(short) if short.kind() == ErrorKind::UnexpectedEof => {
            let empty = file.metadata().map_err(io)?.len() == 0;
            return Err(refused(if empty {
                "it is empty (or its writer was killed before the header was written)"
            } else {
                "it is not an SQLite file"
            }));
        }
        Err(source) => return Err(io(source)),
    }
    if !head.starts_with(MAGIC) {
        return Err(refused("it is not an SQLite file"));
    }
    Ok(match head[READ_VERSION] {
        1 => JournalMode::Rollback,
        _ => JournalMode::Wal,
    })
}

fn connect(
    path: &Path,
    real: &Path,
    way: AccessMethod,
    size: u64,
) -> Result<Connection, LogbookError> {
    let open = || -> rusqlite::Result<Connection> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
            | OpenFlags::SQLITE_OPEN_NO_MUTEX
            | OpenFlags::SQLITE_OPEN_URI;
        let parameters = match way {
            AccessMethod::Immutable => "immutable=1",
            AccessMethod::WithIndex => "readonly_shm=1",
            // a VFS without locks: SQLite builds the index in memory only with exclusive access
            AccessMethod::IndexInMemory => "vfs=unix-none",
        };
        let connection = Connection::open_with_flags(uri(real, parameters), flags)?;
        limit(&connection, size)?;
        if way == AccessMethod::IndexInMemory {
            connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
        }
        Ok(connection)
    };
    open().map_err(|source| LogbookError::reading(path, "open", source))
}

/// Disables features of SQLite that sessions do not need, to reduce the attack surface for malicious files.
fn limit(connection: &Connection, size: u64) -> rusqlite::Result<()> {
    use DbConfig::{
        SQLITE_DBCONFIG_DEFENSIVE, SQLITE_DBCONFIG_ENABLE_TRIGGER, SQLITE_DBCONFIG_ENABLE_VIEW,
        SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, SQLITE_DBCONFIG_TRUSTED_SCHEMA,
    };
    for (what, on) in [
        (SQLITE_DBCONFIG_DEFENSIVE, true),
        (SQLITE_DBCONFIG_TRUSTED_SCHEMA, false),
        (SQLITE_DBCONFIG_ENABLE_VIEW, false),
        (SQLITE_DBCONFIG_ENABLE_TRIGGER, false),
        (SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true),
    ] {
        connection.set_db_config(what, on)?;
    }
    // no row is longer than the file
    let longest = size.clamp(SHORTEST, LONGEST) as i32;
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, longest)?;
    connection.set_limit(Limit::SQLITE_LIMIT_SQL_LENGTH, SQL)?;
    connection.set_limit(Limit::SQLITE_LIMIT_ATTACHED, 0)?;
    connection.pragma_update(None, "mmap_size", 0)?;
    connection.pragma_update(None, "cell_size_check", true)?;
    connection.pragma_update(None, "temp_store", "MEMORY")
}

/// Place of the damage in a file that is shorter than its header states.
pub(super) const END: &str = "its end";

/// The error for a file that is shorter than its header states; `None` if it is not.
pub(super) fn missing_end(path: &Path) -> Option<LogbookError> {
    let mut head = [0; HEAD];
    let mut file = File::open(path).ok()?;
    file.read_exact(&mut head).ok()?;
    let there = file.metadata().ok()?.len();
    let number = |at: usize, bytes: usize| -> u64 {
        let digits = head[at..at + bytes].iter();
        digits.fold(0, |number, byte| number << 8 | u64::from(*byte))
    };
    // size and number of pages; https://www.sqlite.org/fileformat.html
    let whole = number(16, 2) * number(28, 4);
    (there < whole).then(|| LogbookError::Damaged {
        path: path.to_owned(),
        place: END.into(),
        why: format!(
            "{there} of its {whole} bytes are there; take the file from a copy, or copy the frames that are there with \
             `tactus sessions repair`"
        ),
    })
}

/// `file:` and the path, with all URI metacharacters escaped.
fn uri(path: &Path, parameters: &str) -> PathBuf {
    let mut uri = String::from("file:");
    for &byte in path.as_os_str().as_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'-' | b'_' | b'.' | b'~' => {
                uri.push(char::from(byte));
            }
            _ => uri.push_str(&format!("%{byte:02X}")),
        }
    }
    uri.push('?');
    uri.push_str(parameters);
    uri.into()
}
