//! Retention: removes sessions by age or size, optionally only exported ones.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

use chrono::{DateTime, Utc};
use outfile::Existing;
use serde::{Deserialize, Serialize};

use crate::directory::index;
use crate::files::lines::{append_line, open_for_lines};
use crate::files::{EXTENSION, entries, id_of, open_at_once, part_of, path_of};
use crate::{Index, LogbookError, SessionKind, SessionReader, SessionSummary, StateKind};

/// Name of the list of pruned sessions, one JSON object on each line.
const PRUNED: &str = "pruned.jsonl";
/// End of the name of a marker file of an exported session.
const EXPORTED: &str = "exported.json";

/// Which sessions to remove.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Retention {
    /// Sessions whose last frame is older.
    pub older_than: Option<Duration>,
    /// The oldest sessions, until the files of all sessions in the folder take at most this many bytes.
    pub keep_bytes: Option<u64>,
    /// Only completely exported sessions of those; without age and size, all exported sessions.
    pub exported_only: bool,
    /// Only archived sessions of those; without age and size, all archived sessions.
    pub archived_only: bool,
    /// Whether the earlier, closed parts of a running session may be removed too (a ring).
    pub ring: bool,
}

/// A session or part that was removed, or would be.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Removed {
    /// Its id.
    pub id: String,
    /// Its file.
    pub path: PathBuf,
    /// Size with all companion files, bytes.
    pub bytes: u64,
    /// Why it is removed.
    pub why: String,
}

/// A session that was selected but kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct KeptSession {
    /// Its id.
    pub id: String,
    /// Why it is kept.
    pub why: String,
}

/// Result of pruning.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Pruned {
    /// Oldest first.
    pub removed: Vec<Removed>,
    /// Sessions selected by age or size but kept by another rule, and files that cannot be read, which are never
    /// removed.
    pub spared: Vec<KeptSession>,
    /// Remaining size of the folder's sessions, bytes.
    pub left: u64,
}

/// Marker of a completely exported session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExportMarker {
    /// When.
    pub at: DateTime<Utc>,
    /// Sequence of the last frame that was exported.
    pub last: u64,
    /// The format: `csv`, `nc` or `parquet`.
    pub format: String,
    /// The destination.
    pub to: String,
}

/// Marks a session as exported, in a file next to it.
///
/// # Errors
/// The mark cannot be written.
pub fn mark_exported(path: impl AsRef<Path>, exported: &ExportMarker) -> Result<(), LogbookError> {
    let mark = path.as_ref().with_extension(EXPORTED);
    let text = serde_json::to_string(exported).unwrap_or_default() + "\n";
    // the folder's owner may have put a link there, and the exporting user may be root
    outfile::write(&mark, Existing::Replace, text.as_bytes())
        .map_err(|refused| LogbookError::disk(&mark, "mark as exported", refused.into_io()))
}

/// When and how a session was completely exported; `None` if it was not.
pub fn exported(path: impl AsRef<Path>) -> Option<ExportMarker> {
    let path = path.as_ref();
    let text = std::fs::read_to_string(path.with_extension(EXPORTED)).ok()?;
    let mark: ExportMarker = serde_json::from_str(&text).ok()?;
    let last = SessionReader::open(path).ok()?.last_sequence().ok()?;
    (mark.last >= last).then_some(mark)
}

/// Ids of the parts that were pruned from a folder.
pub(crate) fn pruned_parts(dir: &Path) -> BTreeSet<String> {
    #[derive(Deserialize)]
    struct Line {
        id: String,
    }
    let read = || -> std::io::Result<Vec<u8>> {
        let file = open_at_once(&dir.join(PRUNED))?;
        // not to its end, which a device in its place may not have
        let (length, mut bytes) = (file.metadata()?.len(), Vec::new());
        file.take(length).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    read()
        .unwrap_or_default()
        .split(|byte| *byte == b'\n')
        .filter_map(|line| serde_json::from_slice::<Line>(line).ok())
        .map(|line| line.id)
        .collect()
}

/// Removes sessions, or with `dry_run` only lists them. Open sessions and their parts (except in a ring), the newest
/// baseline (all baselines if it cannot be read), and baselines of kept sessions are never removed. Quantities and
/// states of a session are kept until its last part is removed. Removed sessions are listed in `pruned.jsonl` in the
/// folder.
///
/// # Errors
/// The folder cannot be read, the disk is too full for the list, or a file cannot be removed: the first such error,
/// after the other sessions are removed, with `keep_bytes` also those whose space is needed instead.
pub fn prune(
    dir: impl AsRef<Path>,
    retention: &Retention,
    now: DateTime<Utc>,
    dry_run: bool,
) -> Result<Pruned, LogbookError> {
    prune_each(dir, retention, now, dry_run, |_| {})
}

/// As [`prune()`]; `each` is called for each session as soon as it is removed, so that the caller knows the removals
/// if others fail.
///
/// # Errors
/// As [`prune()`].
pub fn prune_each(
    dir: impl AsRef<Path>,
    retention: &Retention,
    now: DateTime<Utc>,
    dry_run: bool,
    mut each: impl FnMut(&Removed),
) -> Result<Pruned, LogbookError> {
    let dir = dir.as_ref();
    let index = index(dir)?;
    let sessions = index.listing().sessions;
    let files = by_session(dir)?;
    let of = |session: &SessionSummary| {
        files
            .get(id_of(&session.path))
            .map_or(&[][..], Vec::as_slice)
    };
    let sizes: Vec<u64> = sessions
        .iter()
        .map(|session| of(session).iter().map(|file| size(file)).sum())
        .collect();
    let mut pruned = Pruned {
        left: sizes.iter().sum(),
        ..Pruned::default()
    };
    let mut removals = vec![Removal::NotDue; sessions.len()];
    let mut failed = None;
    let mut again = true;
    while again {
        again = false;
        pruned.spared = select(
            &index,
            &sessions,
            &sizes,
            pruned.left,
            retention,
            now,
            &mut removals,
        );
        let go = sessions
            .iter()
            .zip(&removals)
            .filter(|(_, removal)| !removal.keeps());
        let go: BTreeSet<&str> = go.map(|(session, _)| id_of(&session.path)).collect();
        let stay = files.keys().filter(|id| !go.contains(id.as_str()));
        let stay: BTreeSet<&str> = stay.map(|id| part_of(id).0).collect();
        for (session, removal) in sessions.iter().zip(&mut removals) {
            let Removal::Due(why) = removal else {
                continue;
            };
            let part_of_it_stays = stay.contains(part_of(id_of(&session.path)).0);
            let go = of(session)
                .iter()
                .filter(|file| !(part_of_it_stays && is_of_all_parts(file)));
            let go: Vec<&Path> = go.map(PathBuf::as_path).collect();
            let removed = Removed {
                id: session.id.clone(),
                path: session.path.clone(),
                bytes: go.iter().map(|file| size(file)).sum(),
                why: std::mem::take(why),
            };
            if !dry_run && let Err(error) = remove(dir, &removed, &go, now) {
                // this session is gone without a line: no other one may be
                if error.is_full() {
                    return Err(error);
                }
                failed.get_or_insert(error);
                *removal = Removal::Failed;
                // others may be due in its place
                again = true;
                continue;
            }
            *removal = Removal::Done;
            pruned.left = pruned.left.saturating_sub(removed.bytes);
            each(&removed);
            pruned.removed.push(removed);
        }
    }
    match failed {
        Some(error) => Err(error),
        None => Ok(pruned),
    }
}

/// The state of a session's removal.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Removal {
    NotDue,
    /// It is to be removed, for this reason.
    Due(String),
    Done,
    /// It could not be removed.
    Failed,
}

impl Removal {
    fn keeps(&self) -> bool {
        matches!(self, Self::NotDue | Self::Failed)
    }
}

/// Selects the sessions that are due, of those that are still there, which take `left` bytes. Returns those selected by
/// age or size but kept by another rule, and files that cannot be read.
fn select(
    index: &Index,
    sessions: &[SessionSummary],
    sizes: &[u64],
    mut left: u64,
    retention: &Retention,
    now: DateTime<Utc>,
    removals: &mut [Removal],
) -> Vec<KeptSession> {
    let mut kept = Vec::new();
    let open: BTreeSet<&str> = sessions
        .iter()
        .filter(|session| session.closed.is_none())
        .map(|session| part_of(&session.id).0)
        .collect();
    let newest = index.latest_baseline(now);
    // if it cannot be read, the newest readable baseline is unknown
    let unread = newest.is_err();
    let newest_baseline = newest.ok().flatten().map(|(session, _)| session.id);
    // Measurements first: a baseline is small, and is removed only if no kept session needs it.
    let (baselines, measurements): (Vec<usize>, Vec<usize>) =
        (0..sessions.len()).partition(|index| sessions[*index].kind == SessionKind::Baseline);
    // computed at the first baseline to be removed: by then the kept measurements are known
    let mut needed = None;
    for index in measurements.into_iter().chain(baselines) {
        if matches!(removals[index], Removal::Done | Removal::Failed) {
            continue;
        }
        let session = &sessions[index];
        let Some(reason) = due(session, retention, now, left) else {
            continue;
        };
        let spared = if session.closed.is_none() {
            Some("it is not closed")
        } else if open.contains(part_of(&session.id).0) && !retention.ring {
            Some("its session still runs")
        } else if newest_baseline.as_deref() == Some(&session.id) {
            Some("it is the newest baseline")
        } else if unread && session.kind == SessionKind::Baseline {
            Some("the newest baseline cannot be read")
        } else if retention.exported_only && exported(&session.path).is_none() {
            Some("it has not been exported")
        } else if retention.archived_only && super::receipts::archived(&session.path).is_none() {
            Some("the archive has no receipt for its present content")
        } else if session.kind == SessionKind::Baseline
            && needed
                .get_or_insert_with(|| needed_baselines(sessions, removals))
                .contains(&session.id)
        {
            Some("a session that is kept was measured against it")
        } else {
            None
        };
        match spared {
            Some(why) => kept.push(KeptSession {
                id: session.id.clone(),
                why: why.to_owned(),
            }),
            None => {
                removals[index] = Removal::Due(reason);
                left = left.saturating_sub(sizes[index]);
            }
        }
    }
    for unreadable in index.unreadable() {
        kept.push(KeptSession {
            id: id_of(&unreadable.path).to_owned(),
            why: format!("its age and frames cannot be read: {}", unreadable.why),
        });
    }
    kept
}

/// Ids of the baselines that kept sessions need.
fn needed_baselines(sessions: &[SessionSummary], removals: &[Removal]) -> BTreeSet<String> {
    sessions
        .iter()
        .zip(removals)
        .filter(|(session, removal)| removal.keeps() && session.kind == SessionKind::Measurement)
        .filter_map(|(session, _)| SessionReader::open(&session.path).ok()?.baseline().ok()?)
        .map(|baseline| baseline.id)
        .collect()
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
            return Some(format!("sessions take {left} bytes, {most} are allowed"));
        }
        _ => {}
    }
    let rules = [
        (retention.exported_only, "exported"),
        (retention.archived_only, "archived"),
    ];
    let names: Vec<&str> = rules
        .iter()
        .filter_map(|(set, name)| set.then_some(*name))
        .collect();
    let alone = retention.older_than.is_none() && retention.keep_bytes.is_none();
    (alone && !names.is_empty()).then(|| format!("it has been {}", names.join(" and ")))
}

/// The files of a folder for each session or part: its own file, journals, marker, transcripts of failed frames; for
/// the last part also the files that belong to all parts. Scans the directory once; files that belong to no session
/// are left out. A session's own file is the last in its list.
fn by_session(dir: &Path) -> Result<BTreeMap<String, Vec<PathBuf>>, LogbookError> {
    let mut sessions: BTreeMap<String, Vec<PathBuf>> = BTreeMap::new();
    let mut beside = Vec::new();
    for path in entries(dir)? {
        match path.extension().is_some_and(|end| end == EXTENSION) {
            true => drop(sessions.insert(id_of(&path).to_owned(), Vec::new())),
            false => beside.push(path),
        }
    }
    beside.sort();
    let mut last_parts: BTreeMap<String, (u32, String)> = BTreeMap::new();
    for id in sessions.keys() {
        let (session, number) = part_of(id);
        let last = last_parts.entry(session.to_owned()).or_default();
        *last = (number, id.clone()).max(std::mem::take(last));
    }
    for path in beside {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let owner = owner(&name);
        let last_part = last_parts.get(owner).filter(|_| is_of_all_parts(&path));
        let owner = last_part.map_or(owner, |(_, id)| id);
        if let Some(files) = sessions.get_mut(owner) {
            files.push(path);
        }
    }
    for (id, files) in &mut sessions {
        files.push(path_of(dir, id));
    }
    Ok(sessions)
}

/// Whether a file next to a session belongs to all its parts. It has the name of the first part and is removed with
/// the last remaining one.
fn is_of_all_parts(file: &Path) -> bool {
    let states = [StateKind::Tracking, StateKind::Course].map(StateKind::extension);
    let endings = [states[0], states[1], crate::quantities::QUANTITIES];
    file.extension()
        .is_some_and(|end| endings.iter().any(|ending| end == *ending))
}

/// The session that a companion file belongs to, by its name.
fn owner(name: &str) -> &str {
    // a copy's name may contain a dot, an id cannot
    let journal = [".tactus-wal", ".tactus-shm", ".tactus-journal"];
    if let Some(id) = journal.iter().find_map(|end| name.strip_suffix(end)) {
        return id;
    }
    let id = name.split_once('.').map_or(name, |(id, _)| id);
    id.split_once("-failed-").map_or(id, |(id, _)| id)
}

fn size(file: &Path) -> u64 {
    std::fs::metadata(file).map_or(0, |found| found.len())
}

fn remove(
    dir: &Path,
    removed: &Removed,
    files: &[&Path],
    now: DateTime<Utc>,
) -> Result<(), LogbookError> {
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
    // Written before the files are removed, if there is space for it: otherwise a pruned session could not be
    // distinguished from a lost one.
    let list = dir.join(PRUNED);
    let append = || -> std::io::Result<()> {
        // a session whose files could not be removed is tried again, in the ring several times a second
        if pruned_parts(dir).contains(&removed.id) {
            return Ok(());
        }
        append_line(&mut open_for_lines(&list)?, &serde_json::to_vec(&line)?)
    };
    let append =
        || append().map_err(|source| LogbookError::disk(&list, "write what is removed to", source));
    let late = match append() {
        // on a full disk there is space for the line after the files are removed
        Err(error) if error.is_full() => true,
        written => {
            written?;
            false
        }
    };
    for file in files {
        match std::fs::remove_file(file) {
            // a journal that the last reader of its session has removed in the meantime
            Err(gone) if gone.kind() == ErrorKind::NotFound => {}
            removed => removed.map_err(|source| LogbookError::io(file, "remove", source))?,
        }
    }
    if late { append() } else { Ok(()) }
}

/// Size of all sessions of a folder with their companion files, bytes.
///
/// # Errors
/// The folder cannot be read.
pub fn folder_bytes(dir: impl AsRef<Path>) -> Result<u64, LogbookError> {
    let files = by_session(dir.as_ref())?;
    Ok(files.values().flatten().map(|file| size(file)).sum())
}
