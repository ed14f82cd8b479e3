//! Reading a session: closed, left by a killed writer, or still being written.

mod contents;
mod frames;
mod guard;
mod log_header;
mod opening;
mod order;
mod readings;
mod tables;
mod times;

use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use rusqlite::{Connection, OptionalExtension, Params, Row};
use survey::Checks;

use crate::files::{self, id_of, part_of};
use crate::row::{End, HEADER_COLUMNS, HeaderChecksum, HeaderFault, header_row};
use crate::{Closing, LogbookError, SessionHeader, SessionSummary, schema};
use guard::Guard;
use opening::JournalMode;
use outfile::folder_of;

pub use frames::Frames;
pub(crate) use order::SMALLEST;

/// Query for the row of the header.
const ALL_OF_IT: &str = "SELECT * FROM session";

/// A session's file, opened for reading; neither it nor its companion files are changed.
#[derive(Debug)]
pub struct SessionReader {
    connection: Connection,
    guard: Guard,
    path: PathBuf,
    mode: JournalMode,
    header: SessionHeader,
    header_checksum: HeaderChecksum,
    end: End,
    /// Created when the first frame is read.
    checks: OnceCell<Checks>,
}

impl SessionReader {
    /// Opens a session file. The write-ahead log of a killed writer is part of the session; a rollback journal is not,
    /// and is never applied.
    ///
    /// # Errors
    /// No such file, no regular file, not a session, another schema, or damage to the header.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, LogbookError> {
        let path = path.as_ref();
        let is_closed = |connection: &Connection| {
            let sql = "SELECT closed_ns IS NOT NULL FROM session";
            connection
                .query_row(sql, [], |row| row.get(0))
                .unwrap_or(false)
        };
        let opened = opening::open(path, is_closed)?;
        let merged = opened.mode == JournalMode::Rollback;
        match Self::over(opened.connection, path.to_owned(), opened.mode, ALL_OF_IT) {
            // otherwise the end of the file may be in its journal
            Err(damaged @ LogbookError::Damaged { .. }) if merged => {
                Err(opening::missing_end(path).unwrap_or(damaged))
            }
            found => found,
        }
    }

    /// As [`SessionReader::open`], but also opens a closed session whose file has lost its end, if its header is
    /// intact. The closing entry is then unknown.
    ///
    /// # Errors
    /// As [`SessionReader::open`].
    pub(crate) fn open_without_end(path: &Path) -> Result<Self, LogbookError> {
        match Self::open(path) {
            Err(LogbookError::Damaged { place, .. }) if place == opening::END => {
                let connection = opening::without_end(path)?;
                // the columns of the closing entry may be on the last page
                let sql = format!(
                    "SELECT {HEADER_COLUMNS}, NULL AS closed_ns, NULL AS closed_reason, NULL AS closed_tally,
                     NULL AS closed_checksum FROM session"
                );
                let mode = JournalMode::Rollback;
                let rest = Self::over(connection, path.to_owned(), mode, &sql);
                rest.map_err(|error| match error {
                    LogbookError::Damaged { path, .. } => LogbookError::Damaged {
                        path,
                        place: "its header".to_owned(),
                        why: "it was at the end, which is missing; take the file from a copy"
                            .to_owned(),
                    },
                    other => other,
                })
            }
            found => found,
        }
    }

    /// Reads the header through a writer's connection.
    pub(crate) fn of_writer(connection: Connection, path: PathBuf) -> Result<Self, LogbookError> {
        Self::over(connection, path, JournalMode::Wal, ALL_OF_IT)
    }

    fn over(
        mut connection: Connection,
        path: PathBuf,
        mode: JournalMode,
        header_row_sql: &str,
    ) -> Result<Self, LogbookError> {
        let failed = |source| LogbookError::reading(&path, "read the header of", source);
        let mut guard = Guard::over(&mut connection).map_err(failed)?;
        let number = |name: &str| -> Result<i64, LogbookError> {
            connection
                .pragma_query_value(None, name, |row| row.get(0))
                .map_err(failed)
        };
        if number("application_id")? != i64::from(schema::APPLICATION_ID) {
            return Err(LogbookError::NotASession {
                path,
                why: "it has another application id (or its writer was killed before the header was written)"
                    .into(),
            });
        }
        let has = number("user_version")?;
        if has != schema::VERSION {
            return Err(LogbookError::OtherSchema {
                path,
                has,
                reads: schema::VERSION,
            });
        }
        let damaged = |place: &str, why: String| LogbookError::Damaged {
            path: path.clone(),
            place: place.to_owned(),
            why,
        };
        if let Some(why) = schema::difference(&connection).map_err(failed)? {
            return Err(damaged("its tables", why));
        }
        guard.allow_pages(number("page_count")?.unsigned_abs());
        let row = connection
            .query_row(header_row_sql, [], |row| Ok(header_row(row)))
            .optional()
            .map_err(failed)?;
        let (header, header_checksum, end) = match row {
            Some(Ok(read)) => read,
            Some(Err(HeaderFault::Store(source))) => return Err(failed(source)),
            Some(Err(HeaderFault::Content(why))) => return Err(damaged("its header", why)),
            None => return Err(damaged("its header", "it is not there".into())),
        };
        Ok(Self {
            connection,
            guard,
            path,
            mode,
            header,
            header_checksum,
            end,
            checks: OnceCell::new(),
        })
    }

    /// Whether the file is complete without a journal.
    pub fn is_merged(&self) -> bool {
        self.mode == JournalMode::Rollback
    }

    /// The connection for one query, with its own work limit.
    fn ask(&self) -> &Connection {
        self.guard.begin();
        &self.connection
    }

    /// The row of a query that returns one at most; `attempt` as in [`LogbookError::reading`].
    fn one_row<T>(
        &self,
        sql: &str,
        values: impl Params,
        attempt: &'static str,
        read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Option<T>, LogbookError> {
        self.ask()
            .prepare_cached(sql)
            .and_then(|mut statement| statement.query_row(values, read).optional())
            .map_err(|source| LogbookError::reading(&self.path, attempt, source))
    }

    /// The single number that a query returns.
    fn one_number(
        &self,
        sql: &str,
        values: impl Params,
        attempt: &'static str,
    ) -> Result<Option<i64>, LogbookError> {
        let number = self.one_row(sql, values, attempt, |row| row.get(0))?;
        Ok(number.flatten())
    }

    /// Metadata of the session.
    pub fn header(&self) -> &SessionHeader {
        &self.header
    }

    /// The session's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How the session had ended when it was opened; `None` if it was running, or if its writer was killed.
    pub fn closed(&self) -> Option<&Closing> {
        match &self.end {
            End::Open => None,
            End::Closed(closing, _) | End::Damaged(closing) => Some(closing),
        }
    }

    /// The connection without its work limit, and the checksum of the header, for the checksums of its rows.
    pub(crate) fn into_connection(self) -> rusqlite::Result<(Connection, HeaderChecksum)> {
        let mut connection = self.connection;
        connection.progress_handler(0, None::<fn() -> bool>)?;
        Ok((connection, self.header_checksum))
    }

    /// Frames in the file now.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn len(&self) -> Result<u64, LogbookError> {
        // Negative if damage left no valid row.
        Ok(self
            .last_sequence()?
            .saturating_add(1)
            .saturating_sub(self.header.first_sequence))
    }

    /// Sequence of the first frame in the file.
    pub(crate) fn first_present(&self) -> Result<Option<u64>, LogbookError> {
        let sql = "SELECT min(sequence) FROM frame";
        let first = self.one_number(sql, [], "count the frames of")?;
        Ok(first.map(|first| first as u64))
    }

    /// The largest id in a table; 0 if it is empty.
    pub(crate) fn last_number(&self, table: &'static str) -> Result<i64, LogbookError> {
        let sql = format!("SELECT max(id) FROM {table}");
        let last = self.one_number(&sql, [], "count the rows of")?;
        Ok(last.unwrap_or(0))
    }

    /// Number of late maps written.
    pub(crate) fn late_maps_written(&self) -> Result<u64, LogbookError> {
        let sql = "SELECT max(number) FROM late_map";
        let last = self.one_number(sql, [], "count the late maps of")?;
        Ok(last.map_or(0, i64::unsigned_abs))
    }

    /// Whether there is no frame.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn is_empty(&self) -> Result<bool, LogbookError> {
        Ok(self.len()? == 0)
    }

    /// A summary of the session.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn summary(&self) -> Result<SessionSummary, LogbookError> {
        let last = self.last_taken()?;
        Ok(SessionSummary {
            id: self.header.id.clone(),
            path: self.path.clone(),
            kind: self.header.kind,
            started: self.header.started,
            last: last.map(|last| last.wall),
            frames: self.len()?,
            first_sequence: self.header.first_sequence,
            continues: self.header.continues.clone(),
            closed: self.closed().cloned(),
            simulated: self.header.simulated,
            electrodes: self.header.protocol.electrodes(),
            readings: self.header.protocol.len(),
            note: self.header.note.clone(),
        })
    }

    /// Upper limit for the bytes read into memory at once: the size of the database.
    pub(crate) fn bytes(&self) -> Result<u64, LogbookError> {
        let count = |name: &str| -> rusqlite::Result<u64> {
            self.connection
                .pragma_query_value(None, name, |row| row.get::<_, i64>(0))
                .map(i64::unsigned_abs)
        };
        let bytes = || -> rusqlite::Result<u64> {
            Ok(count("page_count")?.saturating_mul(count("page_size")?))
        };
        bytes().map_err(|source| LogbookError::reading(&self.path, "read the size of", source))
    }

    pub(crate) fn damaged(&self, place: String, why: impl Into<String>) -> LogbookError {
        LogbookError::Damaged {
            path: self.path.clone(),
            place,
            why: why.into(),
        }
    }
}

/// The part in the folder of this file that continues `id`, if there is one.
pub(crate) fn continued_by(path: &Path, id: &str) -> Result<Option<String>, LogbookError> {
    let dir = folder_of(path);
    let (session, part) = part_of(id);
    for other in files::in_folder(dir)? {
        let (other_session, other_part) = part_of(id_of(&other));
        if other_session != session || other_part <= part {
            continue;
        }
        if let Ok(next) = SessionReader::open(&other)
            && next.header().continues.as_deref() == Some(id)
        {
            return Ok(Some(next.header().id.clone()));
        }
    }
    Ok(None)
}

fn microseconds(count: i64) -> Duration {
    Duration::from_micros(count.max(0) as u64)
}

fn wall(microseconds: i64) -> DateTime<Utc> {
    DateTime::from_timestamp_micros(microseconds).unwrap_or_default()
}
