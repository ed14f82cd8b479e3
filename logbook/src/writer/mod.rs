//! Writing a session. Each call is one transaction, on disk when it returns.

mod append;
mod closing;
mod file_identity;
mod late;
mod opening;
mod parts;
mod references;
mod rows;
mod segments;
pub(crate) mod size;

use std::fs::{File, OpenOptions};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use rusqlite::Connection;
use survey::{Baseline, Checks, Settings};

use crate::files::companion;
use crate::files::open_files::WriterGuard;
use crate::row::{HeaderChecksum, RowCounts};
use crate::schema;
use crate::{DiskFault, LogbookError, MapRecord, SessionHeader};

use crate::writer::file_identity::FilePlace;
use crate::writer::segments::Stretches;
use closing::write_closing;
use opening::{adjust, discard, make_folder, open_for_writing};
pub use parts::{CONTINUED, RESUMED, Resumed};
pub(crate) use parts::{CONTINUED_IN, set_aside_journal};
use references::References;
use rows::Unwritten;

/// Limits of the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Storage {
    /// Largest number of 512-byte pages; beyond it writes fail as on a full disk. `None` for no limit.
    pub page_limit: Option<u32>,
    /// Pages in the journal beyond which it is merged into the file; `None` for 4000, which are 2 MB.
    pub journal_pages: Option<u32>,
}

/// The writer of a session's file. There is at most one for each file.
#[derive(Debug)]
pub struct SessionWriter {
    connection: Connection,
    /// Dropped after the connection.
    _in_writing: WriterGuard,
    path: PathBuf,
    header: SessionHeader,
    header_checksum: HeaderChecksum,
    storage: Storage,
    protocol_hash: String,
    baseline: Option<Baseline>,
    checks: Checks,
    sequence: u64,
    /// Rows of frames and of late maps.
    frames: u64,
    late_maps: u64,
    references: References,
    stretches: Stretches,
    settings: Option<(i64, Settings)>,
    mapper: Option<(i64, MapRecord)>,
    broken: bool,
    /// Identity of the file and its companions.
    place: FilePlace,
}

/// Time that each write waits for a lock of another process.
pub(crate) const LOCK_WAIT: Duration = Duration::from_millis(250);

/// Content of a new file that is written in the same transaction as its header.
#[derive(Debug, Default)]
struct InitialContent<'a> {
    baseline: Option<&'a Baseline>,
    /// Time, kind and text.
    event: Option<(DateTime<Utc>, &'a str, &'a str)>,
}

impl SessionWriter {
    /// Creates `<dir>/<id>.tactus` (and the folder if needed) and writes the header; it is on disk when this returns.
    ///
    /// # Errors
    /// An invalid id, an existing session, or a disk error.
    pub fn create(dir: impl AsRef<Path>, header: &SessionHeader) -> Result<Self, LogbookError> {
        Self::create_with(dir, header, Storage::default())
    }

    /// Like [`SessionWriter::create`], with limits.
    ///
    /// # Errors
    /// As [`SessionWriter::create`].
    pub fn create_with(
        dir: impl AsRef<Path>,
        header: &SessionHeader,
        storage: Storage,
    ) -> Result<Self, LogbookError> {
        Self::begin(dir.as_ref(), header, storage, &InitialContent::default())
    }

    fn begin(
        dir: &Path,
        header: &SessionHeader,
        storage: Storage,
        beginning: &InitialContent<'_>,
    ) -> Result<Self, LogbookError> {
        check_id(&header.id)?;
        let path = crate::files::path_of(dir, &header.id);
        make_folder(dir)
            .map_err(|source| LogbookError::disk(&path, "make the folder of", source))?;
        // Created here because SQLite would not refuse an existing file. SQLite gives the journal and its index the
        // same permissions.
        let new = OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o640)
            .open(&path);
        match new {
            Ok(_) => {}
            Err(source) if source.kind() == std::io::ErrorKind::AlreadyExists => {
                return Err(LogbookError::Exists { path });
            }
            Err(source) => return Err(LogbookError::disk(&path, "make", source)),
        }
        let laid_out =
            Self::create_tables(&path, header, storage, beginning).and_then(|laid_out| {
                File::open(dir)
                    .and_then(|folder| folder.sync_all())
                    .map_err(|source| LogbookError::disk(&path, "sync the folder of", source))?;
                Ok(laid_out)
            });
        let (connection, in_writing, header_checksum) = laid_out.inspect_err(|_| {
            // A file without a header is not a session; nothing was acknowledged, so nothing is lost.
            discard(&path);
        })?;
        let mut writer = Self::over(
            (connection, in_writing, header_checksum),
            path,
            header.clone(),
            storage,
        );
        if let Some(baseline) = beginning.baseline {
            writer.take_baseline(baseline.clone());
        }
        Ok(writer)
    }

    /// Constructor for a file with a header and no frame yet.
    fn over(
        (connection, in_writing, header_checksum): (Connection, WriterGuard, HeaderChecksum),
        path: PathBuf,
        header: SessionHeader,
        storage: Storage,
    ) -> Self {
        Self {
            connection,
            _in_writing: in_writing,
            place: FilePlace::of(&path),
            path,
            header_checksum,
            storage,
            protocol_hash: header.protocol.hash(),
            baseline: None,
            checks: Checks::new(&header.protocol),
            sequence: header.first_sequence - 1,
            frames: 0,
            late_maps: 0,
            references: References::default(),
            stretches: Stretches::default(),
            settings: None,
            mapper: None,
            broken: false,
            header,
        }
    }

    fn create_tables(
        path: &Path,
        header: &SessionHeader,
        storage: Storage,
        beginning: &InitialContent<'_>,
    ) -> Result<(Connection, WriterGuard, HeaderChecksum), LogbookError> {
        let started = nanoseconds(header.started, "the start of the session")?;
        let (connection, in_writing) = open_for_writing(path, "write the header of")?;
        let write =
            |mut connection: Connection| -> Result<(Connection, HeaderChecksum), Unwritten> {
                connection.pragma_update(None, "page_size", schema::PAGE)?;
                adjust(&connection, storage)?;
                connection.pragma_update(None, "journal_mode", "WAL")?;
                let transaction = connection.transaction()?;
                schema::create_tables(&transaction)?;
                let header_checksum = rows::write_header(&transaction, header, started)?;
                if let Some(baseline) = beginning.baseline {
                    rows::write_baseline(&transaction, header_checksum, baseline)?;
                }
                if let Some((at, kind, text)) = beginning.event {
                    let at = nanoseconds(at, "an event's time")?;
                    rows::write_event(&transaction, header_checksum, at, kind, text)?;
                }
                transaction.commit()?;
                Ok((connection, header_checksum))
            };
        match write(connection) {
            Ok((connection, header_checksum)) => Ok((connection, in_writing, header_checksum)),
            Err(unwritten) => Err(unwritten.into_error(path, "write the header of")),
        }
    }

    /// The session's file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Metadata of the session.
    pub fn header(&self) -> &SessionHeader {
        &self.header
    }

    /// Sequence of the last acknowledged frame; before the first, one less than the first sequence.
    pub fn acknowledged(&self) -> u64 {
        self.sequence
    }

    /// Current size of the file and its journal, bytes.
    pub fn bytes(&self) -> u64 {
        let size = |path: &Path| std::fs::metadata(path).map_or(0, |found| found.len());
        size(&self.path) + size(&companion(&self.path, "-wal"))
    }

    /// Whether an I/O error left this file in an unknown state. It is then no longer written; see
    /// [`SessionWriter::successor`].
    pub fn is_broken(&self) -> bool {
        self.broken
    }

    /// Writes the baseline that this session recorded or measures against.
    ///
    /// # Errors
    /// A second baseline, the wrong number of readings, or a disk error.
    pub fn baseline(&mut self, baseline: &Baseline) -> Result<(), LogbookError> {
        self.check_usable()?;
        let wants = self.header.protocol.len();
        check_length(baseline.readings.len(), wants)?;
        check_length(baseline.deviation.len(), wants)?;
        let header_checksum = self.header_checksum;
        let write = |connection: &mut Connection| -> Result<i64, Unwritten> {
            let transaction = connection.transaction()?;
            let settings = rows::write_baseline(&transaction, header_checksum, baseline)?;
            transaction.commit()?;
            Ok(settings)
        };
        match write(&mut self.connection) {
            Ok(settings) => self.settings = Some((settings, baseline.settings.clone())),
            Err(Unwritten::Refused(refusal)) => return Err(refusal),
            Err(Unwritten::Store(source)) => {
                return Err(self.write_failed("write the baseline to", source));
            }
        }
        self.check_written()?;
        self.take_baseline(baseline.clone());
        Ok(())
    }

    fn take_baseline(&mut self, baseline: Baseline) {
        self.references.set_baseline(&baseline.readings);
        self.checks = self.checks.clone().against(&baseline.readings);
        self.baseline = Some(baseline);
    }

    /// Writes an event; on disk when this returns.
    ///
    /// # Errors
    /// A disk error.
    pub fn event(&mut self, at: DateTime<Utc>, kind: &str, text: &str) -> Result<(), LogbookError> {
        self.check_usable()?;
        let at = nanoseconds(at, "an event's time")?;
        rows::write_event(&self.connection, self.header_checksum, at, kind, text)
            .map_err(|source| self.write_failed("write an event to", source))?;
        self.check_written()
    }

    /// Records how the session ended and leaves a single file, without companions.
    ///
    /// # Errors
    /// A disk error; the frames are safe, and the session counts as not closed.
    pub fn close(mut self, at: DateTime<Utc>, reason: &str) -> Result<(), LogbookError> {
        self.end(at, reason)
    }

    /// Like [`SessionWriter::close`], but can be retried after an error. Nothing may be written afterwards.
    ///
    /// # Errors
    /// As [`SessionWriter::close`].
    pub fn end(&mut self, at: DateTime<Utc>, reason: &str) -> Result<(), LogbookError> {
        self.mark_closed(at, reason)?;
        self.merge()
    }

    fn mark_closed(&mut self, at: DateTime<Utc>, reason: &str) -> Result<(), LogbookError> {
        self.check_usable()?;
        self.place.check(&self.path)?;
        let at = nanoseconds(at, "the end of the session")?;
        let tally = RowCounts {
            last: self.sequence,
            frames: self.frames,
            late_maps: self.late_maps,
            ..RowCounts::default()
        };
        write_closing(&self.connection, self.header_checksum, at, reason, tally)
            .map_err(|source| self.write_failed("close", source))?;
        self.check_written()
    }

    /// Merges the journal into the file (SQLite: checkpoint), so that a closed session is a single file.
    fn merge(&mut self) -> Result<(), LogbookError> {
        // Fails while there is a reader; the last reader or the next opening then merges the journal.
        match self
            .connection
            .pragma_update(None, "journal_mode", "DELETE")
        {
            Ok(()) => Ok(()),
            Err(busy)
                if matches!(
                    busy.sqlite_error_code(),
                    Some(rusqlite::ErrorCode::DatabaseBusy | rusqlite::ErrorCode::DatabaseLocked)
                ) =>
            {
                Ok(())
            }
            Err(source) => Err(self.write_failed("merge the journal into", source)),
        }
    }

    #[cfg(test)]
    pub(crate) fn connection_for_tests(&self) -> &Connection {
        &self.connection
    }

    fn check_usable(&self) -> Result<(), LogbookError> {
        if !self.broken {
            return Ok(());
        }
        Err(LogbookError::DiskRefused {
            path: self.path.clone(),
            attempt: "write anything more to",
            fault: DiskFault::Broken,
            source: "after an I/O error it is not known what reached the disk".into(),
        })
    }

    /// Classifies a failed write. Space may become free on a full disk; after an I/O error the kernel may have dropped
    /// unwritten pages and reported it only once, so nothing more is acknowledged on this file.
    fn write_failed(&mut self, attempt: &'static str, source: rusqlite::Error) -> LogbookError {
        let refusal = LogbookError::writing(&self.path, attempt, source);
        self.broken |= refusal.is_broken();
        refusal
    }

    /// [`survey::Protocol::hash`] of this session's protocol.
    pub fn protocol_hash(&self) -> &str {
        &self.protocol_hash
    }
}

fn check_length(has: usize, wants: usize) -> Result<(), LogbookError> {
    if has == wants {
        Ok(())
    } else {
        Err(LogbookError::WrongLength { has, wants })
    }
}

fn check_id(id: &str) -> Result<(), LogbookError> {
    let fits = (1..=100).contains(&id.len())
        && id
            .bytes()
            .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_');
    if fits {
        Ok(())
    } else {
        Err(LogbookError::BadId { id: id.to_owned() })
    }
}

fn nanoseconds(at: DateTime<Utc>, what: &'static str) -> Result<i64, LogbookError> {
    at.timestamp_nanos_opt()
        .ok_or(LogbookError::TimeOutOfRange { what })
}

fn span(duration: Duration, what: &'static str) -> Result<i64, LogbookError> {
    i64::try_from(duration.as_nanos()).map_err(|_| LogbookError::TimeOutOfRange { what })
}
