//! Continuing a session: after a crash in the same file, after a roll-over or an I/O error in the next part.
//!
//! Parts of a session are files `<id>.tactus`, `<id>_p2.tactus`, `<id>_p3.tactus`; each names the part that it
//! continues, and sequences are numbered across all parts. If two consecutive parts contain the same frames, because
//! an error interrupted the write, those of the later part are valid.

use std::path::{Path, PathBuf};

use chrono::{DateTime, Utc};
use rusqlite::config::DbConfig;

use super::{
    InitialContent, SessionWriter, Storage, adjust, discard, nanoseconds, open_for_writing,
    write_closing,
};
use crate::files::{companion, part_of, path_of};
use crate::reader::continued_by;
use crate::row::RowCounts;
use crate::{LogbookError, SessionHeader, SessionReader, Taken};
use outfile::folder_of;

/// Kind of the first event after a session is resumed; [`Resumed::before`] counts them.
pub const RESUMED: &str = "restarted";
/// Kind of the first event of a part that continues another one.
pub const CONTINUED: &str = "continued";

/// Beginning of the closing reason of a part that another one continues; that part's id follows.
pub(crate) const CONTINUED_IN: &str = "continued in ";

/// Frames at the end that are checked before a session is resumed; `tactus sessions verify` checks all.
const CHECKED: u64 = 64;

/// The state of a resumed session.
#[derive(Debug, Clone, PartialEq)]
pub struct Resumed {
    /// Its metadata; `asked` contains the options it was started with.
    pub header: SessionHeader,
    /// Sequence of the last frame; without frames, one less than the first sequence.
    pub acknowledged: u64,
    /// When the last frame was taken.
    pub last: Option<Taken>,
    /// When this file was resumed before: its events of the kind [`RESUMED`], oldest first.
    pub before: Vec<DateTime<Utc>>,
}

impl SessionWriter {
    /// Resumes a session that was not closed because its writer was killed. All acknowledged frames are there, and the
    /// last ones are checked. The caller should write an event of the kind [`RESUMED`] with the cause, if known.
    ///
    /// Closes the previous part if that was left open.
    ///
    /// # Errors
    /// The session is closed or continued by another part, damage, or a disk error.
    pub fn resume(path: impl AsRef<Path>) -> Result<(Self, Resumed), LogbookError> {
        Self::resume_with(path, Storage::default())
    }

    /// Like [`SessionWriter::resume`], with limits.
    ///
    /// # Errors
    /// As [`SessionWriter::resume`].
    pub fn resume_with(
        path: impl AsRef<Path>,
        storage: Storage,
    ) -> Result<(Self, Resumed), LogbookError> {
        let path = path.as_ref();
        set_aside_journal(path)?;
        // Opened read-only first: a foreign file is not changed.
        let header = SessionReader::open(path)?.header().clone();
        let opening = |source| LogbookError::writing(path, "open", source);
        let (connection, in_writing) = open_for_writing(path, "open")?;
        let session = SessionReader::of_writer(connection, path.to_owned())?;
        if let Some(closing) = session.closed() {
            return Err(LogbookError::Closed {
                path: path.to_owned(),
                reason: closing.reason.clone(),
            });
        }
        if let Some(by) = continued_by(path, &header.id)? {
            return Err(LogbookError::Continued {
                path: path.to_owned(),
                by,
            });
        }
        let resumed = found(&session)?;
        check_end(&session, resumed.acknowledged)?;
        let baseline = session.baseline()?;
        let reference = session.last_number("reference")?;
        let stretch = session.last_number("stretch")?;
        let (frames, late_maps) = (session.rows()?, session.late_maps_written()?);
        let (connection, header_checksum) = session.into_connection().map_err(opening)?;
        adjust(&connection, storage).map_err(opening)?;
        let open = (connection, in_writing, header_checksum);
        let mut writer = Self::over(open, path.to_owned(), header, storage);
        writer.sequence = resumed.acknowledged;
        writer.frames = frames;
        writer.late_maps = late_maps;
        writer.references.resume_after(reference);
        writer.stretches.resume_after(stretch);
        if let Some(baseline) = baseline {
            writer.take_baseline(baseline);
        }
        writer.close_earlier();
        Ok((writer, resumed))
    }

    /// Continues a session that can be read but not written, in a new part after the last readable frame.
    ///
    /// # Errors
    /// A header that cannot be read, a session that is continued already, or a disk error on the new part too.
    pub fn after(
        path: impl AsRef<Path>,
        at: DateTime<Utc>,
        why: &str,
    ) -> Result<(Self, Resumed), LogbookError> {
        let path = path.as_ref();
        let session = SessionReader::open(path)?;
        if let Some(by) = continued_by(path, &session.header().id)? {
            return Err(LogbookError::Continued {
                path: path.to_owned(),
                by,
            });
        }
        let resumed = found(&session)?;
        // An unreadable baseline counts as missing.
        let baseline = session.baseline().ok().flatten();
        let writer = next_part(
            path,
            &resumed.header,
            resumed.acknowledged,
            at,
            Storage::default(),
            &InitialContent {
                baseline: baseline.as_ref(),
                event: Some((
                    at,
                    CONTINUED,
                    &behind(&resumed.header.id, resumed.acknowledged, why),
                )),
            },
        )?;
        Ok((writer, resumed))
    }

    /// Closes this part and continues in the next: `<id>_p2`, `_p3`, with the same header and baseline. Returns the
    /// file of the closed part. If a crash interrupts this, [`SessionWriter::resume`] of the newer part closes the
    /// earlier one.
    ///
    /// # Errors
    /// The next part cannot be created, or this one cannot be closed; then this writer continues in this part.
    pub fn roll(&mut self, at: DateTime<Utc>) -> Result<PathBuf, LogbookError> {
        self.check_usable()?;
        let mut next = self.next(at, "rolled over")?;
        if let Err(refusal) = self.mark_closed(at, &continued_in(&next.header.id)) {
            if !self.broken {
                let path = next.path.clone();
                drop(next);
                discard(&path);
                return Err(refusal);
            }
            // Whether it is closed is unknown; the next part is intact.
            let text = format!("{} could not be closed: {refusal}", self.header.id);
            next.event(at, "part-not-closed", &text)?;
        } else {
            // The closing entry in the journal is valid, whether merged or not.
            let _ = self.merge();
        }
        Ok(self.switch_to(next))
    }

    /// Continues after an I/O error in a new part after the last acknowledged frame, without reading this file again:
    /// once a sync has failed, the state on disk is unknown, and reads may be served from the page cache. The caller
    /// must append the frames whose write failed again. Returns the old file.
    ///
    /// # Errors
    /// A disk error on the new part too; this writer is unchanged.
    pub fn successor(&mut self, at: DateTime<Utc>, why: &str) -> Result<PathBuf, LogbookError> {
        let next = self.next(at, why)?;
        // Merging the journal would read it through the same page cache.
        let _ = self
            .connection
            .set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true);
        Ok(self.switch_to(next))
    }

    fn next(&self, at: DateTime<Utc>, why: &str) -> Result<Self, LogbookError> {
        next_part(
            &self.path,
            &self.header,
            self.sequence,
            at,
            self.storage,
            &InitialContent {
                baseline: self.baseline.as_ref(),
                event: Some((at, CONTINUED, &behind(&self.header.id, self.sequence, why))),
            },
        )
    }

    fn switch_to(&mut self, next: Self) -> PathBuf {
        std::mem::replace(self, next).path
    }

    /// Closes the previous part if an interrupted [`SessionWriter::roll`] left it open. If that fails, it stays open:
    /// this part names the part that it continues.
    fn close_earlier(&self) {
        let Some(earlier) = &self.header.continues else {
            return;
        };
        let dir = folder_of(&self.path);
        let Ok(at) = nanoseconds(self.header.started, "the start of the session") else {
            return;
        };
        let close = || -> Result<(), LogbookError> {
            let path = path_of(dir, earlier);
            let failed = |source| LogbookError::writing(&path, "close", source);
            if SessionReader::open(&path)?.closed().is_some() {
                return Ok(());
            }
            let (connection, _in_writing) = open_for_writing(&path, "close")?;
            let session = SessionReader::of_writer(connection, path.clone())?;
            let tally = RowCounts {
                last: session.last_sequence()?,
                frames: session.rows()?,
                late_maps: session.late_maps_written()?,
                ..RowCounts::default()
            };
            let (connection, header_checksum) = session.into_connection().map_err(failed)?;
            adjust(&connection, Storage::default()).map_err(failed)?;
            write_closing(
                &connection,
                header_checksum,
                at,
                &continued_in(&self.header.id),
                tally,
            )
            .map_err(failed)?;
            connection
                .pragma_update(None, "journal_mode", "DELETE")
                .map_err(failed)
        };
        let _ = close();
    }
}

fn next_part(
    path: &Path,
    header: &SessionHeader,
    acknowledged: u64,
    at: DateTime<Utc>,
    storage: Storage,
    beginning: &InitialContent<'_>,
) -> Result<SessionWriter, LogbookError> {
    let dir = folder_of(path);
    let (session, part) = part_of(&header.id);
    let mut number = part;
    loop {
        number += 1;
        let id = format!("{session}_p{number}");
        let next = SessionHeader {
            id,
            started: at,
            continues: Some(header.id.clone()),
            first_sequence: acknowledged + 1,
            ..header.clone()
        };
        match SessionWriter::begin(dir, &next, storage, beginning) {
            // A file of that name without a header: its creation was interrupted. It is left unchanged.
            Err(LogbookError::Exists { .. }) if number < part + 1000 => {}
            made => return made,
        }
    }
}

/// Moves a rollback journal away from a session with a write-ahead log: SQLite would apply it, but it cannot belong to
/// the session.
pub(crate) fn set_aside_journal(path: &Path) -> Result<(), LogbookError> {
    let journal = companion(path, "-journal");
    let log = companion(path, "-wal");
    let is_written = std::fs::metadata(log).is_ok_and(|found| found.len() > 0);
    if !is_written || std::fs::symlink_metadata(&journal).is_err() {
        return Ok(());
    }
    std::fs::rename(&journal, companion(path, "-journal-set-aside"))
        .map_err(|source| LogbookError::disk(&journal, "rename", source))
}

fn found(session: &SessionReader) -> Result<Resumed, LogbookError> {
    let mut before = session.events()?;
    before.retain(|event| event.kind == RESUMED);
    Ok(Resumed {
        header: session.header().clone(),
        acknowledged: session.last_sequence()?,
        last: session.last_taken()?,
        before: before.into_iter().map(|event| event.at).collect(),
    })
}

/// Checks that the last frames match their checksums and are consecutive, and that the first one has the right
/// sequence.
fn check_end(session: &SessionReader, last: u64) -> Result<(), LogbookError> {
    let header_first = session.header().first_sequence;
    if let Some(lies_last) = session.last_row()?
        && u64::try_from(lies_last) != Ok(last)
    {
        let why = format!("its last row has the number {lies_last}");
        return Err(session.damaged(format!("frame {}", last + 1), why));
    }
    if last < header_first {
        return Ok(());
    }
    let from = last.saturating_sub(CHECKED - 1).max(header_first);
    for (expected, record) in (from..).zip(session.frames_from(from)) {
        if record?.frame.sequence != expected {
            return Err(session.damaged(format!("frame {expected}"), "it is not there"));
        }
    }
    match session.first_present()? {
        Some(first) if first != header_first => {
            Err(session.damaged(format!("frame {header_first}"), "it is not there"))
        }
        _ => Ok(()),
    }
}

fn continued_in(id: &str) -> String {
    format!("{CONTINUED_IN}{id}")
}

fn behind(id: &str, acknowledged: u64, why: &str) -> String {
    format!("continues {id} after frame {acknowledged}: {why}")
}
