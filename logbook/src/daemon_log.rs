//! Events of the daemon that belong to no session: lines of JSON in the folder of the sessions, bounded in size.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::files::lines::{append_line, open_for_lines};
use crate::files::open_files::inode;
use crate::{Event, LogbookError};

/// The current file, and the previous one.
const FILE_NAMES: [&str; 2] = ["daemon-events.jsonl", "daemon-events.1.jsonl"];
/// Bytes of each file; some ten thousand events.
const FILE_BYTES: u64 = 2 << 20;
/// Bytes of an event's text; a longer one is cut.
const LONGEST: usize = 4096;

/// Writes events; each is on disk when [`DaemonLog::append`] returns.
#[derive(Debug)]
pub struct DaemonLog {
    directory: PathBuf,
    file: File,
    bytes: u64,
    most: u64,
}

impl DaemonLog {
    /// Opens the log of a directory for appending; creates it if needed.
    ///
    /// # Errors
    /// The disk refuses the write.
    pub fn open(directory: impl AsRef<Path>) -> Result<Self, LogbookError> {
        Self::bounded(directory.as_ref(), FILE_BYTES)
    }

    fn bounded(directory: &Path, most: u64) -> Result<Self, LogbookError> {
        let path = directory.join(FILE_NAMES[0]);
        let begun = || -> std::io::Result<(File, u64)> {
            std::fs::create_dir_all(directory)?;
            let file = open_for_lines(&path)?;
            let bytes = file.metadata()?.len();
            Ok((file, bytes))
        };
        let (file, bytes) = begun().map_err(|source| LogbookError::io(&path, "open", source))?;
        Ok(Self {
            directory: directory.to_owned(),
            file,
            bytes,
            most,
        })
    }

    /// Writes one event; a full file becomes the previous file first, and a file that was moved or deleted is created
    /// again.
    ///
    /// # Errors
    /// The disk refuses the write.
    pub fn append(&mut self, event: &Event) -> Result<(), LogbookError> {
        let [path, before] = FILE_NAMES.map(|name| self.directory.join(name));
        if !self.is_at(&path) {
            *self = Self::bounded(&self.directory, self.most)?;
        }
        if self.bytes >= self.most {
            match std::fs::rename(&path, before) {
                // moved or deleted since it was opened
                Err(gone) if gone.kind() == ErrorKind::NotFound => {}
                renamed => renamed.map_err(|source| LogbookError::io(&path, "rename", source))?,
            }
            *self = Self::bounded(&self.directory, self.most)?;
        }
        let kept = event.text.char_indices();
        let kept = kept.take_while(|(at, letter)| at + letter.len_utf8() <= LONGEST);
        let short = Event {
            text: kept.map(|(_, letter)| letter).collect(),
            ..event.clone()
        };
        let mut written = || -> std::io::Result<usize> {
            let line = serde_json::to_vec(&short)?;
            append_line(&mut self.file, &line)?;
            self.file.sync_data()?;
            Ok(line.len() + 1)
        };
        let line = written().map_err(|source| LogbookError::io(&path, "write", source))?;
        self.bytes += line as u64;
        Ok(())
    }

    /// Whether the open file is still the one at its path: what is written to a moved or deleted file is lost. A path
    /// that cannot be examined is no reason to give up the open file.
    fn is_at(&self, path: &Path) -> bool {
        match (std::fs::metadata(path), self.file.metadata()) {
            (Ok(there), Ok(open)) => inode(&there) == inode(&open),
            (Err(cause), _) => cause.kind() != ErrorKind::NotFound,
            (Ok(_), Err(_)) => true,
        }
    }
}

/// The events of the daemon that records in this folder, oldest first. Invalid lines are skipped.
///
/// # Errors
/// A file that exists and cannot be read.
pub fn read_daemon_log(directory: impl AsRef<Path>) -> Result<Vec<Event>, LogbookError> {
    let mut events = Vec::new();
    for name in FILE_NAMES.into_iter().rev() {
        let path = directory.as_ref().join(name);
        let bytes = match std::fs::read(&path) {
            Ok(bytes) => bytes,
            Err(absent) if absent.kind() == ErrorKind::NotFound => continue,
            Err(source) => return Err(LogbookError::io(&path, "read", source)),
        };
        let lines = bytes.split(|byte| *byte == b'\n');
        events.extend(lines.filter_map(|line| serde_json::from_slice::<Event>(line).ok()));
    }
    Ok(events)
}

#[cfg(test)]
mod tests {
    use crate::daemon_log::*;
    use chrono::{DateTime, Utc};

    fn event(number: i64, text: &str) -> Event {
        Event {
            at: DateTime::<Utc>::from_timestamp_nanos(number),
            kind: "daily".into(),
            text: text.into(),
        }
    }

    #[test]
    fn events_come_back_and_a_torn_line_takes_no_other_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = DaemonLog::open(folder.path()).unwrap();
        writer.append(&event(1, "one\ntwo lines")).unwrap();
        let long = "\u{e9}".repeat(LONGEST);
        writer.append(&event(2, &long)).unwrap();
        drop(writer);
        let path = folder.path().join(FILE_NAMES[0]);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend_from_slice(b"{\"at\":\"2026-");
        std::fs::write(&path, bytes).unwrap();
        let mut writer = DaemonLog::open(folder.path()).unwrap();
        writer.append(&event(3, "after the power cut")).unwrap();
        let read = read_daemon_log(folder.path()).unwrap();
        let numbers: Vec<i64> = read
            .iter()
            .filter_map(|event| event.at.timestamp_nanos_opt())
            .collect();
        assert_eq!(numbers, [1, 2, 3]);
        assert_eq!(read[0], event(1, "one\ntwo lines"));
        assert_eq!(read[1].text.len(), LONGEST);
        assert!(
            read_daemon_log(folder.path().join("gone"))
                .unwrap()
                .is_empty()
        );
    }

    #[test]
    fn line_torn_by_a_full_disk_takes_no_other_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = DaemonLog::open(folder.path()).unwrap();
        writer.append(&event(1, "the disk is full")).unwrap();
        let path = folder.path().join(FILE_NAMES[0]);
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend_from_slice(b"{\"at\":\"2026-");
        std::fs::write(&path, bytes).unwrap();
        writer.append(&event(2, "there is space again")).unwrap();
        let read = read_daemon_log(folder.path()).unwrap();
        let texts: Vec<&str> = read.iter().map(|event| event.text.as_str()).collect();
        assert_eq!(texts, ["the disk is full", "there is space again"]);
    }

    #[test]
    fn events_after_the_file_was_moved_or_deleted_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path().join("log");
        let path = dir.join(FILE_NAMES[0]);
        let mut writer = DaemonLog::open(&dir).unwrap();
        let mut appended = |number| {
            let event = event(number, "something happened");
            writer.append(&event).unwrap();
            assert_eq!(read_daemon_log(&dir).unwrap().last(), Some(&event));
        };
        appended(1);
        std::fs::rename(&path, folder.path().join("elsewhere")).unwrap();
        appended(2);
        std::fs::remove_file(&path).unwrap();
        appended(3);
        std::fs::remove_dir_all(&dir).unwrap();
        appended(4);
        // another file in its place
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, "").unwrap();
        appended(5);
    }

    #[test]
    fn it_is_bounded_and_keeps_the_newest() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = DaemonLog::bounded(folder.path(), 10_000).unwrap();
        for number in 0..1000 {
            writer.append(&event(number, "something happened")).unwrap();
        }
        let on_disk: u64 = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().metadata().unwrap().len())
            .sum();
        assert!(on_disk < 2 * 10_100, "{on_disk}");
        let read = read_daemon_log(folder.path()).unwrap();
        assert_eq!(read.last(), Some(&event(999, "something happened")));
        assert!(read.len() > 100 && read.len() < 300, "{}", read.len());
        assert!(read.windows(2).all(|pair| pair[0].at < pair[1].at));
    }
}
