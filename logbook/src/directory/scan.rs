//! Directory scan: the files that look like sessions, the journals next to them, and the stamps that identify their
//! versions.

use std::collections::BTreeMap;
use std::fs::Metadata;
use std::io::ErrorKind;
use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rustix::fs::{AtFlags, Mode, OFlags, Stat};
use serde::{Deserialize, Serialize};

use crate::LogbookError;
use crate::files::{COPY_EXTENSION, EXTENSION};

/// A file changed within this time before it was read may change again without a change of its stamp: file systems take
/// times from the kernel's clock tick, 10 ms at most.
const SETTLES: Duration = Duration::from_millis(100);

/// Endings of the journals that change what a session's file means.
const JOURNALS: [&str; 2] = ["-wal", "-journal"];

/// Identifies the version of a session that was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Stamp {
    pub(crate) file: FileStamp,
    /// Of the journals next to it, if any.
    pub(crate) journals: Vec<FileStamp>,
}

/// Identifies the version of a file that was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct FileStamp {
    inode: u64,
    pub(crate) bytes: u64,
    /// Modification time of the content (mtime), ns.
    modified: i64,
    /// Change time of content, name, owner or mode (ctime), ns; no program can set it.
    changed: i64,
}

fn ns(seconds: i64, ns: i64) -> i64 {
    seconds.saturating_mul(1_000_000_000).saturating_add(ns)
}

impl FileStamp {
    fn of(found: &Metadata) -> Self {
        Self {
            inode: found.ino(),
            bytes: found.len(),
            modified: ns(found.mtime(), found.mtime_nsec()),
            changed: ns(found.ctime(), found.ctime_nsec()),
        }
    }

    // the types of these fields differ between architectures
    #[allow(clippy::unnecessary_cast)]
    fn of_stat(found: &Stat) -> Self {
        Self {
            inode: found.st_ino as u64,
            bytes: found.st_size as u64,
            modified: ns(found.st_mtime as i64, found.st_mtime_nsec as i64),
            changed: ns(found.st_ctime as i64, found.st_ctime_nsec as i64),
        }
    }

    /// Whether any later change would alter its times.
    fn is_settled(&self, now: i64) -> bool {
        u128::from(now.abs_diff(self.changed)) > SETTLES.as_nanos()
    }
}

impl Stamp {
    /// Whether any later write would alter its times.
    pub(crate) fn is_settled(&self, now: i64) -> bool {
        self.all().all(|file| file.is_settled(now))
    }

    /// Whether the file or a journal was written at this time or later, in ns.
    pub(crate) fn is_written_since(&self, time: i64) -> bool {
        self.all().any(|file| file.modified >= time)
    }

    fn all(&self) -> impl Iterator<Item = &FileStamp> {
        std::iter::once(&self.file).chain(&self.journals)
    }
}

/// The relevant names in a folder.
#[derive(Debug)]
pub(crate) struct Names {
    /// Stamp of the folder, if every later change of the folder will alter it.
    folder: Option<FileStamp>,
    /// Files that look like sessions, each with the names of its journals.
    sessions: BTreeMap<String, Vec<String>>,
    /// Unfinished copies of sessions, left by a killed writer.
    copies: Vec<String>,
}

/// A file that looks like a session.
pub(crate) struct Candidate<'a> {
    pub(crate) name: &'a str,
    pub(crate) stamp: Stamp,
    /// Whether there is a write-ahead log next to it.
    pub(crate) has_wal: bool,
}

impl Names {
    /// The names in a folder; reuses the last scan if the folder has not changed since. A missing folder has none.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn of(dir: &Path, last: Option<Arc<Self>>) -> Result<Arc<Self>, LogbookError> {
        let failed = |source| LogbookError::io(dir, "list", source);
        let folder = match std::fs::metadata(dir) {
            Ok(found) => FileStamp::of(&found),
            Err(absent) if absent.kind() == ErrorKind::NotFound => {
                return Ok(Arc::new(Self {
                    folder: None,
                    sessions: BTreeMap::new(),
                    copies: Vec::new(),
                }));
            }
            Err(source) => return Err(failed(source)),
        };
        if let Some(last) = last
            && last.folder.as_ref() == Some(&folder)
        {
            return Ok(last);
        }
        let settled = folder.is_settled(now());
        let mut sessions = BTreeMap::new();
        let (mut journals, mut copies) = (Vec::new(), Vec::new());
        for entry in std::fs::read_dir(dir).map_err(failed)? {
            let name = entry.map_err(failed)?.file_name();
            let Ok(name) = name.into_string() else {
                continue;
            };
            let ends = |end: &str| Path::new(&name).extension().is_some_and(|is| is == end);
            if ends(COPY_EXTENSION) {
                copies.push(name);
            } else if ends(EXTENSION) {
                sessions.insert(name, Vec::new());
            } else if JOURNALS.iter().any(|end| name.ends_with(end)) {
                journals.push(name);
            }
        }
        // in the order of `JOURNALS`, so that two scans give the same stamp
        for end in JOURNALS {
            for journal in &journals {
                if let Some(session) = journal.strip_suffix(end)
                    && let Some(beside) = sessions.get_mut(session)
                {
                    beside.push(journal.clone());
                }
            }
        }
        copies.sort();
        Ok(Arc::new(Self {
            folder: settled.then_some(folder),
            sessions,
            copies,
        }))
    }

    pub(crate) fn contains(&self, name: &str) -> bool {
        self.sessions.contains_key(name)
    }

    /// Names of unfinished copies, left by a killed writer.
    pub(crate) fn copies(&self) -> &[String] {
        &self.copies
    }

    /// The current files that look like sessions, by name; files removed since the scan are skipped.
    ///
    /// # Errors
    /// The folder cannot be opened.
    pub(crate) fn candidates(&self, dir: &Path) -> Result<Vec<Candidate<'_>>, LogbookError> {
        if self.sessions.is_empty() {
            return Ok(Vec::new());
        }
        // names are looked up relative to this descriptor, so that the folder's path is resolved once
        let folder: OwnedFd = rustix::fs::open(
            dir,
            OFlags::PATH | OFlags::DIRECTORY | OFlags::CLOEXEC,
            Mode::empty(),
        )
        .map_err(|source| LogbookError::io(dir, "list", source.into()))?;
        let stamp = |name: &str| {
            let found = rustix::fs::statat(&folder, name, AtFlags::empty()).ok()?;
            Some(FileStamp::of_stat(&found))
        };
        let candidates = self.sessions.iter().filter_map(|(name, journals)| {
            Some(Candidate {
                name,
                stamp: Stamp {
                    file: stamp(name)?,
                    journals: journals.iter().filter_map(|name| stamp(name)).collect(),
                },
                has_wal: journals.iter().any(|name| name.ends_with("-wal")),
            })
        });
        Ok(candidates.collect())
    }
}

/// The clock that file stamps use; files not settled are read again, so a wrong clock costs only time.
pub(crate) fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| {
        i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
    })
}
