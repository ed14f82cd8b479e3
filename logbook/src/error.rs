//! Errors of the logbook, one type for all operations, because callers must distinguish a full disk from a wrong file.

use std::path::{Path, PathBuf};

/// errno of an I/O error, the same on every Unix.
const EIO: i32 = 5;

/// Kinds of disk errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DiskFault {
    /// No space, or no quota: temporary; the file can be written again when there is space.
    Full,
    /// An I/O error: the state on disk is unknown, and this file is not written any more.
    Broken,
    /// Read-only, not permitted, or missing.
    Refused,
}

impl DiskFault {
    /// Advice for the user.
    fn advice(self) -> &'static str {
        match self {
            Self::Full => "free space on the disk; a running session continues by itself",
            Self::Broken => {
                "check the disk (`journalctl -k` shows its errors); a running session continues in a new file"
            }
            Self::Refused => "create its folder, writable for this program",
        }
    }
}

/// An error with the file and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum LogbookError {
    /// The disk refuses writes: full, failing, or read-only. Frames acknowledged before are safe.
    #[error(
        "the disk reports an error: cannot {attempt} {path}; earlier frames are safe; {}", fault.advice()
    )]
    DiskRefused {
        /// The file.
        path: PathBuf,
        /// What was attempted; begins with a verb and precedes the path.
        attempt: &'static str,
        /// The kind of error.
        fault: DiskFault,
        /// Error of the operating system.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// Another process holds a lock on the file, or on the index of its journal: temporary.
    #[error(
        "cannot {attempt} {path}: another program holds a lock on it; close the program that has it open (a database browser?)"
    )]
    Locked {
        /// The file.
        path: PathBuf,
        /// What was attempted.
        attempt: &'static str,
        /// Error of SQLite.
        #[source]
        source: rusqlite::Error,
    },
    /// The open file is no longer the one at its path; everything written to it would be lost.
    #[error("{path} {why} while it was recorded")]
    Gone {
        /// Its former path.
        path: PathBuf,
        /// What happened to it, and to which of its files.
        why: String,
    },
    /// A closed session cannot be written.
    #[error("{path} is closed ({reason}); start a new session")]
    Closed {
        /// The file.
        path: PathBuf,
        /// Why it was closed.
        reason: String,
    },
    /// A part that another part continues cannot be written.
    #[error("{path} continues in {by}; resume that one")]
    Continued {
        /// The file.
        path: PathBuf,
        /// Id of the part that continues it.
        by: String,
    },
    /// The file is not a session.
    #[error("{path} is not a session file: {why}")]
    NotASession {
        /// The file.
        path: PathBuf,
        /// The evidence.
        why: String,
    },
    /// The file was written by another version of this program.
    #[error("{path} has schema {has}, this program reads {reads}; use the version that wrote it")]
    OtherSchema {
        /// The file.
        path: PathBuf,
        /// Its schema version.
        has: i64,
        /// The version that can be read.
        reads: i64,
    },
    /// Another process owns the state directory.
    #[error(
        "another process{} already runs on {dir}; stop it, or configure another state directory",
        pid.map(|pid| format!(" (pid {pid})")).unwrap_or_default()
    )]
    AlreadyRunning {
        /// The directory.
        dir: PathBuf,
        /// Process number of the owner, as recorded in the lock file.
        pid: Option<u32>,
    },
    /// A session of that name exists; sessions are never overwritten.
    #[error("{path} exists already; a session is never overwritten, choose another id")]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// The id is not valid as a file name and D-Bus path.
    #[error("'{id}' cannot name a session: use a to z, 0 to 9 and _ (1 to 100 of them)")]
    BadId {
        /// The given id.
        id: String,
    },
    /// The number of readings differs from the session's protocol.
    #[error("a frame of {has} readings does not fit a session whose protocol has {wants}")]
    WrongLength {
        /// Readings given.
        has: usize,
        /// Readings of the protocol.
        wants: usize,
    },
    /// Readings that the codec refuses.
    #[error(transparent)]
    Readings(#[from] crate::codec::EncodeError),
    /// A time that does not fit 64 bits of nanoseconds.
    #[error("{what} is out of range: wall times reach from 1677 to 2262, durations to 292 years")]
    TimeOutOfRange {
        /// Which time it is.
        what: &'static str,
    },
    /// The file disagrees with its checksum or layout.
    #[error("{path} is damaged at {place}: {why}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Which entry.
        place: String,
        /// What does not agree.
        why: String,
    },
    /// The session has no such frame.
    #[error("{path} has no frame {sequence}; it has {frames}, counted from {first}")]
    NoSuchFrame {
        /// The file.
        path: PathBuf,
        /// The requested sequence.
        sequence: u64,
        /// Number of frames.
        frames: u64,
        /// Sequence of the first frame.
        first: u64,
    },
    /// No session of that name.
    #[error("no session '{requested}' in {dir}; `tactus sessions` lists them")]
    NoSuchSession {
        /// The folder.
        dir: PathBuf,
        /// The requested name.
        requested: String,
    },
    /// Several sessions begin with that prefix.
    #[error("'{requested}' may be any of {candidates} in {dir}; write more characters of the id")]
    Ambiguous {
        /// The folder.
        dir: PathBuf,
        /// The requested prefix.
        requested: String,
        /// Some of them.
        candidates: String,
    },
    /// The folder or file could not be read.
    #[error("cannot {attempt} {path}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was attempted.
        attempt: &'static str,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// Any other error of SQLite.
    #[error("cannot {attempt} {path}")]
    Store {
        /// The file.
        path: PathBuf,
        /// What was attempted.
        attempt: &'static str,
        /// Error of SQLite.
        #[source]
        source: rusqlite::Error,
    },
}

impl LogbookError {
    /// Classifies an error of SQLite on writing.
    pub(crate) fn writing(path: &Path, attempt: &'static str, source: rusqlite::Error) -> Self {
        use rusqlite::ErrorCode::{CannotOpen, DiskFull, ReadOnly, SystemIoFailure};
        if is_lock(&source) {
            return Self::Locked {
                path: path.to_owned(),
                attempt,
                source,
            };
        }
        let fault = match source.sqlite_error_code() {
            Some(DiskFull) => DiskFault::Full,
            Some(SystemIoFailure) => DiskFault::Broken,
            Some(ReadOnly | CannotOpen) => DiskFault::Refused,
            _ => {
                return Self::Store {
                    path: path.to_owned(),
                    attempt,
                    source,
                };
            }
        };
        Self::DiskRefused {
            path: path.to_owned(),
            attempt,
            fault,
            source: Box::new(source),
        }
    }

    /// Classifies an error of the operating system on writing.
    pub(crate) fn disk(path: &Path, attempt: &'static str, source: std::io::Error) -> Self {
        use std::io::ErrorKind::{QuotaExceeded, StorageFull};
        let fault = match source.kind() {
            StorageFull | QuotaExceeded => DiskFault::Full,
            _ if source.raw_os_error() == Some(EIO) => DiskFault::Broken,
            _ => DiskFault::Refused,
        };
        Self::DiskRefused {
            path: path.to_owned(),
            attempt,
            fault,
            source: Box::new(source),
        }
    }

    /// An error of the operating system on reading, or on a folder.
    pub(crate) fn io(path: &Path, attempt: &'static str, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            attempt,
            source,
        }
    }

    /// Classifies an error of SQLite on reading.
    pub(crate) fn reading(path: &Path, attempt: &'static str, source: rusqlite::Error) -> Self {
        use rusqlite::ErrorCode::{DatabaseCorrupt, NotADatabase};
        match source.sqlite_error_code() {
            Some(NotADatabase) => Self::NotASession {
                path: path.to_owned(),
                why: "it is not an SQLite file".into(),
            },
            Some(DatabaseCorrupt) => Self::Damaged {
                path: path.to_owned(),
                place: object_of(attempt).to_owned(),
                why: source.to_string(),
            },
            _ if is_lock(&source) => Self::Locked {
                path: path.to_owned(),
                attempt,
                source,
            },
            _ => Self::Store {
                path: path.to_owned(),
                attempt,
                source,
            },
        }
    }

    /// Whether the disk refused, so that acquisition must stop.
    pub fn is_disk(&self) -> bool {
        self.disk_fault().is_some()
    }

    /// Whether the disk is full: the same writer can continue when there is space again.
    pub fn is_full(&self) -> bool {
        self.disk_fault() == Some(DiskFault::Full)
    }

    /// Whether an I/O error left the file in an unknown state: only [`crate::SessionWriter::successor`] can continue.
    pub fn is_broken(&self) -> bool {
        self.disk_fault() == Some(DiskFault::Broken)
    }

    /// Whether another process holds a lock: the same writer can continue when it is released.
    pub fn is_locked(&self) -> bool {
        matches!(self, Self::Locked { .. })
    }

    /// Whether the file was deleted, moved or replaced: only [`crate::SessionWriter::successor`] can continue.
    pub fn is_gone(&self) -> bool {
        matches!(self, Self::Gone { .. })
    }

    /// Whether the file can be read, and an entry of it is damaged or missing.
    pub fn is_damage(&self) -> bool {
        match self {
            Self::Damaged { .. } | Self::NoSuchFrame { .. } => true,
            // a value of another type than its column's, or larger than the file
            Self::Store { source, .. } => matches!(
                source.sqlite_error_code(),
                None | Some(rusqlite::ErrorCode::TooBig)
            ),
            _ => false,
        }
    }

    /// Whether only [`crate::SessionWriter::successor`] can continue.
    pub fn needs_successor(&self) -> bool {
        self.is_broken() || self.is_gone()
    }

    /// Whether the same writer may continue later: the disk is full, or another process holds a lock.
    pub fn may_pass(&self) -> bool {
        self.is_full() || self.is_locked()
    }

    /// The kind of disk error, if it is one.
    pub fn disk_fault(&self) -> Option<DiskFault> {
        match self {
            Self::DiskRefused { fault, .. } => Some(*fault),
            _ => None,
        }
    }
}

/// Whether SQLite timed out waiting for a lock.
fn is_lock(source: &rusqlite::Error) -> bool {
    use rusqlite::ErrorCode::{DatabaseBusy, DatabaseLocked, FileLockingProtocolFailed};
    matches!(
        source.sqlite_error_code(),
        Some(DatabaseBusy | DatabaseLocked | FileLockingProtocolFailed)
    )
}

/// The object of an attempt: "the frames" of "read the frames of".
fn object_of(attempt: &str) -> &str {
    let object = attempt
        .split_once(' ')
        .map_or(attempt, |(_, object)| object);
    object.strip_suffix(" of").unwrap_or(object)
}

#[cfg(test)]
mod tests {
    use crate::error::*;

    /// Verbs with which the name of an attempt may begin.
    const VERBS: [&str; 14] = [
        "close", "confirm", "copy", "count", "list", "lock", "make", "mark", "merge", "open",
        "read", "remove", "rename", "sync",
    ];

    /// All names of attempts in this crate's source: a string literal before the cause of an error, or before a closure
    /// that reads a row.
    fn attempts() -> Vec<String> {
        let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
        let mut attempts = Vec::new();
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                    continue;
                }
                let text = std::fs::read_to_string(&path).unwrap();
                let text = text.split("#[cfg(test)]").next().unwrap();
                let code = text.lines().map(str::trim);
                let code: Vec<&str> = code.filter(|line| !line.starts_with("//")).collect();
                let text = code.join(" ");
                for cause in ["\", source", "\", |row|"] {
                    for (end, _) in text.match_indices(cause) {
                        let before = &text[..end];
                        attempts.push(before.rsplit('"').next().unwrap().to_owned());
                    }
                }
                for named in text.split("attempt: \"").skip(1) {
                    attempts.push(named.split('"').next().unwrap().to_owned());
                }
            }
        }
        attempts
    }

    #[test]
    fn an_unreadable_file_is_no_damaged_entry() {
        use rusqlite::ffi;
        let of_sqlite = |code| rusqlite::Error::SqliteFailure(ffi::Error::new(code), None);
        for (source, damage) in [
            (of_sqlite(ffi::SQLITE_CORRUPT), true),
            (of_sqlite(ffi::SQLITE_TOOBIG), true),
            (rusqlite::Error::IntegralValueOutOfRange(10, -1), true),
            (of_sqlite(ffi::SQLITE_IOERR_READ), false),
            (of_sqlite(ffi::SQLITE_CANTOPEN), false),
            (of_sqlite(ffi::SQLITE_BUSY), false),
        ] {
            let error = LogbookError::reading(Path::new("m1.tactus"), "read a frame of", source);
            assert_eq!(error.is_damage(), damage, "{error:?}");
        }
    }

    #[test]
    fn every_attempt_reads_as_a_sentence_in_every_error() {
        let attempts = attempts();
        assert!(attempts.len() > 30, "{attempts:?}");
        for attempt in attempts {
            let verb = attempt.split(' ').next().unwrap();
            assert!(
                VERBS.contains(&verb) || verb == "write",
                "'cannot {attempt} FILE' is no sentence"
            );
            assert!(
                !attempt.ends_with(' ') && !attempt.contains('('),
                "{attempt}"
            );
        }
    }

    #[test]
    fn object_of_an_error_is_named_without_its_verb() {
        assert_eq!(object_of("read the frames of"), "the frames");
        assert_eq!(object_of("read the size of"), "the size");
        assert_eq!(object_of("open"), "open");
    }
}
