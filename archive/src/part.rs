//! A closed part, read for the archive.

use std::fs::File;
use std::path::{Path, PathBuf};

use chrono::{DateTime, Utc};
use logbook::{Closing, Event, LogbookError, SessionHeader, SessionReader, StateKind, sha256_of};

use crate::store::PartName;

/// A closed part.
#[derive(Debug)]
pub struct Part {
    /// Its name in the store.
    pub name: PartName,
    /// Size, bytes.
    pub bytes: u64,
    /// Its metadata.
    pub header: SessionHeader,
    /// Frames in it.
    pub frames: u64,
    /// Wall time of the last frame.
    pub last: Option<DateTime<Utc>>,
    /// How it ended.
    pub closing: Closing,
    /// Its events.
    pub events: Vec<Event>,
    /// The tracked baseline at the start of its session; for the first part only.
    pub tracking: Option<String>,
    /// The file, open.
    pub file: File,
}

/// Why a part cannot be archived.
#[derive(Debug, thiserror::Error)]
pub enum PartError {
    /// The file cannot be read as a session.
    #[error("cannot be archived; `tactus sessions verify` shows what is wrong")]
    Unreadable(#[source] LogbookError),
    /// The tracked baseline next to it cannot be read.
    #[error("is archived when the tracked baseline beside it can be read")]
    State(#[source] LogbookError),
    /// The file cannot be read.
    #[error("{} cannot be read", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        #[source]
        source: std::io::Error,
    },
    /// It is not closed.
    #[error("{} is not closed: it is archived when its session ends or continues in the next part", .0.display())]
    Open(PathBuf),
    /// Its last rows are in a journal next to it.
    #[error("{} is closed, but its last rows are still in a journal next to it (-wal): a running daemon moves them into the file within a minute after the last program has stopped reading it", .0.display())]
    Unmerged(PathBuf),
    /// The file was renamed or copied.
    #[error("{} holds part {id}: a copy is not archived, the file {id}.tactus is", path.display())]
    OtherName {
        /// The file.
        path: PathBuf,
        /// Its id.
        id: String,
    },
}

impl Part {
    /// Reads a closed part of this site and machine; hashes the whole file.
    ///
    /// # Errors
    /// It is open, damaged or a copy under another name.
    pub fn read(path: &Path, site: &str, daq: &str) -> Result<Self, PartError> {
        let io = |source| PartError::Io {
            path: path.to_owned(),
            source,
        };
        let file = File::open(path).map_err(io)?;
        let session = SessionReader::open(path).map_err(PartError::Unreadable)?;
        let header = session.header().clone();
        if path
            .file_stem()
            .is_none_or(|stem| stem != header.id.as_str())
        {
            return Err(PartError::OtherName {
                path: path.to_owned(),
                id: header.id,
            });
        }
        let Some(closing) = session.closed().cloned() else {
            return Err(PartError::Open(path.to_owned()));
        };
        if !session.is_merged() {
            return Err(PartError::Unmerged(path.to_owned()));
        }
        let summary = session.summary().map_err(PartError::Unreadable)?;
        let events = session.events().map_err(PartError::Unreadable)?;
        let (sha256, bytes) = sha256_of(&file).map_err(io)?;
        let folder = logbook::folder_of(path);
        let tracking = match header.id == header.session() {
            true => match logbook::kept_state(folder, &header.id, StateKind::Tracking) {
                // a damaged state is archived as such: it is rejected when maps are computed again, and the frames
                // are archived
                Err(damaged @ LogbookError::Damaged { .. }) => Some(damaged.to_string()),
                // the archive keeps the first version that it receives: a state that can only be read later would
                // never be archived
                state => state.map_err(PartError::State)?,
            },
            false => None,
        };
        Ok(Self {
            name: PartName {
                site: site.to_owned(),
                daq: daq.to_owned(),
                session: header.session().to_owned(),
                part: header.id.clone(),
                sha256,
            },
            bytes,
            header,
            frames: summary.frames,
            last: summary.last,
            closing,
            events,
            tracking,
            file,
        })
    }
}

#[cfg(test)]
mod tests {
    use logbook::SessionWriter;
    use survey::Protocol;

    use super::*;

    #[test]
    fn part_waits_for_a_tracked_baseline_that_cannot_be_read() {
        let folder = tempfile::tempdir().unwrap();
        let at = DateTime::UNIX_EPOCH;
        let header = SessionHeader::new("m1", at, Protocol::sheffield(8).unwrap());
        let writer = SessionWriter::create(folder.path(), &header).unwrap();
        let path = writer.path().to_owned();
        writer.close(at, "done").unwrap();
        let read = || Part::read(&path, "berlin", "bed3");
        let state = folder.path().join("m1.tracking");
        std::fs::create_dir(&state).unwrap();
        let error = survey::error_chain(&read().unwrap_err());
        assert!(error.contains("m1.tracking"), "{error}");
        std::fs::remove_dir(&state).unwrap();
        std::fs::write(&state, [0xff; 100]).unwrap();
        assert!(read().unwrap().tracking.unwrap().contains("damaged"));
        std::fs::remove_file(&state).unwrap();
        assert_eq!(read().unwrap().tracking, None);
    }
}
