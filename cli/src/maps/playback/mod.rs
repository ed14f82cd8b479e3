//! Recorded sessions for the page of `tactus web`.

#[cfg(feature = "archive")]
mod archived;
mod followed;
mod history;
mod running;
mod session;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use logbook::{SessionKind, SessionSummary};
use web::{History, Playback, Recordings, RunningModel, SessionEntry, SessionList};

use crate::args::{Global, Web};
use crate::failure::Failure;
use crate::session_files;
use running::RunningSession;
use session::{Kept, PlayedSession};

/// The sessions of the directories that the options name, and of an archive.
pub(crate) struct RecordedSessions {
    global: Global,
    #[cfg(feature = "archive")]
    archive: Option<Arc<archived::ArchivedSheets>>,
    /// Directories that were found once, because a daemon that does not run cannot be queried for its directory.
    places: Mutex<Vec<PathBuf>>,
    /// The omissions of the previous list, which were reported already.
    reported: Mutex<Vec<String>>,
}

impl RecordedSessions {
    /// Looks up the directories now, so that the directory of a running daemon remains known after it ends. Must not be
    /// called in asynchronous code.
    ///
    /// # Errors
    /// An invalid `--bus` address, or a wrong configuration of the archive.
    pub(crate) fn new(global: &Global, requested: &Web) -> Result<Self, Failure> {
        #[cfg(not(feature = "archive"))]
        let _ = requested;
        Ok(Self {
            global: global.clone(),
            #[cfg(feature = "archive")]
            archive: match requested.archive {
                true => Some(Arc::new(archived::ArchivedSheets::open(global)?)),
                false => None,
            },
            places: Mutex::new(session_files::directories(global)?),
            reported: Mutex::default(),
        })
    }

    fn places(&self) -> Result<Vec<PathBuf>, String> {
        let found = session_files::directories(&self.global).map_err(|why| why.to_string())?;
        let mut places = self.places.lock().unwrap_or_else(PoisonError::into_inner);
        let new = found.into_iter().filter(|place| !places.contains(place));
        let new: Vec<PathBuf> = new.collect();
        places.extend(new);
        Ok(places.clone())
    }

    /// Parts of all measurements, the newest first. What cannot be read is left out; an unreadable folder is an error
    /// if it is the only one.
    fn found(&self) -> Result<FoundSessions, String> {
        let places = self.places()?;
        let mut found = FoundSessions::default();
        for place in &places {
            let report = |text: &str| found.left_out.push(text.to_owned());
            let listing = session_files::listing(&places, place, report);
            let Some(listing) = listing.map_err(|why| why.to_string())? else {
                continue;
            };
            let unreadable = listing.unreadable.iter();
            let unreadable = unreadable.map(|file| session_files::left_out(&file.path, &file.why));
            found.left_out.extend(unreadable);
            found.sessions.extend(listing.sessions);
        }
        // each omission is reported once, because the page requests the sessions repeatedly
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        for text in &found.left_out {
            if !reported.contains(text) {
                session_files::report(text);
            }
        }
        reported.clone_from(&found.left_out);
        let sessions = &mut found.sessions;
        sessions.retain(|session| session.kind == SessionKind::Measurement && session.frames > 0);
        sessions.sort_by(|a, b| (b.started, &b.id).cmp(&(a.started, &a.id)));
        Ok(found)
    }
}

/// The content of the directories.
#[derive(Default)]
struct FoundSessions {
    sessions: Vec<SessionSummary>,
    /// Why files and folders are left out.
    left_out: Vec<String>,
}

impl RecordedSessions {
    /// The earliest part of a session that still exists.
    fn first_part(&self, id: &str) -> Result<Option<PathBuf>, String> {
        let found = self.found()?;
        let part = found
            .sessions
            .iter()
            .rev()
            .find(|part| part.session() == id);
        Ok(part.map(|part| part.path.clone()))
    }
}

impl Recordings for RecordedSessions {
    fn list(&self) -> Result<SessionList, String> {
        let FoundSessions { sessions, left_out } = self.found()?;
        let mut entries: Vec<SessionEntry> = Vec::new();
        for part in sessions {
            let id = part.session();
            let last_ms = part.last.map(|last| last.timestamp_millis());
            // the newest part comes first
            match entries.iter_mut().find(|entry| entry.id == id) {
                Some(entry) => {
                    entry.frames += part.frames;
                    entry.started_ms = entry.started_ms.min(part.started.timestamp_millis());
                }
                None => entries.push(SessionEntry {
                    id: id.to_owned(),
                    started_ms: part.started.timestamp_millis(),
                    last_ms,
                    frames: part.frames,
                    simulated: part.simulated,
                    closed: part.closed.is_some(),
                    note: part.note.clone(),
                }),
            }
        }
        Ok(SessionList {
            sessions: entries,
            left_out,
        })
    }

    #[cfg(feature = "archive")]
    fn sheets(&self) -> Option<Arc<dyn web::Sheets>> {
        let sheets = self.archive.clone()?;
        Some(sheets)
    }

    fn open(&self, id: &str) -> Result<Option<Arc<dyn Playback>>, String> {
        let opened = |path: &Path, kept: Kept| -> Result<Option<Arc<dyn Playback>>, String> {
            let opened = PlayedSession::open(path, id, kept).map_err(|why| why.to_string())?;
            Ok(Some(Arc::new(opened)))
        };
        if let Some(named) = id.strip_prefix(session_files::ARCHIVE) {
            #[cfg(feature = "archive")]
            if let Some(sheets) = &self.archive {
                let fetched = sheets.fetch(named).map_err(|why| why.to_string())?;
                return opened(&fetched.path, Some(Box::new(fetched.in_use)));
            }
            return Err(format!(
                "this page has no archive, so {named} cannot be played; `tactus web --archive` can"
            ));
        }
        match self.first_part(id)? {
            Some(path) => opened(&path, None),
            None => Ok(None),
        }
    }

    fn running(&self, id: &str) -> Result<Option<Arc<dyn RunningModel>>, String> {
        let Some(path) = self.first_part(id)? else {
            return Ok(None);
        };
        let opened = RunningSession::open(&path).map_err(|why| why.to_string())?;
        Ok(Some(Arc::new(opened)))
    }

    fn history(&self, from_s: i64, to_s: i64, region: &str, spans: u32) -> Result<History, String> {
        history::history(&self.found()?.sessions, (from_s, to_s), region, spans)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::Arguments;

    #[test]
    fn files_that_cannot_be_read_are_named_beside_the_list() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("x.tactus");
        std::fs::write(&file, "not a session").unwrap();
        let state = folder.path().to_str().unwrap();
        let Arguments { global, .. } = Arguments::parse_from(["tactus", "--state", state, "web"]);
        let recorded = RecordedSessions::new(&global, &Web::default()).unwrap();
        let listed = recorded.list().unwrap();
        assert!(listed.sessions.is_empty());
        let [left_out] = listed.left_out.as_slice() else {
            panic!("{listed:?}");
        };
        assert!(left_out.contains("x.tactus is left out: "), "{left_out}");
        // it is reported once, and again after it was readable meanwhile
        assert_eq!(*recorded.reported.lock().unwrap(), listed.left_out);
        std::fs::remove_file(&file).unwrap();
        assert_eq!(recorded.list().unwrap(), SessionList::default());
        assert!(recorded.reported.lock().unwrap().is_empty());
    }
}
