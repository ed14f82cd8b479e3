//! Retention: which sessions may go, by age, by size, and only what has been exported.

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use outfile::Existing;
use serde::{Deserialize, Serialize};

use crate::directory::{files, list, part_of};
use crate::{LogbookError, SessionKind, SessionReader, SessionSummary};

/// Name of the list of what has been pruned, a JSON object a line.
const PRUNED: &str = "pruned.jsonl";
/// How the name of a mark ends that says that a session has been exported.
const EXPORTED: &str = "exported.json";

/// What may go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Retention {
    /// Sessions whose last frame is older.
    pub older_than: Option<Duration>,
    /// The oldest sessions, until all files of the folder's sessions together take no more bytes than this.
    pub keep_bytes: Option<u64>,
    /// Of those only what has been exported whole; alone: all that has been.
    pub exported_only: bool,
    /// Whether the earlier, closed parts of a session that still runs may go, too: a ring.
    pub ring: bool,
}

/// A session or part that went, or would go.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Removed {
    /// Its id.
    pub id: String,
    /// Its file.
    pub path: PathBuf,
    /// What it took with everything beside it, bytes.
    pub bytes: u64,
    /// Why it goes.
    pub why: String,
}

/// A session that would have gone and stays.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Spared {
    /// Its id.
    pub id: String,
    /// Why it stays.
    pub why: String,
}

/// What pruning did.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Pruned {
    /// The oldest first.
    pub removed: Vec<Removed>,
    /// What age or size would have taken and something else kept.
    pub spared: Vec<Spared>,
    /// What the sessions of the folder take afterwards, bytes.
    pub left: u64,
}

/// Mark beside a session that was exported whole.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exported {
    /// When.
    pub at: DateTime<Utc>,
    /// Sequence of the last frame that was exported.
    pub last: u64,
    /// As what: `csv`.
    pub format: String,
    /// Where to.
    pub to: String,
}

/// Marks a session as exported, in a file beside it.
///
/// # Errors
/// The mark cannot be written.
pub fn mark_exported(path: impl AsRef<Path>, exported: &Exported) -> Result<(), LogbookError> {
    let mark = path.as_ref().with_extension(EXPORTED);
    let text = serde_json::to_string(exported).unwrap_or_default() + "\n";
    // whoever owns the folder may have put a link there, and root may be the one who exports
    outfile::write(&mark, Existing::Replace, text.as_bytes())
        .map_err(|refused| LogbookError::disk(&mark, "mark as exported", refused.into_io()))
}

/// Whether and when all of a session was exported.
pub fn exported(path: impl AsRef<Path>) -> Option<Exported> {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path.with_extension(EXPORTED)).ok()?;
    let mark: Exported = serde_json::from_str(&text).ok()?;
    let last = SessionReader::open(path).ok()?.last_sequence().ok()?;
    (mark.last >= last).then_some(mark)
}

/// Ids of the parts that were pruned from a folder.
pub(crate) fn pruned_parts(dir: &Path) -> BTreeSet<String> {
    #[derive(Deserialize)]
    struct Line {
        id: String,
    }
    let text = std::fs::read_to_string(dir.join(PRUNED)).unwrap_or_default();
    text.lines()
        .filter_map(|line| serde_json::from_str::<Line>(line).ok())
        .map(|line| line.id)
        .collect()
}

/// Removes sessions, or with `dry_run` only says which. Never one that is not closed, nor any part of it (but for a
/// ring), nor the newest baseline, nor a baseline that a session which stays was measured against. What went is written
/// down in `pruned.jsonl` beside them.
///
/// # Errors
/// The folder cannot be read, or a file not be removed: what went before is gone.
pub fn prune(
    dir: impl AsRef<Path>,
    retention: &Retention,
    now: DateTime<Utc>,
    dry_run: bool,
) -> Result<Pruned, LogbookError> {
    let dir = dir.as_ref();
    let sessions = list(dir)?.sessions;
    let mut pruned = Pruned::default();
    let sizes: Vec<u64> = sessions
        .iter()
        .map(|session| Ok(beside(&session.path)?.iter().map(|file| size(file)).sum()))
        .collect::<Result<_, LogbookError>>()?;
    pruned.left = sizes.iter().sum();
    let open: BTreeSet<&str> = sessions
        .iter()
        .filter(|session| session.closed.is_none())
        .map(|session| part_of(&session.id).0)
        .collect();
    let newest_baseline = crate::latest_baseline(dir, now)?.map(|(session, _)| session.id);
    let mut going = vec![None; sessions.len()];
    // Measurements first: a baseline is small, and goes only when nobody who stays was measured against it.
    let (baselines, measurements): (Vec<usize>, Vec<usize>) =
        (0..sessions.len()).partition(|index| sessions[*index].kind == SessionKind::Baseline);
    for index in measurements.into_iter().chain(baselines) {
        let session = &sessions[index];
        let Some(reason) = due(session, retention, now, pruned.left) else {
            continue;
        };
        let spared = if session.closed.is_none() {
            Some("it is not closed")
        } else if open.contains(part_of(&session.id).0) && !retention.ring {
            Some("its session still runs")
        } else if newest_baseline.as_deref() == Some(&session.id) {
            Some("it is the newest baseline")
        } else if retention.exported_only && exported(&session.path).is_none() {
            Some("it has not been exported")
        } else if session.kind == SessionKind::Baseline && is_needed(session, &sessions, &going) {
            Some("a session that stays was measured against it")
        } else {
            None
        };
        match spared {
            Some(why) => pruned.spared.push(Spared {
                id: session.id.clone(),
                why: why.to_owned(),
            }),
            None => {
                going[index] = Some(reason);
                pruned.left -= sizes[index];
            }
        }
    }
    for ((session, why), bytes) in sessions.iter().zip(going).zip(sizes) {
        let Some(why) = why else {
            continue;
        };
        let removed = Removed {
            id: session.id.clone(),
            path: session.path.clone(),
            bytes,
            why,
        };
        if !dry_run {
            remove(dir, &removed, now)?;
        }
        pruned.removed.push(removed);
    }
    Ok(pruned)
}

/// Whether a session that stays was measured against a baseline.
fn is_needed(
    baseline: &SessionSummary,
    sessions: &[SessionSummary],
    going: &[Option<String>],
) -> bool {
    sessions
        .iter()
        .zip(going)
        .filter(|(session, going)| going.is_none() && session.kind == SessionKind::Measurement)
        .filter_map(|(session, _)| SessionReader::open(&session.path).ok()?.baseline().ok()?)
        .any(|of| of.id == baseline.id)
}

fn due(
    session: &SessionSummary,
    retention: &Retention,
    now: DateTime<Utc>,
    left: u64,
) -> Option<String> {
    let last = session.last.unwrap_or(session.started);
    if let Some(age) = retention.older_than
        && (now - last).to_std().is_ok_and(|since| since > age)
    {
        return Some(format!(
            "its last frame is of {}",
            last.format("%Y-%m-%d %H:%M")
        ));
    }
    match retention.keep_bytes {
        Some(most) if left > most => {
            return Some(format!("sessions take {left} bytes, {most} may stay"));
        }
        _ => {}
    }
    (retention.exported_only && retention.older_than.is_none() && retention.keep_bytes.is_none())
        .then(|| "it has been exported".to_owned())
}

/// A session's file and all that belongs to it: journal, mark, transcripts of failed frames.
fn beside(path: &Path) -> Result<Vec<PathBuf>, LogbookError> {
    let dir = crate::directory::folder_of(path);
    let id = crate::directory::id_of(path);
    let listing = std::fs::read_dir(dir).map_err(|source| LogbookError::Io {
        path: dir.to_owned(),
        attempt: "list",
        source,
    })?;
    let own = [format!("{id}."), format!("{id}-failed-")];
    let mut files: Vec<PathBuf> = listing
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|file| {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            file != path && own.iter().any(|own| name.starts_with(own))
        })
        .collect();
    files.push(path.to_owned());
    Ok(files)
}

fn size(file: &Path) -> u64 {
    std::fs::metadata(file).map_or(0, |found| found.len())
}

fn remove(dir: &Path, removed: &Removed, now: DateTime<Utc>) -> Result<(), LogbookError> {
    #[derive(Serialize)]
    struct Line<'a> {
        at: DateTime<Utc>,
        id: &'a str,
        why: &'a str,
    }
    let line = Line {
        at: now,
        id: &removed.id,
        why: &removed.why,
    };
    // Said first: what is gone without a word could not be told from what was lost.
    let list = dir.join(PRUNED);
    let said = || -> std::io::Result<()> {
        let mut file = std::fs::OpenOptions::new()
            .create(true)
            .append(true)
            .open(&list)?;
        writeln!(file, "{}", serde_json::to_string(&line)?)
    };
    said().map_err(|source| LogbookError::disk(&list, "write what is removed to", source))?;
    for file in beside(&removed.path)? {
        std::fs::remove_file(&file).map_err(|source| LogbookError::Io {
            path: file.clone(),
            attempt: "remove",
            source,
        })?;
    }
    Ok(())
}

/// What all sessions of a folder take with everything beside them, bytes.
///
/// # Errors
/// The folder cannot be read.
pub fn folder_bytes(dir: impl AsRef<Path>) -> Result<u64, LogbookError> {
    let mut all = 0;
    for path in files(dir.as_ref())? {
        all += beside(&path)?.iter().map(|file| size(file)).sum::<u64>();
    }
    Ok(all)
}
