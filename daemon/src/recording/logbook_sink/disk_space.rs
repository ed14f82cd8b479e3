//! The disk under the record: alarm while there is still room, a policy for when there is none, a new part of the session
//! when the old file cannot be trusted, is locked or gone, or has grown enough. What is acknowledged stays; what is in
//! hand waits.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use crate::events::kind::EventKind;
use chrono::{DateTime, Utc};
use logbook::{DiskFault, LogbookError, Retention, SessionWriter};
use rig::Clock;

use crate::events::event::Event;
use crate::monitoring::heartbeat::Part;
use crate::recording::logbook_sink::{FOR_A_WRITE, LogbookSink};
use crate::recording::published::Published;
use config::{FullName, RecordSection};
use survey::error_chain as chain;

/// Between two looks whether there is room again.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
const MEGABYTE: u64 = 1_000_000;
/// A ring makes room for more than the next frame.
const LEAST_DELETED: u64 = 16 * MEGABYTE;
/// A lock that another process holds on the file is waited for, and then the session goes on in the next part.
const LOCK_PATIENCE: Duration = Duration::from_secs(30);

type Free = Box<dyn Fn(&Path) -> std::io::Result<u64> + Send>;

/// What is done where there is little room, none, or a lock.
pub(crate) struct DiskPolicy {
    section: RecordSection,
    free: Free,
    /// Whether it has been said that little is left.
    low: bool,
    /// The day of the last frame.
    day: Option<chrono::NaiveDate>,
    /// Why nothing can be written at present.
    paused: Option<Pause>,
    /// How long a lock is waited for.
    pub(in crate::recording) lock_patience: Duration,
    /// Events that wait for room.
    pub(in crate::recording) unwritten: VecDeque<Event>,
}

/// A wait of the record, with acquisition held.
struct Pause {
    since: Duration,
    why: String,
    /// For the holder of a lock, not for room.
    locked: bool,
}

impl DiskPolicy {
    pub(crate) fn new(section: RecordSection, free: Free) -> Self {
        Self {
            section,
            free,
            low: false,
            day: None,
            paused: None,
            lock_patience: LOCK_PATIENCE,
            unwritten: VecDeque::new(),
        }
    }

    /// How long frames are gathered for one sync.
    pub(in crate::recording) fn gathers(&self) -> Duration {
        Duration::from_millis(self.section.group_ms)
    }
}

impl LogbookSink {
    /// Writes frames with one sync, however long it takes until there is room.
    ///
    /// # Errors
    /// The disk refuses in a way that does not pass, or the session was asked to end while there was no room.
    pub(super) fn store(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError> {
        let mut free = self.free();
        self.warn_early(free)?;
        let mut renewed = false;
        loop {
            // the reserve is for the end of a session
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
                    self.go_on();
                    return Ok(());
                }
                Err(error) => {
                    self.meet(error, &mut renewed)?;
                    free = self.free();
                }
            }
        }
    }

    /// What is done about a write that was refused; then it is tried again. A new part is made once.
    fn meet(&mut self, error: LogbookError, renewed: &mut bool) -> Result<(), LogbookError> {
        let renews = error.needs_successor() || error.is_locked() && self.has_waited_for_the_lock();
        if renews && !*renewed {
            return match self.renew(&error) {
                Ok(()) => {
                    *renewed = true;
                    Ok(())
                }
                // SQLite calls it an I/O error where there is no room for the index of a new journal
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

    /// Whether it was waited for long enough, or is not waited for because the session is to end.
    fn has_waited_for_the_lock(&self) -> bool {
        let now = self.clock.monotonic();
        let waited = match &self.disk.paused {
            Some(pause) if pause.locked => now.saturating_sub(pause.since),
            _ => Duration::ZERO,
        };
        waited >= self.disk.lock_patience || self.status.stop_request().is_requested()
    }

    /// Writes something else, under the same rules.
    pub(in crate::recording) fn persist(
        &mut self,
        write: impl Fn(&mut SessionWriter) -> Result<(), LogbookError>,
    ) -> Result<(), LogbookError> {
        let mut renewed = false;
        loop {
            match write(&mut self.writer) {
                Ok(()) => {
                    self.go_on();
                    return Ok(());
                }
                Err(error) => self.meet(error, &mut renewed)?,
            }
        }
    }

    /// The file grew enough, or a day began: the session goes on in its next part. Where that cannot be, it goes on in
    /// this one.
    pub(in crate::recording) fn roll(&mut self, at: DateTime<Utc>) -> Result<(), LogbookError> {
        let section = &self.disk.section;
        let before = self.disk.day.replace(at.date_naive());
        let new_day = section.roll_daily && before.is_some_and(|before| before != at.date_naive());
        let large = section.roll_mb > 0 && self.writer.bytes() > section.roll_mb * MEGABYTE;
        if !(new_day || large) {
            return Ok(());
        }
        match self.writer.roll(at) {
            Ok(_) => {
                self.status.set_path(self.writer.path());
                Ok(())
            }
            Err(error) if error.needs_successor() => self.renew(&error),
            // the next frame tries again
            Err(error) if error.is_locked() => Ok(()),
            Err(error) => self.write_event(EventKind::PartRefused, &chain(&error)),
        }
    }

    /// Behind what was acknowledged the session goes on in another file. After an I/O error nobody knows what of the old
    /// one is on disk, and asking again may be answered by memory; of one that was deleted the frames are copied.
    pub(in crate::recording) fn renew(&mut self, error: &LogbookError) -> Result<(), LogbookError> {
        let at = self.clock.wall();
        let why = chain(error);
        let rescued = error.is_gone().then(|| self.writer.rescue());
        let kept = match &rescued {
            None => String::new(),
            Some(Ok(copy)) => format!("; its frames are in {}", copy.display()),
            Some(Err(refused)) => format!(
                "; frames {} to {} were in it and could not be copied ({})",
                self.writer.header().first_sequence,
                self.writer.acknowledged(),
                chain(refused)
            ),
        };
        let left = self.writer.successor(at, &format!("{why}{kept}"))?;
        self.status.set_path(self.writer.path());
        let todo = match error {
            LogbookError::Gone { .. } => "do not touch the files of a session that runs",
            LogbookError::Locked { .. } => {
                "do not open the files of a session that runs for writing"
            }
            _ => "mend the disk",
        };
        let text = format!(
            "{} is written no more: {why}{kept}; the session goes on in {}; {todo}",
            left.display(),
            self.writer.path().display()
        );
        // the part says so itself
        self.report(EventKind::Alarm, &text);
        Ok(())
    }

    /// Looks whether the file is still in its place, where no frame comes by for a while.
    pub(in crate::recording) fn look_at_place(&mut self) -> Result<(), LogbookError> {
        match self.writer.check_place() {
            Err(gone) => self.renew(&gone),
            Ok(()) => Ok(()),
        }
    }

    /// Says once that room is running out, and once that there is enough again.
    fn warn_early(&mut self, free: Option<u64>) -> Result<(), LogbookError> {
        let Some(free) = free else {
            return Ok(());
        };
        let warn = self.disk.section.warn_below_mb * MEGABYTE;
        if free >= warn + warn / 10 && self.disk.low {
            self.disk.low = false;
            self.note(
                EventKind::DiskEnough,
                "there is enough room for the record again",
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
                FullName::Stop => "acquisition pauses until there is room",
                FullName::Ring => "the oldest closed sessions are deleted",
            }
        );
        self.note(EventKind::DiskLow, &text);
        // so little may be left that not even this fits: that is said next
        self.settle_what_fits()
    }

    /// Whether the reserve is reached; once paused, a tenth more is wanted.
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

    /// No room, or a lock: makes room by the policy, or holds acquisition and waits a little. Said once.
    fn pause(&mut self, full: LogbookError) -> Result<(), LogbookError> {
        let locked = full.is_locked();
        if !locked && self.disk.section.when_full == FullName::Ring && self.delete_oldest()? {
            return Ok(());
        }
        if self.disk.paused.is_none() {
            let why = chain(&full);
            let text = format!("acquisition pauses, the source is off: {why}");
            self.disk.paused = Some(Pause {
                since: self.clock.monotonic(),
                why,
                locked,
            });
            self.status.set_last_error(&text);
            self.status.hold(true);
            // it cannot be written to the record now, which has it afterwards
            let kind = match locked {
                true => EventKind::RecordLocked,
                false => EventKind::DiskFull,
            };
            self.report(kind, &text);
        }
        if self.status.stop_request().is_requested() {
            self.status.hold(false);
            // a file that stays locked is left for the next part, which the next attempt makes
            return if locked { Ok(()) } else { Err(full) };
        }
        std::thread::sleep(LOOK_AGAIN);
        let now = self.clock.monotonic();
        self.heartbeats.promise(Part::Record, now, FOR_A_WRITE);
        Ok(())
    }

    /// Something was written: a pause is over.
    fn go_on(&mut self) {
        let Some(Pause { since, why, locked }) = self.disk.paused.take() else {
            return;
        };
        let waited = self.clock.monotonic().saturating_sub(since);
        self.status.set_last_error("");
        self.status.hold(false);
        let (kind, now) = match locked {
            true => (EventKind::RecordUnlocked, "it can be written again"),
            false => (EventKind::DiskSpace, "there is room again"),
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
        self.writer.path().parent().unwrap_or(Path::new("."))
    }

    /// Whether something could be deleted; said of each.
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
        let pruned = logbook::prune(&folder, &retention, self.clock.wall(), false)?;
        for removed in &pruned.removed {
            let text = format!(
                "{} was deleted to make room, {:.1} MB (record.when_full = \"ring\")",
                removed.path.display(),
                removed.bytes as f64 / MEGABYTE as f64
            );
            self.note(EventKind::SessionDeleted, &text);
        }
        self.settle_what_fits()?;
        Ok(!pruned.removed.is_empty())
    }
}
