//! Checks after a write that the open file is still the one at its path, because writes to a deleted or moved file
//! succeed and are lost, and that its filesystem still accepts changes.

use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use rusqlite::{Connection, params};

use rustix::io::Errno;

use crate::error::{DiskFault, LogbookError};
use crate::files::{COPY_EXTENSION, EXTENSION, companion};
use crate::writer::SessionWriter;
use outfile::folder_of;

/// Maximum number of bytes copied while acquisition waits.
const MOST_COPIED: u64 = 1 << 30;

/// The files that SQLite writes for a session.
const FILES: [&str; 3] = ["", "-wal", "-shm"];

/// Device and inode of the file and of its companions.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct FilePlace([Option<(u64, u64)>; FILES.len()]);

impl FilePlace {
    /// The current identity. Uses `stat` only: closing a descriptor of a file that SQLite has open would drop its
    /// locks.
    pub(super) fn of(path: &Path) -> Self {
        Self(FILES.map(|end| {
            let found = std::fs::metadata(companion(path, end)).ok()?;
            Some((found.dev(), found.ino()))
        }))
    }

    /// Checks that they are unchanged.
    pub(super) fn check(&self, path: &Path) -> Result<(), LogbookError> {
        let now = Self::of(path);
        for ((end, was), is) in FILES.iter().zip(&self.0).zip(&now.0) {
            let why = match (was, is) {
                (Some(was), Some(is)) if was != is => "was replaced by another file",
                (Some(_), None) => "was deleted or moved",
                _ => continue,
            };
            let why = match *end {
                "" => why.to_owned(),
                end => format!("has lost its {end} file, which {why}"),
            };
            return Err(LogbookError::Gone {
                path: path.to_owned(),
                why,
            });
        }
        Ok(())
    }
}

/// Checks that the filesystem of a file still accepts changes. `fdatasync` is not enough: when ext4 aborts its
/// journal after an error, a sync in progress may return success although its transaction was never committed.
/// Removing an attribute that does not exist begins a transaction, which an aborted journal refuses, and changes
/// nothing.
fn check_filesystem(path: &Path) -> Result<(), LogbookError> {
    let refused = match rustix::fs::removexattr(path, "user.tactus.absent") {
        Err(refused @ (Errno::ROFS | Errno::IO | Errno::UCLEAN | Errno::SHUTDOWN)) => refused,
        // usually `NODATA`; `OPNOTSUPP` and other errors do not concern the last sync
        _ => return Ok(()),
    };
    Err(LogbookError::DiskRefused {
        path: path.to_owned(),
        attempt: "confirm the sync of",
        fault: DiskFault::Broken,
        source: Box::new(std::io::Error::from(refused)),
    })
}

impl SessionWriter {
    /// Checks what was just written before it is acknowledged.
    pub(super) fn check_written(&mut self) -> Result<(), LogbookError> {
        self.place.check(&self.path)?;
        check_filesystem(&self.path).inspect_err(|_| self.broken = true)
    }

    /// Checks that the open file is still the one at its path; also checked after each write.
    ///
    /// # Errors
    /// [`LogbookError::Gone`].
    pub fn check_place(&self) -> Result<(), LogbookError> {
        self.place.check(&self.path)
    }

    /// Copies a deleted or moved file, which this writer still has open, and puts the copy at the original path, or
    /// next to it if another file is there. If only a companion file was lost, its content is moved into the file.
    /// Returns the path of the file with the frames.
    ///
    /// # Errors
    /// The disk refuses the copy, the file can no longer be read, or it is too large to be copied during a session.
    pub fn rescue(&self) -> Result<PathBuf, LogbookError> {
        if FilePlace::of(&self.path).0[0] == self.place.0[0] {
            let merged = self
                .connection
                .query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
            merged.map_err(|source| {
                LogbookError::writing(&self.path, "merge the journal into", source)
            })?;
            return Ok(self.path.clone());
        }
        let folder = folder_of(&self.path);
        crate::writer::make_folder(folder)
            .map_err(|source| LogbookError::disk(&self.path, "make the folder of", source))?;
        let beside = self.path.with_extension(COPY_EXTENSION);
        let _ = std::fs::remove_file(&beside);
        let copied = self.copy_to(&beside);
        let placed = copied.and_then(|()| self.move_copy(&beside));
        placed.inspect_err(|_| {
            let _ = std::fs::remove_file(&beside);
        })
    }

    fn copy_to(&self, beside: &Path) -> Result<(), LogbookError> {
        let failed = |source| LogbookError::writing(&self.path, "copy", source);
        let size = "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size";
        let size: i64 = self
            .connection
            .query_row(size, [], |row| row.get(0))
            .map_err(failed)?;
        if size.unsigned_abs() > MOST_COPIED {
            return Err(LogbookError::Gone {
                path: self.path.clone(),
                why: format!("has {size} bytes, too many to be copied,"),
            });
        }
        let to = beside.to_string_lossy();
        self.connection
            .execute("VACUUM INTO ?1", params![to])
            .map_err(failed)?;
        // the copy is marked as not closed, by its journal mode too
        let as_written = |copy: &Path| -> rusqlite::Result<()> {
            Connection::open(copy)?.pragma_update(None, "journal_mode", "WAL")
        };
        as_written(beside).map_err(failed)?;
        let written = File::open(beside).and_then(|copy| copy.sync_all());
        written.map_err(|source| LogbookError::disk(beside, "sync", source))
    }

    fn move_copy(&self, beside: &Path) -> Result<PathBuf, LogbookError> {
        let folder = folder_of(&self.path);
        let rescued = format!("{}_rescued.{EXTENSION}", self.header.id);
        for place in [self.path.clone(), folder.join(rescued)] {
            if place.exists() {
                continue;
            }
            // a leftover journal belongs to the missing file, and would be applied to the copy
            for end in ["-wal", "-shm", "-journal"] {
                let _ = std::fs::remove_file(companion(&place, end));
            }
            // fails if a file was created there in the meantime
            match std::fs::hard_link(beside, &place) {
                Ok(()) => {}
                Err(taken) if taken.kind() == std::io::ErrorKind::AlreadyExists => continue,
                Err(source) => return Err(LogbookError::disk(&place, "make", source)),
            }
            let _ = std::fs::remove_file(beside);
            let synced = File::open(folder).and_then(|folder| folder.sync_all());
            synced.map_err(|source| LogbookError::disk(&place, "sync the folder of", source))?;
            return Ok(place);
        }
        Err(LogbookError::Exists {
            path: self.path.clone(),
        })
    }
}
