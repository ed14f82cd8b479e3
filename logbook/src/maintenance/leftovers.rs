//! Removes what a killed writer left in a folder without a writer: deletes files without a session, and merges the
//! journals of sessions that are closed or continued elsewhere into their files.

use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags};

use crate::directory::scan::Names;
use crate::files::companion;
use crate::files::open_files::WriterGuard;
use crate::reader::continued_by;
use crate::writer::{LOCK_WAIT, set_aside_journal};
use crate::{Index, LogbookError, SessionReader, schema};

/// The result of tidying a folder.
#[derive(Debug, Default)]
pub struct TidyReport {
    /// Files without a session: their writer was killed before the header was on disk.
    pub removed: Vec<PathBuf>,
    /// Sessions whose journal was merged into their file.
    pub merged: Vec<PathBuf>,
    /// Errors of the files that could not be tidied.
    pub refused: Vec<LogbookError>,
}

/// Merges the journals of closed sessions into their files, also while a writer is running: sessions that were closed
/// while a program was reading them. Returns the sessions that are complete now. A session that is still being read,
/// or cannot be opened, is left unchanged.
///
/// # Errors
/// The folder cannot be read.
pub fn merge_closed(dir: impl AsRef<Path>) -> Result<Vec<PathBuf>, LogbookError> {
    let dir = dir.as_ref();
    let names = Names::of(dir, None)?;
    let with_journal = names
        .candidates(dir)?
        .into_iter()
        .filter(|file| file.has_wal);
    let paths = with_journal.map(|file| dir.join(file.name));
    let is_file =
        |path: &PathBuf| std::fs::symlink_metadata(path).is_ok_and(|found| found.is_file());
    Ok(paths
        .filter(|path| is_file(path) && matches!(merge(path, Duration::ZERO), Ok(true)))
        .collect())
}

impl Index {
    /// Tidies the folder; the caller must hold its lock, so that there is no other writer. Opens only files that are
    /// too small for a session or have a journal.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn tidy(&mut self) -> Result<TidyReport, LogbookError> {
        let mut tidied = TidyReport::default();
        let names = self.names()?;
        for file in names.candidates(self.dir())? {
            let small = file.stamp.file.bytes <= u64::from(schema::PAGE);
            let path = self.dir().join(file.name);
            let is_file = || std::fs::symlink_metadata(&path).is_ok_and(|found| found.is_file());
            if !(small || file.has_wal) || !is_file() {
                continue;
            }
            if small && is_stub(&path, file.stamp.file.bytes) {
                remove(&path);
                tidied.removed.push(path);
            } else if file.has_wal {
                match merge(&path, LOCK_WAIT) {
                    Ok(true) => tidied.merged.push(path),
                    Ok(false) => {}
                    Err(error) => tidied.refused.push(error),
                }
            }
        }
        for copy in names.copies() {
            let path = self.dir().join(copy);
            if std::fs::symlink_metadata(&path).is_ok_and(|found| found.is_file()) {
                remove(&path);
                tidied.removed.push(path);
            }
        }
        Ok(tidied)
    }
}

/// Whether nothing was ever written to a file or its journal, not even the first table.
fn is_stub(path: &Path, bytes: u64) -> bool {
    if bytes == 0 {
        let journal = std::fs::metadata(companion(path, "-wal"));
        return journal.map_or(true, |journal| journal.len() == 0);
    }
    // its journals are read too and stay unchanged
    let tables = open(path).and_then(|connection| {
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        connection.query_row("SELECT count(*) FROM sqlite_master", [], |row| {
            row.get::<_, i64>(0)
        })
    });
    tables.is_ok_and(|tables| tables == 0)
}

/// Merges the journal of a session that is closed or continued by another part; returns whether it was merged. Waits
/// up to `wait` for readers.
fn merge(path: &Path, wait: Duration) -> Result<bool, LogbookError> {
    let session = SessionReader::open(path)?;
    if session.is_merged() {
        // the journal does not belong to this file
        return Ok(false);
    }
    let over = session.closed().is_some() || continued_by(path, &session.header().id)?.is_some();
    drop(session);
    if !over {
        return Ok(false);
    }
    let failed = |source| LogbookError::writing(path, "merge the journal into", source);
    set_aside_journal(path)?;
    let _in_writing =
        WriterGuard::new(path).map_err(|source| LogbookError::disk(path, "open", source))?;
    let connection = open(path).map_err(failed)?;
    connection
        .busy_timeout(wait)
        .and_then(|()| connection.pragma_update(None, "synchronous", "EXTRA"))
        .and_then(|()| connection.pragma_update(None, "journal_mode", "DELETE"))
        .map_err(failed)?;
    Ok(true)
}

fn open(path: &Path) -> rusqlite::Result<Connection> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    Connection::open_with_flags(path, flags)
}

/// Removes the journals before the file; otherwise they would be applied to another file of the same name.
fn remove(path: &Path) {
    for end in ["-wal", "-shm", "-journal", ""] {
        let _ = std::fs::remove_file(companion(path, end));
    }
}

#[cfg(test)]
mod tests {
    use chrono::DateTime;
    use survey::Protocol;

    use crate::maintenance::leftovers::*;
    use crate::{SessionHeader, SessionWriter};

    #[test]
    fn stubs_are_removed_and_ended_sessions_become_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let at = DateTime::UNIX_EPOCH;
        let begun = |id: &str| {
            let header = SessionHeader::new(id, at, Protocol::sheffield(4).unwrap());
            SessionWriter::create(dir, &header).unwrap()
        };
        // an open reader prevents the merge of the journal
        let closed = begun("closed");
        let path = closed.path().to_owned();
        let reader = Connection::open(&path).unwrap();
        reader
            .execute_batch("BEGIN; SELECT count(*) FROM frame;")
            .unwrap();
        closed.close(at, "done").unwrap();
        assert!(companion(&path, "-wal").exists());
        // the reader exits without cleaning up, as if it were killed
        reader
            .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)
            .unwrap();
        drop(reader);
        let running = begun("running");
        running
            .connection_for_tests()
            .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)
            .unwrap();
        let goes_on = running.path().to_owned();
        drop(running);
        std::fs::write(dir.join("empty.tactus"), "").unwrap();
        let blank = dir.join("blank.tactus");
        Connection::open(&blank)
            .unwrap()
            .execute_batch(&format!(
                "PRAGMA page_size = {}; PRAGMA journal_mode = WAL",
                schema::PAGE
            ))
            .unwrap();
        assert!(std::fs::metadata(&blank).unwrap().len() > 0);
        std::fs::write(dir.join("half.rescue"), "half").unwrap();
        std::fs::write(dir.join("notes.tactus"), "a person's own words").unwrap();

        let tidied = Index::load(dir).tidy().unwrap();
        let names = |paths: &[PathBuf]| -> Vec<String> {
            let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
            paths.iter().map(name).collect()
        };
        assert_eq!(
            names(&tidied.removed),
            ["blank.tactus", "empty.tactus", "half.rescue"]
        );
        assert_eq!(names(&tidied.merged), ["closed.tactus"]);
        assert!(tidied.refused.is_empty(), "{:?}", tidied.refused);
        assert!(!companion(&path, "-wal").exists());
        assert!(dir.join("notes.tactus").exists());
        let whole = SessionReader::open(&path).unwrap();
        assert_eq!(whole.closed().unwrap().reason, "done");
        SessionWriter::resume(&goes_on).unwrap();
        let again = Index::load(dir).tidy().unwrap();
        assert!(again.removed.is_empty() && again.merged.is_empty());
    }

    #[test]
    fn session_closed_while_read_is_merged_after_its_last_reader() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let at = DateTime::UNIX_EPOCH;
        let begun = |id: &str| {
            let header = SessionHeader::new(id, at, Protocol::sheffield(4).unwrap());
            SessionWriter::create(dir, &header).unwrap()
        };
        let closed = begun("closed");
        let path = closed.path().to_owned();
        let reader = SessionReader::open(&path).unwrap();
        closed.close(at, "done").unwrap();
        let running = begun("running");
        assert!(companion(&path, "-wal").exists());
        assert!(merge_closed(dir).unwrap().is_empty(), "it is read");
        assert!(!SessionReader::open(&path).unwrap().is_merged());
        drop(reader);
        assert_eq!(merge_closed(dir).unwrap(), std::slice::from_ref(&path));
        assert!(!companion(&path, "-wal").exists());
        let whole = SessionReader::open(&path).unwrap();
        assert!(whole.is_merged());
        assert_eq!(whole.closed().unwrap().reason, "done");
        // a file that has just been made is not taken for a leftover
        assert!(running.path().exists());
        running.close(at, "done").unwrap();
        assert!(merge_closed(dir).unwrap().is_empty());
    }
}
