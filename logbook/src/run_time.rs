//! How long a session has run, over its parts and processes.

use std::path::Path;
use std::time::Duration;

use chrono::{DateTime, Utc};

use crate::files::parts;
use crate::{LogbookError, RESUMED, SessionReader, Taken};

/// How long a session had run when its last frame was taken, over all parts: within one process by the monotonic clock,
/// so that a wall clock that was set does not count, and between two processes by the wall clock. Frames of the first
/// parts, if these are deleted or cannot be read, count with the mean period of the others.
///
/// # Errors
/// The folder cannot be read.
pub fn time_run(path: impl AsRef<Path>) -> Result<Duration, LogbookError> {
    let files = parts(path)?;
    let readable = files
        .iter()
        .filter_map(|part| SessionReader::open(part).ok());
    let readers: Vec<SessionReader> = readable.collect();
    let Some(header) = readers.first().map(SessionReader::header) else {
        return Ok(Duration::ZERO);
    };
    let mut time = RunTime {
        started: header.continues.is_none().then_some(header.started),
        restarts: Vec::new(),
        last: None,
        run: Duration::ZERO,
    };
    for part in &readers {
        let events = part.events().unwrap_or_default();
        let restarts = events.iter().filter(|event| event.kind == RESUMED);
        time.restarts.extend(restarts.map(|event| event.at));
    }
    let mut last = 0;
    for (index, part) in readers.iter().enumerate() {
        // frames that the next part contains too are valid there
        let next = readers.get(index + 1);
        let next = next.map_or(u64::MAX, |next| next.header().first_sequence);
        let first = part.header().first_sequence;
        last = part.last_sequence().unwrap_or(0).min(next - 1);
        for start in part.stretch_starts(first, last).unwrap_or_default() {
            if start > first {
                time.follow(part.taken(start - 1).ok().flatten());
            }
            time.begin_stretch(part.taken(start).ok().flatten());
        }
        time.follow(part.taken(last).ok().flatten());
    }
    let missing = header.first_sequence - 1;
    let periods = last.saturating_sub(header.first_sequence);
    if missing == 0 || periods == 0 {
        return Ok(time.run);
    }
    let period = time.run.as_secs_f64() / periods as f64;
    let before = survey::duration(period * missing as f64);
    Ok(time.run.saturating_add(before))
}

/// Adds the times between frames.
struct RunTime {
    /// When the session started, unless its first part is missing.
    started: Option<DateTime<Utc>>,
    /// Wall times at which processes resumed the session, other than those that were recognised.
    restarts: Vec<DateTime<Utc>>,
    last: Option<Taken>,
    run: Duration,
}

impl RunTime {
    /// A frame of the same process as the frame before.
    fn follow(&mut self, taken: Option<Taken>) {
        let Some(taken) = taken else {
            return;
        };
        if let Some(last) = self.last.replace(taken) {
            let since = taken.monotonic.saturating_sub(last.monotonic);
            self.run = self.run.saturating_add(since);
        }
    }

    /// The first frame of a stretch, which may be the first one of another process.
    fn begin_stretch(&mut self, taken: Option<Taken>) {
        let Some(taken) = taken else {
            return;
        };
        let since = |at: DateTime<Utc>| (taken.wall - at).to_std().ok();
        // the monotonic clock starts at 0 with the process
        let is_of_process =
            |at: &DateTime<Utc>| since(*at).is_some_and(|since| since <= taken.monotonic);
        let restart = self.restarts.iter().position(is_of_process);
        if let Some(restart) = restart {
            self.restarts.remove(restart);
        }
        let Some(last) = self.last else {
            let begun = self.started.and_then(since).unwrap_or_default();
            self.run = begun.min(taken.monotonic);
            self.last = Some(taken);
            return;
        };
        if restart.is_none() && taken.monotonic >= last.monotonic {
            return self.follow(Some(taken));
        }
        // this process started after the last frame of the previous one
        let gap = since(last.wall).unwrap_or_default().max(taken.monotonic);
        self.run = self.run.saturating_add(gap);
        self.last = Some(taken);
    }
}
