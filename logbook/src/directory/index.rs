//! What the sessions of a folder are, remembered: a file is opened only where it is not the one that was read last.
//!
//! The memory may be kept in a file beside the sessions (`sessions.index`, a line each). It is a cache and nothing else:
//! an entry counts only where inode, size and times of the session's file agree with it, a line only where its checksum
//! does. Without the file, or with a damaged one, the sessions themselves are read.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs::Metadata;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use chrono::{DateTime, TimeDelta, Utc};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::directory::EXTENSION;
use crate::{Listing, LogbookError, SessionKind, SessionReader, SessionSummary, Unreadable};

/// Name of the file; its version is that of an entry's form.
const FILE: &str = "sessions-1.index";
/// Name of the file while it is written.
const NEW: &str = "sessions-1.index.new";
/// A file that was written this short a time before it was read may change again and look the same: file systems count
/// time by the kernel's clock tick, 10 ms at most.
const SETTLES: Duration = Duration::from_millis(100);
/// A clock that is set right moves by less between a recording and the next start.
const CLOCK_STEP: TimeDelta = TimeDelta::try_minutes(5).unwrap();
/// Lines beyond those that are needed before the file is written anew.
const SPARE_LINES: usize = 200;
/// Bytes of a line's checksum.
const SUM: usize = 8;

/// The sessions of a folder.
#[derive(Debug)]
pub struct Index {
    dir: PathBuf,
    entries: BTreeMap<String, Entry>,
    /// Names whose entries the file does not have.
    unsaved: BTreeSet<String>,
    /// Lines in the file; `None` where it must be written anew.
    lines: Option<usize>,
}

#[derive(Debug)]
struct Entry {
    stamp: Stamp,
    /// Whether an equal stamp means an equal file.
    settled: bool,
    found: Result<SessionSummary, Arc<LogbookError>>,
}

/// By what a file is known to be the one that was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Stamp {
    file: FileStamp,
    /// Of the journals beside it, where there are any.
    journals: Vec<FileStamp>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct FileStamp {
    inode: u64,
    bytes: u64,
    /// Of the content, in ns.
    modified: i64,
    /// Of the content, the name, owner or mode, in ns; no program can set it.
    changed: i64,
}

impl FileStamp {
    fn of(found: &Metadata) -> Self {
        let ns = |seconds: i64, ns: i64| seconds.saturating_mul(1_000_000_000).saturating_add(ns);
        Self {
            inode: found.ino(),
            bytes: found.len(),
            modified: ns(found.mtime(), found.mtime_nsec()),
            changed: ns(found.ctime(), found.ctime_nsec()),
        }
    }
}

impl Stamp {
    /// Whether another write, from this time on, would give it other times.
    fn is_settled(&self, now: i64) -> bool {
        let mut all = std::iter::once(&self.file).chain(&self.journals);
        all.all(|file| u128::from(now.abs_diff(file.changed)) > SETTLES.as_nanos())
    }
}

/// A line of the file.
#[derive(Serialize, Deserialize)]
struct Line {
    name: String,
    stamp: Stamp,
    session: SessionSummary,
}

/// A file of the folder that looks like a session.
struct Candidate {
    name: String,
    stamp: Stamp,
}

impl Index {
    /// What is remembered of a folder; no session is opened.
    pub fn load(dir: impl AsRef<Path>) -> Self {
        let dir = dir.as_ref().to_owned();
        let mut index = Self {
            entries: BTreeMap::new(),
            unsaved: BTreeSet::new(),
            lines: None,
            dir,
        };
        let Ok(text) = std::fs::read(index.dir.join(FILE)) else {
            return index;
        };
        let (mut lines, mut whole) = (0, text.ends_with(b"\n") || text.is_empty());
        for line in text
            .split(|byte| *byte == b'\n')
            .filter(|line| !line.is_empty())
        {
            lines += 1;
            let Some(line) = parse(line) else {
                whole = false;
                continue;
            };
            let mut session = line.session;
            // the folder may have been moved
            session.path = index.dir.join(&line.name);
            let entry = Entry {
                stamp: line.stamp,
                settled: true,
                found: Ok(session),
            };
            index.entries.insert(line.name, entry);
        }
        index.lines = whole.then_some(lines);
        index
    }

    /// Reads what is not known yet or has changed, and forgets what has gone.
    ///
    /// # Errors
    /// The folder cannot be read. A folder that is not there holds nothing.
    pub fn refresh(&mut self) -> Result<(), LogbookError> {
        let candidates = self.candidates()?;
        let names: BTreeSet<&str> = candidates.iter().map(|file| file.name.as_str()).collect();
        self.entries.retain(|name, _| names.contains(name.as_str()));
        self.unsaved.retain(|name| names.contains(name.as_str()));
        for Candidate { name, stamp } in candidates {
            if self.knows(&name, &stamp) {
                continue;
            }
            let path = self.dir.join(&name);
            let found = SessionReader::open(&path).and_then(|session| session.summary());
            let entry = Entry {
                settled: stamp.is_settled(now()),
                stamp,
                found: found.map_err(Arc::new),
            };
            // one that is open, or cannot be read, is read again by whoever wants to know
            let kept = matches!(&entry.found, Ok(session) if session.closed.is_some());
            match kept && entry.settled {
                true => self.unsaved.insert(name.clone()),
                false => self.unsaved.remove(&name),
            };
            self.entries.insert(name, entry);
        }
        Ok(())
    }

    /// How many files [`Index::refresh`] would open.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn unknown(&self) -> Result<usize, LogbookError> {
        let candidates = self.candidates()?;
        let unknown = candidates
            .iter()
            .filter(|file| !self.knows(&file.name, &file.stamp));
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

    /// Sessions that were not closed and that no other part goes on from, the newest first: what may be resumed.
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

    /// The baseline recorded last as seen `now`, if there is one; sessions that were closed without a baseline in them are
    /// passed over. One that is dated in the future was recorded while the clock was wrong: it is the last only where there
    /// is no other.
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

    /// All of it.
    pub fn listing(&self) -> Listing {
        Listing {
            sessions: self.sessions().into_iter().cloned().collect(),
            unreadable: self.unreadable(),
        }
    }

    /// Keeps what is new in the file beside the sessions: closed sessions, which do not change any more. Only whoever
    /// holds the folder's lock may.
    ///
    /// # Errors
    /// The file cannot be written; nothing but time is lost by that.
    pub fn save(&mut self) -> Result<(), LogbookError> {
        let failed =
            |source| LogbookError::disk(&self.dir.join(FILE), "write the index to", source);
        let kept = self.entries.len();
        let lines = self
            .lines
            .filter(|lines| lines + self.unsaved.len() <= 2 * kept + SPARE_LINES);
        let written = match lines {
            Some(_) if self.unsaved.is_empty() => return Ok(()),
            // the file may have gone meanwhile
            Some(lines) => match self.append() {
                Ok(appended) => lines + appended,
                Err(_) => self.write_anew().map_err(failed)?,
            },
            None => self.write_anew().map_err(failed)?,
        };
        self.lines = Some(written);
        self.unsaved.clear();
        Ok(())
    }

    fn append(&self) -> std::io::Result<usize> {
        let names = self.unsaved.iter().map(String::as_str);
        let (text, lines) = self.text(names)?;
        let mut file = std::fs::OpenOptions::new()
            .append(true)
            .open(self.dir.join(FILE))?;
        file.write_all(&text)?;
        Ok(lines)
    }

    fn write_anew(&self) -> std::io::Result<usize> {
        let settled = self.entries.iter().filter(|(_, entry)| entry.settled);
        let (text, lines) = self.text(settled.map(|(name, _)| name.as_str()))?;
        let new = self.dir.join(NEW);
        match std::fs::remove_file(&new) {
            Err(cause) if cause.kind() != ErrorKind::NotFound => return Err(cause),
            _ => {}
        }
        let mut file = std::fs::OpenOptions::new()
            .write(true)
            .create_new(true)
            .mode(0o640)
            .open(&new)?;
        // not synchronised: what a power cut leaves of it fails its checksums
        file.write_all(&text)?;
        drop(file);
        std::fs::rename(new, self.dir.join(FILE))?;
        Ok(lines)
    }

    fn text<'a>(&self, names: impl Iterator<Item = &'a str>) -> std::io::Result<(Vec<u8>, usize)> {
        let (mut text, mut lines) = (Vec::new(), 0);
        for name in names {
            let Some(entry) = self.entries.get(name) else {
                continue;
            };
            let Ok(session) = &entry.found else {
                continue;
            };
            if session.closed.is_none() {
                continue;
            }
            let line = serde_json::to_vec(&Line {
                name: name.to_owned(),
                stamp: entry.stamp.clone(),
                session: session.clone(),
            })?;
            write!(text, "{} ", sum(&line))?;
            text.extend_from_slice(&line);
            text.push(b'\n');
            lines += 1;
        }
        Ok((text, lines))
    }

    /// The files that look like sessions, by name, each with its stamp.
    fn candidates(&self) -> Result<Vec<Candidate>, LogbookError> {
        let failed = |source| LogbookError::Io {
            path: self.dir.clone(),
            attempt: "list",
            source,
        };
        let entries = match std::fs::read_dir(&self.dir) {
            Ok(entries) => entries,
            Err(absent) if absent.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            Err(source) => return Err(failed(source)),
        };
        let names: BTreeSet<OsString> = entries
            .map(|entry| entry.map(|entry| entry.file_name()))
            .collect::<Result<_, _>>()
            .map_err(failed)?;
        let mut candidates = Vec::new();
        for name in &names {
            let path = self.dir.join(name);
            let (Some(text), true) = (
                name.to_str(),
                path.extension().is_some_and(|end| end == EXTENSION),
            ) else {
                continue;
            };
            // gone in between: not there
            let Ok(found) = std::fs::metadata(&path) else {
                continue;
            };
            let journals = ["-wal", "-journal"].iter().filter_map(|ending| {
                let journal = OsString::from(format!("{text}{ending}"));
                let there = names.contains(&journal);
                let found = there.then(|| std::fs::metadata(self.dir.join(journal)))?;
                Some(FileStamp::of(&found.ok()?))
            });
            candidates.push(Candidate {
                name: text.to_owned(),
                stamp: Stamp {
                    file: FileStamp::of(&found),
                    journals: journals.collect(),
                },
            });
        }
        Ok(candidates)
    }
}

fn parse(line: &[u8]) -> Option<Line> {
    let (kept, text) = line.split_at_checked(2 * SUM)?;
    let text = text.strip_prefix(b" ")?;
    if sum(text).as_bytes() != kept {
        return None;
    }
    serde_json::from_slice(text).ok()
}

fn sum(line: &[u8]) -> String {
    let hash = Sha256::digest(line);
    hash.iter()
        .take(SUM)
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// As files are stamped; what is not settled is read again, so a wrong clock costs time and nothing else.
fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| {
        i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
    })
}
