//! Index of the sessions on disk: each file is read once, and again when it has changed.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use chrono::{DateTime, Utc};
use dbus::Fault;
use logbook::{Index, LogbookError, SessionKind, SessionReader, SessionSummary};
use survey::Baseline;

use survey::error_chain as chain;

use crate::locked::locked;

/// Maximum number of files that are read before the daemon is ready; if there are more, they are read in the
/// background.
const WHILE_STARTING: usize = 200;

/// The index of the record's folder.
#[derive(Debug)]
pub(crate) struct Records {
    known: Mutex<Cached>,
}

#[derive(Debug)]
struct Cached {
    index: Index,
    /// Files whose read error has been logged.
    reported: BTreeSet<PathBuf>,
}

impl Records {
    /// Loads the stored index of the folder; no session is opened.
    pub(crate) fn of(directory: &Path) -> Self {
        Self {
            known: Mutex::new(Cached {
                index: Index::load(directory),
                reported: BTreeSet::new(),
            }),
        }
    }

    /// Tidies up after killed daemons: removes empty sessions and merges journals into their sessions. The caller must
    /// hold the folder's lock.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn tidy(&self) -> Result<logbook::TidyReport, LogbookError> {
        locked(&self.known).index.tidy()
    }

    /// Whether reading takes so long that it should not delay the start.
    pub(crate) fn takes_long(&self) -> bool {
        let unknown = locked(&self.known).index.unknown();
        unknown.is_ok_and(|unknown| unknown > WHILE_STARTING)
    }

    /// The up-to-date index. Blocks while files are read.
    fn now(&self) -> Result<MutexGuard<'_, Cached>, LogbookError> {
        let mut known = locked(&self.known);
        known.index.refresh()?;
        if let Err(error) = known.index.save() {
            tracing::debug!("{}", chain(&error));
        }
        let mut unreadable = BTreeSet::new();
        for file in known.index.unreadable() {
            // logged once: repeated listings must not fill the journal
            if !known.reported.contains(&file.path) {
                tracing::warn!("{}: {}", file.path.display(), chain(&file.why));
            }
            unreadable.insert(file.path);
        }
        known.reported = unreadable;
        Ok(known)
    }

    /// The sessions that may be resumed, newest first.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn interrupted(&self) -> Result<Vec<SessionSummary>, LogbookError> {
        Ok(self.now()?.index.interrupted())
    }

    /// The sessions written at this time or later that may be resumed, newest first; older sessions are not opened.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(crate) fn interrupted_since(
        &self,
        time: DateTime<Utc>,
    ) -> Result<Vec<SessionSummary>, LogbookError> {
        let mut known = locked(&self.known);
        known.index.refresh_since(time)?;
        Ok(known.index.interrupted())
    }

    /// The latest baseline as of `now`.
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

    /// The baseline before the one with this id, if it was measured with the same settings.
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

    /// At most `count` sessions, newest first. With `before`, those that follow the session with this id in the list.
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
                        "option 'before' is '{id}', and there is no such session (any more); call again without this option"
                    ))
                })?,
        };
        let newest = sessions.iter().take(from).rev().take(count);
        Ok(newest.map(|summary| (*summary).clone()).collect())
    }
}

/// Converts an error of the logbook to a D-Bus fault.
pub(crate) fn disk_fault(error: &LogbookError) -> Fault {
    if error.is_disk() {
        Fault::DiskRefused(chain(error))
    } else {
        Fault::Failed(chain(error))
    }
}
