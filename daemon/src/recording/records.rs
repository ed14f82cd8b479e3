//! The sessions on disk, as the daemon knows them: each file is read once, and again when it has changed.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use chrono::{DateTime, Utc};
use dbus::Fault;
use logbook::{Index, LogbookError, SessionKind, SessionReader, SessionSummary};
use survey::Baseline;

use survey::error_chain as chain;

/// So many files are read while the daemon starts; more are read beside it.
const WHILE_STARTING: usize = 200;

/// The index of the record's folder.
#[derive(Debug)]
pub(crate) struct Records {
    known: Mutex<Cached>,
}

#[derive(Debug)]
struct Cached {
    index: Index,
    /// Files of which the journal has been told that they cannot be read.
    reported: BTreeSet<PathBuf>,
}

impl Records {
    /// What was kept of the folder; no session is opened.
    pub(crate) fn of(directory: &Path) -> Self {
        Self {
            known: Mutex::new(Cached {
                index: Index::load(directory),
                reported: BTreeSet::new(),
            }),
        }
    }

    fn known(&self) -> MutexGuard<'_, Cached> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What killed daemons have left in the folder is removed or folded in. The caller holds the folder's lock.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn tidy(&self) -> Result<logbook::Tidied, LogbookError> {
        self.known().index.tidy()
    }

    /// Whether so much is to be read first that nobody should wait for it.
    pub(crate) fn takes_long(&self) -> bool {
        let unknown = self.known().index.unknown();
        unknown.is_ok_and(|unknown| unknown > WHILE_STARTING)
    }

    /// The sessions as they are now. Blocks while files are read.
    fn now(&self) -> Result<MutexGuard<'_, Cached>, LogbookError> {
        let mut known = self.known();
        known.index.refresh()?;
        if let Err(error) = known.index.save() {
            tracing::debug!("{}", chain(&error));
        }
        let mut unreadable = BTreeSet::new();
        for file in known.index.unreadable() {
            // once: whoever asks for the list must not fill the journal
            if !known.reported.contains(&file.path) {
                tracing::warn!("{}: {}", file.path.display(), chain(&file.why));
            }
            unreadable.insert(file.path);
        }
        known.reported = unreadable;
        Ok(known)
    }

    /// What may be resumed, the newest first.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn interrupted(&self) -> Result<Vec<SessionSummary>, LogbookError> {
        Ok(self.now()?.index.interrupted())
    }

    /// What may be resumed of the sessions that were written at this time or later, the newest first; older sessions are not
    /// opened.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn interrupted_since(
        &self,
        time: DateTime<Utc>,
    ) -> Result<Vec<SessionSummary>, LogbookError> {
        let mut known = self.known();
        known.index.refresh_since(time)?;
        Ok(known.index.interrupted())
    }

    /// The baseline recorded last as seen `now`.
    ///
    /// # Errors
    /// The folder or that baseline cannot be read.
    pub(crate) fn latest_baseline(
        &self,
        now: DateTime<Utc>,
    ) -> Result<Option<Baseline>, LogbookError> {
        let latest = self.now()?.index.latest_baseline(now)?;
        Ok(latest.map(|(_, baseline)| baseline))
    }

    /// The baseline recorded before the one with this id, where it was measured alike.
    ///
    /// # Errors
    /// The folder or that baseline cannot be read.
    pub(crate) fn baseline_before(
        &self,
        baseline: &Baseline,
    ) -> Result<Option<Baseline>, LogbookError> {
        let mut earlier: Vec<PathBuf> = {
            let known = self.now()?;
            let sessions = known.index.sessions();
            sessions
                .into_iter()
                .filter(|session| session.kind == SessionKind::Baseline)
                .take_while(|session| session.id != baseline.id)
                .map(|session| session.path.clone())
                .collect()
        };
        while let Some(path) = earlier.pop() {
            if let Some(found) = SessionReader::open(&path)?.baseline()? {
                let alike = baseline.settings.differences(&found.settings).is_empty()
                    && baseline.simulated == found.simulated
                    && baseline.readings.len() == found.readings.len();
                return Ok(Some(found).filter(|_| alike));
            }
        }
        Ok(None)
    }

    /// So many sessions, the newest first, where named those that come after the one with this id.
    ///
    /// # Errors
    /// The folder cannot be read, or there is no such session.
    pub(crate) fn listed(
        &self,
        count: usize,
        before: Option<&str>,
    ) -> Result<Vec<SessionSummary>, Fault> {
        let known = self.now().map_err(|error| disk_fault(&error))?;
        let sessions = known.index.sessions();
        let from = match before {
            None => sessions.len(),
            Some(id) => sessions
                .iter()
                .position(|session| session.id == id)
                .ok_or_else(|| {
                    Fault::NoSession(format!(
                        "option 'before' is '{id}', and there is no such session (any more); ask without it"
                    ))
                })?,
        };
        let newest = sessions.iter().take(from).rev().take(count);
        Ok(newest.map(|summary| (*summary).clone()).collect())
    }
}

/// An error of the logbook as a fault on the bus.
pub(crate) fn disk_fault(error: &LogbookError) -> Fault {
    if error.is_disk() {
        Fault::DiskRefused(chain(error))
    } else {
        Fault::Failed(chain(error))
    }
}
