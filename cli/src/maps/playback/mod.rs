//! Recorded sessions for the page of `tactus web`.

mod followed;
mod session;

use std::path::Path;
use std::sync::Arc;

use logbook::{SessionKind, SessionSummary};
use web::{Playback, Recordings, SessionEntry};

use crate::args::Global;
use crate::session_files;
use session::PlayedSession;

/// The sessions of the directories that the options name.
pub(crate) struct RecordedSessions {
    global: Global,
}

impl RecordedSessions {
    pub(crate) fn new(global: &Global) -> Self {
        Self {
            global: global.clone(),
        }
    }

    /// First parts of all measurements, the newest first; a folder that cannot be read is left out.
    fn summaries(&self) -> Result<Vec<SessionSummary>, String> {
        let places = session_files::directories(&self.global).map_err(|why| why.to_string())?;
        let listings = places.iter().filter_map(|place| logbook::list(place).ok());
        let mut sessions: Vec<SessionSummary> = listings
            .flat_map(|listing| listing.sessions)
            .filter(|session| session.kind == SessionKind::Measurement && session.frames > 0)
            .collect();
        sessions.sort_by(|a, b| (b.started, &b.id).cmp(&(a.started, &a.id)));
        Ok(sessions)
    }

    fn path(&self, id: &str) -> Result<std::path::PathBuf, String> {
        session_files::session_file(&self.global, id).map_err(|why| why.to_string())
    }
}

impl Recordings for RecordedSessions {
    fn list(&self) -> Result<Vec<SessionEntry>, String> {
        let mut entries: Vec<SessionEntry> = Vec::new();
        for part in self.summaries()? {
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
        Ok(entries)
    }

    fn open(&self, id: &str) -> Result<Arc<dyn Playback>, String> {
        let path = self.path(id)?;
        let opened = PlayedSession::open(Path::new(&path)).map_err(|why| why.to_string())?;
        Ok(Arc::new(opened))
    }
}
