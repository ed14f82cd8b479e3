//! Marks of ended sessions, stored apart from their own files.
//!
//! A session whose file cannot be written (a full or read-only disk, a locked file) cannot be closed, and the next
//! daemon resumes every session that is not closed, with current. Therefore each end is written to two small files
//! before it is acknowledged: one in the record's directory, whose space is reserved beforehand and overwritten in
//! place, so that a full disk cannot refuse it; and one in the runtime directory, which is in memory and stays writable
//! when the disk is read-only, but is lost when the machine restarts.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::locked::locked;

/// Name of the file in the record's directory. In the runtime directory a hash of the record's directory is appended.
const FILE: &str = "ended-sessions";
/// Size of a mark, bytes: the amount that a disk writes atomically.
const SLOT: usize = 512;
/// Capacity of a file. One mark is needed for each ended session that could not be closed yet.
const SLOTS: usize = 16;

/// One session that has ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Mark {
    session: String,
    /// Time of the end, nanoseconds since 1970 UTC.
    at_ns: i64,
    reason: String,
}

/// The files to which an end was written.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Marked {
    /// A file that survives a restart of the machine.
    pub durable: Option<PathBuf>,
    /// A file that lasts until the machine restarts.
    pub until_restart: Option<PathBuf>,
    /// Why a file could not be written.
    pub failures: Vec<String>,
}

/// The marks of one record directory. All calls block on the disk.
#[derive(Debug)]
pub(crate) struct EndMarks {
    durable: PathBuf,
    until_restart: PathBuf,
    /// Serialises changes.
    changes: Mutex<()>,
}

impl EndMarks {
    /// Reserves the space of both files. A failed reservation is retried when a mark is written.
    pub(crate) fn open(record: &Path, runtime: &Path) -> Self {
        let real = std::fs::canonicalize(record).unwrap_or_else(|_| record.to_owned());
        let hash = Sha256::digest(real.as_os_str().as_encoded_bytes());
        let short = survey::hex(&hash[..6]);
        let marks = Self {
            durable: record.join(FILE),
            until_restart: runtime.join(format!("{FILE}-{short}")),
            changes: Mutex::default(),
        };
        for path in [&marks.until_restart, &marks.durable] {
            if let Err(cause) = reserve(path) {
                tracing::warn!(
                    "no space is reserved in {} for the ends of sessions: {cause}",
                    path.display()
                );
            }
        }
        marks
    }

    /// Marks a session as ended at `at_ns`, in nanoseconds since 1970 UTC. The result lists the files that contain the
    /// mark when this returns.
    pub(crate) fn mark(&self, session: &str, at_ns: i64, reason: &str) -> Marked {
        let _alone = locked(&self.changes);
        let mark = Mark {
            session: session.to_owned(),
            at_ns,
            reason: reason.to_owned(),
        };
        let mut marked = Marked::default();
        let mut written = |path: &Path| match write_mark(path, &mark) {
            Ok(()) => Some(path.to_owned()),
            Err(cause) => {
                marked.failures.push(format!("{}: {cause}", path.display()));
                None
            }
        };
        // first the file in memory, which cannot hang as the disk can
        let until_restart = written(&self.until_restart);
        let durable = written(&self.durable);
        Marked {
            durable,
            until_restart,
            ..marked
        }
    }

    /// The reason of the end of each marked session, by session id.
    pub(crate) fn reasons(&self) -> BTreeMap<String, String> {
        let mut reasons = BTreeMap::new();
        for path in [&self.until_restart, &self.durable] {
            match File::open(path).and_then(|file| read_slots(&file)) {
                Ok(slots) => reasons.extend(
                    slots
                        .into_iter()
                        .flatten()
                        .map(|mark| (mark.session, mark.reason)),
                ),
                Err(absent) if absent.kind() == io::ErrorKind::NotFound => {}
                Err(cause) => tracing::warn!(
                    "{} cannot be read; it lists the sessions that have ended: {cause}",
                    path.display()
                ),
            }
        }
        reasons
    }

    /// Removes the mark of a session whose own file records the end. A remaining mark is harmless.
    pub(crate) fn clear(&self, session: &str) {
        let _alone = locked(&self.changes);
        for path in [&self.until_restart, &self.durable] {
            if let Err(cause) = clear_mark(path, session) {
                tracing::debug!("{}: {cause}", path.display());
            }
        }
    }
}

impl Marked {
    /// Whether the end is stored in at least one file.
    pub(crate) fn is_kept(&self) -> bool {
        self.durable.is_some() || self.until_restart.is_some()
    }

    /// Message about a session whose own file does not record its end.
    pub(crate) fn text(&self, session: &str) -> String {
        match (&self.durable, &self.until_restart) {
            (Some(path), _) => format!(
                "the file of session {session} could not be closed; its end is stored in {}, and the next start of the \
                 daemon closes the file",
                path.display()
            ),
            (None, Some(path)) => format!(
                "the file of session {session} could not be closed; its end is stored in {} only until this machine \
                 restarts: make the record's directory writable and restart the daemon before that ({})",
                path.display(),
                self.failures.join("; ")
            ),
            (None, None) => format!(
                "the end of session {session} could not be stored anywhere: the next start of the daemon would resume \
                 it, with current; set record.resume = false before the daemon starts again ({})",
                self.failures.join("; ")
            ),
        }
    }
}

/// Creates the file with all its bytes written, so that overwriting them needs no space.
fn reserve(path: &Path) -> io::Result<File> {
    if let Some(folder) = path.parent() {
        std::fs::DirBuilder::new()
            .recursive(true)
            .mode(0o750)
            .create(folder)?;
    }
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o640)
        // a FIFO or a symbolic link in its place is not followed
        .custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK)
        .open(path)?;
    let found = file.metadata()?;
    if !found.is_file() {
        return Err(io::Error::new(
            io::ErrorKind::AlreadyExists,
            "it is not a regular file",
        ));
    }
    let (has, wants) = (found.len(), (SLOT * SLOTS) as u64);
    if has < wants {
        let mut blank = vec![b' '; (wants - has) as usize];
        for (at, byte) in (has as usize..).zip(&mut blank) {
            if at % SLOT == SLOT - 1 {
                *byte = b'\n';
            }
        }
        file.write_all_at(&blank, has)?;
        file.sync_all()?;
        if let Some(folder) = path.parent() {
            File::open(folder)?.sync_all()?;
        }
    }
    Ok(file)
}

fn read_slots(file: &File) -> io::Result<Vec<Option<Mark>>> {
    let mut bytes = vec![b' '; SLOT * SLOTS];
    let mut read = 0;
    while read < bytes.len() {
        match file.read_at(&mut bytes[read..], read as u64)? {
            0 => break,
            more => read += more,
        }
    }
    Ok(bytes
        .chunks(SLOT)
        .map(|slot| serde_json::from_slice(slot).ok())
        .collect())
}

fn write_mark(path: &Path, mark: &Mark) -> io::Result<()> {
    let file = reserve(path)?;
    let slots = read_slots(&file)?;
    let same = |slot: &Option<Mark>| {
        slot.as_ref()
            .is_some_and(|kept| kept.session == mark.session)
    };
    let oldest = || {
        let age = |slot: &usize| slots[*slot].as_ref().map(|kept| kept.at_ns);
        (0..SLOTS).min_by_key(age).unwrap_or(0)
    };
    let slot = slots
        .iter()
        .position(same)
        .or_else(|| slots.iter().position(Option::is_none))
        .unwrap_or_else(oldest);
    file.write_all_at(&line(mark)?, (slot * SLOT) as u64)?;
    file.sync_data()
}

fn clear_mark(path: &Path, session: &str) -> io::Result<()> {
    let file = OpenOptions::new().read(true).write(true).open(path)?;
    for (slot, kept) in read_slots(&file)?.into_iter().enumerate() {
        if kept.is_some_and(|kept| kept.session == session) {
            let mut blank = [b' '; SLOT];
            blank[SLOT - 1] = b'\n';
            file.write_all_at(&blank, (slot * SLOT) as u64)?;
        }
    }
    Ok(())
}

/// A mark in the file's format, its reason truncated to fit.
fn line(mark: &Mark) -> io::Result<[u8; SLOT]> {
    let mut mark = mark.clone();
    loop {
        let json = serde_json::to_vec(&mark)?;
        if json.len() < SLOT {
            let mut line = [b' '; SLOT];
            line[..json.len()].copy_from_slice(&json);
            line[SLOT - 1] = b'\n';
            return Ok(line);
        }
        let half = mark.reason.chars().count() / 2;
        if half == 0 {
            return Err(io::Error::new(
                io::ErrorKind::InvalidInput,
                "the session's id is too long",
            ));
        }
        mark.reason = mark.reason.chars().take(half).collect();
    }
}

#[cfg(test)]
mod tests {
    use crate::recording::end_marks::*;

    fn marks() -> (tempfile::TempDir, EndMarks) {
        let folder = tempfile::tempdir().unwrap();
        let marks = EndMarks::open(&folder.path().join("state"), &folder.path().join("run"));
        (folder, marks)
    }

    #[test]
    fn a_mark_is_kept_in_both_files_until_it_is_cleared() {
        let (_folder, marks) = marks();
        let sizes = |marks: &EndMarks| {
            [&marks.durable, &marks.until_restart]
                .map(|path| std::fs::metadata(path).unwrap().len())
        };
        let reserved = sizes(&marks);
        let long = "stopped \u{1b}[31m\n\"on request\" ".repeat(100);
        for (session, reason) in [("m1", "stopped on request"), ("m2", &long), ("m1", "again")] {
            let marked = marks.mark(session, 1, reason);
            assert!(
                marked.durable.is_some() && marked.until_restart.is_some(),
                "{marked:?}"
            );
        }
        let reasons = marks.reasons();
        assert_eq!(reasons["m1"], "again");
        assert!(long.starts_with(&reasons["m2"]) && !reasons["m2"].is_empty());
        assert_eq!(sizes(&marks), reserved, "a mark takes no new space");
        // either of the two files is sufficient
        std::fs::remove_file(&marks.until_restart).unwrap();
        assert_eq!(marks.reasons().len(), 2);
        marks.clear("m1");
        assert_eq!(marks.reasons().into_keys().collect::<Vec<_>>(), ["m2"]);
    }

    #[test]
    fn seventeenth_mark_replaces_the_oldest() {
        let (_folder, marks) = marks();
        for number in 0..=SLOTS {
            marks.mark(&format!("m{number}"), number as i64, "stopped");
        }
        let reasons = marks.reasons();
        assert_eq!(reasons.len(), SLOTS);
        assert!(!reasons.contains_key("m0") && reasons.contains_key("m16"));
    }

    #[test]
    fn unwritten_end_is_reported() {
        let (folder, marks) = marks();
        std::fs::remove_file(&marks.durable).unwrap();
        std::fs::create_dir(&marks.durable).unwrap();
        let marked = marks.mark("m1", 1, "stopped");
        assert!(marked.is_kept() && marked.durable.is_none());
        let text = marked.text("m1");
        assert!(text.contains("only until this machine restarts"), "{text}");
        assert_eq!(marks.reasons()["m1"], "stopped");
        std::fs::remove_dir_all(folder.path().join("run")).unwrap();
        std::fs::write(folder.path().join("run"), "").unwrap();
        let marked = marks.mark("m1", 1, "stopped");
        assert!(!marked.is_kept() && marked.failures.len() == 2);
        let text = marked.text("m1");
        assert!(text.contains("could not be stored anywhere"), "{text}");
    }

    #[test]
    fn damaged_slots_are_passed_over_and_used_again() {
        let (_folder, marks) = marks();
        marks.mark("m1", 1, "stopped");
        let bytes = vec![b'{'; SLOT * SLOTS];
        std::fs::write(&marks.durable, &bytes).unwrap();
        assert_eq!(marks.reasons().len(), 1, "the other file has it");
        marks.mark("m2", 2, "stopped");
        std::fs::remove_file(&marks.until_restart).unwrap();
        assert_eq!(marks.reasons().into_keys().collect::<Vec<_>>(), ["m2"]);
    }
}
