//! The index file in the folder of the sessions: a line with a checksum for each closed session. `index` decides
//! whether an entry is valid.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::directory::index::{Entry, Index};
use crate::directory::scan::Stamp;
use crate::{LogbookError, SessionSummary};

/// Name of the file, with the version of its entries.
const FILE: &str = "sessions-1.index";
/// Name of the file while it is being written.
const NEW: &str = "sessions-1.index.new";
/// Superfluous lines allowed before the file is rewritten.
const SPARE_LINES: usize = 200;
/// Bytes of a line's checksum.
const SUM: usize = 8;

/// A line of the file.
#[derive(Serialize, Deserialize)]
struct Line {
    name: String,
    stamp: Stamp,
    session: SessionSummary,
}

impl Index {
    /// Loads the index of a folder; no session is opened.
    pub fn load(dir: impl AsRef<Path>) -> Self {
        let dir = dir.as_ref().to_owned();
        let mut index = Self {
            entries: BTreeMap::new(),
            unsaved: BTreeSet::new(),
            lines: None,
            names: None,
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

    /// Writes new entries of closed sessions, which do not change any more, to the index file. The caller must hold the
    /// folder's lock.
    ///
    /// # Errors
    /// The file cannot be written; the next start then reads the sessions again.
    pub fn save(&mut self) -> Result<(), LogbookError> {
        let failed =
            |source| LogbookError::disk(&self.dir.join(FILE), "write the index to", source);
        let kept = self.entries.len();
        let lines = self
            .lines
            .filter(|lines| lines + self.unsaved.len() <= 2 * kept + SPARE_LINES);
        let written = match lines {
            Some(_) if self.unsaved.is_empty() => return Ok(()),
            // the file may have been removed meanwhile
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
        // not synced: after a power cut, damaged lines fail their checksums
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
    survey::hex(&hash[..SUM])
}
