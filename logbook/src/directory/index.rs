//! Index of the sessions of a folder: a file is opened only if it has changed since it was last read.
//!
//! The index may be stored next to the sessions (`sessions-1.index`, one line each;
//! [`index_file`](super::index_file)). It is only a cache: an entry is used only if inode, size and times of the
//! session's file agree with it and the line's checksum is valid. If the index is missing or damaged, the sessions
//! themselves are read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::Arc;

use chrono::{DateTime, TimeDelta, Utc};

use crate::directory::scan::{Candidate, Names, Stamp, now};
use crate::{Listing, LogbookError, SessionKind, SessionReader, SessionSummary, Unreadable};

/// Allowance for a clock that is corrected between a recording and the next start.
const CLOCK_STEP: TimeDelta = TimeDelta::try_minutes(5).unwrap();

/// The sessions of a folder.
#[derive(Debug)]
pub struct Index {
    pub(super) dir: PathBuf,
    pub(super) entries: BTreeMap<String, Entry>,
    /// Names whose entries are not in the index file.
    pub(super) unsaved: BTreeSet<String>,
    /// Lines in the index file; `None` if it must be rewritten.
    pub(super) lines: Option<usize>,
    /// From the last directory scan.
    pub(super) names: Option<Arc<Names>>,
}

#[derive(Debug)]
pub(super) struct Entry {
    pub(super) stamp: Stamp,
    /// Whether an equal stamp means an equal file.
    pub(super) settled: bool,
    pub(super) found: Result<SessionSummary, Arc<LogbookError>>,
}

impl Index {
    /// The folder.
    pub(crate) fn dir(&self) -> &std::path::Path {
        &self.dir
    }

    /// The names in the folder now; it is scanned only if it has changed.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn names(&mut self) -> Result<Arc<Names>, LogbookError> {
        let names = Names::of(&self.dir, self.names.take())?;
        self.names = Some(Arc::clone(&names));
        Ok(names)
    }

    /// Reads new and changed sessions, and drops those that no longer exist.
    ///
    /// # Errors
    /// The folder cannot be read. A missing folder holds nothing.
    pub fn refresh(&mut self) -> Result<(), LogbookError> {
        self.refresh_where(|_| true)
    }

    /// Like [`Index::refresh`], for sessions written at this time or later by the file system's clock; entries of
    /// others stay. Finds an interrupted session of today among thousands of old ones without opening these.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn refresh_since(&mut self, time: DateTime<Utc>) -> Result<(), LogbookError> {
        let time = time.timestamp_nanos_opt().unwrap_or(i64::MIN);
        self.refresh_where(|stamp| stamp.is_written_since(time))
    }

    fn refresh_where(&mut self, is_wanted: impl Fn(&Stamp) -> bool) -> Result<(), LogbookError> {
        let names = self.names()?;
        self.entries.retain(|name, _| names.contains(name));
        self.unsaved.retain(|name| names.contains(name));
        for Candidate { name, stamp, .. } in names.candidates(&self.dir)? {
            if self.knows(name, &stamp) || !is_wanted(&stamp) {
                continue;
            }
            let path = self.dir.join(name);
            // determined before the file is read, because the file may change meanwhile
            let settled = stamp.is_settled(now());
            let found = SessionReader::open(&path).and_then(|session| session.summary());
            let entry = Entry {
                settled,
                stamp,
                found: found.map_err(Arc::new),
            };
            // a session that is open or unreadable is read again on every refresh
            let kept = matches!(&entry.found, Ok(session) if session.closed.is_some());
            match kept && entry.settled {
                true => self.unsaved.insert(name.to_owned()),
                false => self.unsaved.remove(name),
            };
            self.entries.insert(name.to_owned(), entry);
        }
        Ok(())
    }

    /// Number of files that [`Index::refresh`] would open.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn unknown(&mut self) -> Result<usize, LogbookError> {
        let names = self.names()?;
        let candidates = names.candidates(&self.dir)?;
        let unknown = candidates
            .iter()
            .filter(|file| !self.knows(file.name, &file.stamp));
        Ok(unknown.count())
    }

    fn knows(&self, name: &str, stamp: &Stamp) -> bool {
        let entry = self.entries.get(name);
        entry.is_some_and(|entry| entry.settled && entry.stamp == *stamp)
    }

    /// The sessions as they were last read, the oldest first.
    pub fn sessions(&self) -> Vec<&SessionSummary> {
        let entries = self.entries.values();
        let mut sessions: Vec<_> = entries
            .filter_map(|entry| entry.found.as_ref().ok())
            .collect();
        sessions.sort_by(|a, b| (a.started, &a.id).cmp(&(b.started, &b.id)));
        sessions
    }

    /// Files that look like sessions and could not be read.
    pub fn unreadable(&self) -> Vec<Unreadable> {
        let entries = self.entries.iter();
        entries
            .filter_map(|(name, entry)| {
                Some(Unreadable {
                    path: self.dir.join(name),
                    why: Arc::clone(entry.found.as_ref().err()?),
                })
            })
            .collect()
    }

    /// Sessions that were not closed and that no other part continues, newest first: those that may be resumed.
    pub fn interrupted(&self) -> Vec<SessionSummary> {
        let sessions = self.sessions();
        let continued: BTreeSet<&str> = sessions
            .iter()
            .filter_map(|session| session.continues.as_deref())
            .collect();
        let open = sessions
            .iter()
            .rev()
            .filter(|session| session.closed.is_none());
        open.filter(|session| !continued.contains(session.id.as_str()))
            .map(|session| (*session).clone())
            .collect()
    }

    /// The latest baseline as of `now`, if there is one; closed sessions without a baseline are skipped. A baseline
    /// dated in the future was recorded with a wrong clock and is used only if there is no other.
    ///
    /// # Errors
    /// That baseline cannot be read.
    pub fn latest_baseline(
        &self,
        now: DateTime<Utc>,
    ) -> Result<Option<(SessionSummary, survey::Baseline)>, LogbookError> {
        let latest = now
            .checked_add_signed(CLOCK_STEP)
            .unwrap_or(DateTime::<Utc>::MAX_UTC);
        let mut closed = self.sessions();
        closed.retain(|session| session.kind == SessionKind::Baseline && session.closed.is_some());
        let (past, future): (Vec<_>, Vec<_>) = closed
            .into_iter()
            .partition(|summary| summary.started <= latest);
        for summary in future.into_iter().chain(past).rev() {
            if let Some(baseline) = SessionReader::open(&summary.path)?.baseline()? {
                return Ok(Some((summary.clone(), baseline)));
            }
        }
        Ok(None)
    }

    /// All sessions and unreadable files.
    pub fn listing(&self) -> Listing {
        Listing {
            sessions: self.sessions().into_iter().cloned().collect(),
            unreadable: self.unreadable(),
        }
    }
}
