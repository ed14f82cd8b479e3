//! Opening a file for writing, its folder and its settings in SQLite.

use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;

use rusqlite::{Connection, OpenFlags};

use super::{LOCK_WAIT, Storage};
use crate::files::companion;
use crate::files::open_files::WriterGuard;
use crate::{LogbookError, schema};

pub(super) fn open_for_writing(
    path: &Path,
    attempt: &'static str,
) -> Result<(Connection, WriterGuard), LogbookError> {
    let in_writing =
        WriterGuard::new(path).map_err(|source| LogbookError::disk(path, attempt, source))?;
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let connection = Connection::open_with_flags(path, flags)
        .map_err(|source| LogbookError::writing(path, attempt, source))?;
    Ok((connection, in_writing))
}

/// Sets a sync for each transaction, and a sync of the folder after a rollback journal is deleted, which SQLite uses
/// when it changes the journal mode: a journal that reappeared after a power cut would undo later transactions.
pub(super) fn adjust(connection: &Connection, storage: Storage) -> rusqlite::Result<()> {
    connection.pragma_update(None, "synchronous", "EXTRA")?;
    connection.pragma_update(None, "foreign_keys", true)?;
    connection.busy_timeout(LOCK_WAIT)?;
    if let Some(pages) = storage.page_limit {
        connection.pragma_update_and_check(None, "max_page_count", pages, |_| Ok(()))?;
    }
    let journal = storage.journal_pages.unwrap_or(schema::JOURNAL);
    connection.pragma_update_and_check(None, "wal_autocheckpoint", journal, |_| Ok(()))
}

/// Session folders are readable by their group only.
pub(super) fn make_folder(dir: &Path) -> std::io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o750).create(dir)
}

/// Removes a file without content; the journal first, which would otherwise be applied to another file of the same
/// name.
pub(super) fn discard(path: &Path) {
    for end in ["-wal", "-shm", ""] {
        let _ = std::fs::remove_file(companion(path, end));
    }
}
