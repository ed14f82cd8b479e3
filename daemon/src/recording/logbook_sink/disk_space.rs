//! Disk space of the record: an early alarm, and a policy for a full disk, a lock or an I/O error. Acknowledged frames
//! are safe; the current frame waits.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::events::kind::EventKind;
use logbook::{DiskFault, LogbookError, Retention, SessionWriter};
use rig::Clock;

use crate::events::event::Event;
use crate::monitoring::heartbeat::Part;
use crate::recording::logbook_sink::{LogbookSink, WRITE_TIME_LIMIT};
use crate::recording::published::Published;
use config::{FullName, RecordSection};
use survey::error_chain as chain;

/// Time between two checks for space.
const SPACE_CHECK_INTERVAL: Duration = Duration::from_millis(200);
pub(super) const MEGABYTE: u64 = 1_000_000;
/// Minimum space that is freed at a time with `when_full = "ring"`, bytes.
const LEAST_DELETED: u64 = 16 * MEGABYTE;
/// Time to wait for another process's lock before the session continues in the next part.
const LOCK_TIMEOUT: Duration = Duration::from_secs(30);

type Free = Box<dyn Fn(&Path) -> std::io::Result<u64> + Send>;

/// State of the policy for low space, a full disk, or a lock.
pub(crate) struct DiskPolicy {
    pub(super) section: RecordSection,
    free: Free,
    /// Whether the low-space alarm has been reported.
    low: bool,
    /// The day of the last frame.
    pub(super) day: Option<chrono::NaiveDate>,
    /// Whether the next part could not be created, which is reported once.
    pub(super) part_refused: bool,
    /// The pause in progress.
    paused: Option<Pause>,
    /// How long to wait for another process's lock.
    pub(in crate::recording) lock_patience: Duration,
    /// Why a session could not be deleted, which is reported once.
    undeletable: Option<String>,
    /// Events waiting for space.
    pub(in crate::recording) unwritten: VecDeque<Event>,
}

/// A pause of the record, during which acquisition is held.
struct Pause {
    since: Duration,
    why: String,
    /// Whether it began with a lock rather than without space.
    locked: bool,
    /// Since when it has waited for a lock; `None` while it waits for space.
    locked_since: Option<Duration>,
}

impl DiskPolicy {
    pub(crate) fn new(section: RecordSection, free: Free) -> Self {
        Self {
            section,
            free,
            low: false,
            day: None,
            part_refused: false,
            paused: None,
            lock_patience: LOCK_TIMEOUT,
            undeletable: None,
            unwritten: VecDeque::new(),
        }
    }

    /// How long frames are collected for one sync.
    pub(in crate::recording) fn gathers(&self) -> Duration {
        Duration::from_millis(self.section.group_ms)
    }
}

impl LogbookSink {
    /// Writes frames with one sync; waits for space as long as needed.
    ///
    /// # Errors
    /// A permanent disk error, or the session was requested to end while there was no space.
    pub(super) fn store(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError> {
        let mut free = self.free();
        self.warn_early(free)?;
        let mut renewed = false;
        loop {
            // the reserve is kept for the end of a session
            if let Some(full) = self.lacks_space(free)
                && !self.status.stop_request().is_requested()
            {
                let waited = self.pause(full);
                if !self.status.stop_request().is_requested() {
                    waited?;
                }
                free = self.free();
                continue;
            }
            let each = frames
                .iter()
                .map(|published| (&published.frame, published.record.as_ref()));
            match self.writer.append_all(each) {
                Ok(last) => {
                    debug_assert_eq!(Some(last), frames.last().map(|last| last.frame.sequence));
                    self.end_pause();
                    return Ok(());
                }
                Err(error) => {
                    self.handle_failure(error, &mut renewed)?;
                    free = self.free();
                }
            }
        }
    }

    /// Handles a failed write, which is then retried. A new part is created once.
    fn handle_failure(
        &mut self,
        error: LogbookError,
        renewed: &mut bool,
    ) -> Result<(), LogbookError> {
        let renews = error.needs_successor() || error.is_locked() && self.has_waited_for_the_lock();
        if renews && !*renewed {
            return match self.renew(&error) {
                Ok(()) => {
                    *renewed = true;
                    Ok(())
                }
                // SQLite reports an I/O error if there is no space for the index of a new journal
                Err(refused) if refused.is_full() || self.lacks_space_for_a_part() => {
                    self.pause(refused)
                }
                Err(refused) => Err(refused),
            };
        }
        match error.is_full() || error.is_locked() && !*renewed {
            true => self.pause(error),
            false => Err(error),
        }
    }

    fn lacks_space_for_a_part(&self) -> bool {
        self.free().is_some_and(|free| free < MEGABYTE)
    }

    /// Whether the wait for the lock is over: it has timed out, or the end of the session was requested.
    fn has_waited_for_the_lock(&self) -> bool {
        let now = self.clock.monotonic();
        let pause = self.disk.paused.as_ref();
        let since = pause.and_then(|pause| pause.locked_since);
        let waited = since.map_or(Duration::ZERO, |since| now.saturating_sub(since));
        waited >= self.disk.lock_patience || self.status.stop_request().is_requested()
    }

    /// Writes data other than frames, with the same handling of errors; does not keep the reserve free.
    pub(in crate::recording) fn persist(
        &mut self,
        write: impl Fn(&mut SessionWriter) -> Result<(), LogbookError>,
    ) -> Result<(), LogbookError> {
        let mut renewed = false;
        loop {
            match write(&mut self.writer) {
                Ok(()) => {
                    self.end_pause();
                    return Ok(());
                }
                Err(error) => self.handle_failure(error, &mut renewed)?,
            }
        }
    }

    /// Reports once when space is low, and once when there is enough again.
    fn warn_early(&mut self, free: Option<u64>) -> Result<(), LogbookError> {
        let Some(free) = free else {
            return Ok(());
        };
        let warn = self.disk.section.warn_below_mb * MEGABYTE;
        if free >= warn + warn / 10 && self.disk.low {
            self.disk.low = false;
            self.note(
                EventKind::DiskEnough,
                "there is enough space for the record again",
            );
            return self.settle_what_fits();
        }
        if free >= warn || self.disk.low {
            return Ok(());
        }
        self.disk.low = true;
        let text = format!(
            "{} MB are left for the record in {}; at {} MB {}",
            free / MEGABYTE,
            self.folder().display(),
            self.disk.section.reserve_mb,
            match self.disk.section.when_full {
                FullName::Stop => "acquisition pauses until there is space",
                FullName::Ring => "the oldest closed sessions are deleted",
            }
        );
        self.note(EventKind::DiskLow, &text);
        // there may be no space for this event either, which the next write reports
        self.settle_what_fits()
    }

    /// The error if less space than the reserve is free; during a pause, 10 % more is required.
    fn lacks_space(&self, free: Option<u64>) -> Option<LogbookError> {
        let mut wanted = self.disk.section.reserve_mb * MEGABYTE;
        if self.disk.paused.is_some() {
            wanted += wanted / 10;
        }
        let free = free.filter(|free| *free < wanted)?;
        Some(LogbookError::DiskRefused {
            path: self.writer.path().to_owned(),
            attempt: "keep record.reserve_mb free beside",
            fault: DiskFault::Full,
            source: format!("{} MB are left", free / MEGABYTE).into(),
        })
    }

    /// Handles a full disk or a lock: frees space if `when_full = "ring"`, otherwise holds acquisition and waits for a
    /// moment. A pause is reported once.
    fn pause(&mut self, full: LogbookError) -> Result<(), LogbookError> {
        let locked = full.is_locked();
        let mut why = chain(&full);
        if !locked && self.disk.section.when_full == FullName::Ring {
            match self.delete_oldest() {
                Ok(true) => return self.settle_what_fits(),
                Ok(false) => self.settle_what_fits()?,
                // reported with the pause, and tried again until there is space
                Err(refused) => {
                    let refused = chain(&refused);
                    why = format!("{why}; the oldest sessions could not be deleted: {refused}");
                }
            }
        }
        if self.disk.paused.is_none() {
            let text = format!("acquisition pauses, the source is off: {why}");
            self.disk.paused = Some(Pause {
                since: self.clock.monotonic(),
                why,
                locked,
                locked_since: None,
            });
            self.status.set_last_error(&text);
            self.status.hold(true);
            // only reported: the record cannot be written now; it gets an event at the end of the pause
            let kind = match locked {
                true => EventKind::RecordLocked,
                false => EventKind::DiskFull,
            };
            self.report(kind, &text);
        }
        if let Some(pause) = &mut self.disk.paused {
            let since = pause.locked_since.unwrap_or(self.clock.monotonic());
            pause.locked_since = locked.then_some(since);
        }
        if self.status.stop_request().is_requested() {
            self.status.hold(false);
            // a file that stays locked is given up: the next attempt creates the next part
            return if locked { Ok(()) } else { Err(full) };
        }
        std::thread::sleep(SPACE_CHECK_INTERVAL);
        let now = self.clock.monotonic();
        self.heartbeats
            .set_deadline(Part::Record, now, WRITE_TIME_LIMIT);
        Ok(())
    }

    /// Ends a pause after a successful write, and writes an event about it.
    fn end_pause(&mut self) {
        let Some(Pause {
            since, why, locked, ..
        }) = self.disk.paused.take()
        else {
            return;
        };
        let waited = self.clock.monotonic().saturating_sub(since);
        self.status.set_last_error("");
        self.status.hold(false);
        let (kind, now) = match locked {
            true => (
                EventKind::RecordUnlocked,
                "the session file can be written again",
            ),
            false => (EventKind::DiskSpace, "there is space again"),
        };
        let text = format!(
            "acquisition had paused for {:.0} s: {why}; {now}",
            waited.as_secs_f64()
        );
        self.note(kind, &text);
    }

    fn free(&self) -> Option<u64> {
        (self.disk.free)(self.folder()).ok()
    }

    fn folder(&self) -> &Path {
        logbook::folder_of(self.writer.path())
    }

    /// Deletes the oldest sessions; reports each, also those beside one that cannot be deleted, which is reported once.
    /// Returns whether something was deleted.
    fn delete_oldest(&mut self) -> Result<bool, LogbookError> {
        let folder = self.folder().to_owned();
        let wanted = self.disk.section.reserve_mb * MEGABYTE;
        let lacking = (wanted + wanted / 10).saturating_sub(self.free().unwrap_or(0));
        let keeps = logbook::folder_bytes(&folder)?.saturating_sub(lacking.max(LEAST_DELETED));
        let retention = Retention {
            keep_bytes: Some(keeps),
            ring: true,
            ..Retention::default()
        };
        let now = self.clock.wall();
        let mut deleted = false;
        let pruned = logbook::prune_each(&folder, &retention, now, false, |removed| {
            deleted = true;
            let text = format!(
                "{} was deleted to free space, {:.1} MB (record.when_full = \"ring\")",
                removed.path.display(),
                removed.bytes as f64 / MEGABYTE as f64
            );
            self.note(EventKind::SessionDeleted, &text);
        });
        match pruned {
            Err(error) if deleted => {
                let why = chain(&error);
                if self.disk.undeletable.as_ref() != Some(&why) {
                    let text = format!("{why}; younger sessions are deleted instead");
                    self.note(EventKind::SessionNotDeleted, &text);
                    self.disk.undeletable = Some(why);
                }
            }
            pruned => {
                pruned?;
                self.disk.undeletable = None;
            }
        }
        Ok(deleted)
    }
}
