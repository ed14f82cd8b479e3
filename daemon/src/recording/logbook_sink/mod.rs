//! The session file as a sink: writes frames, events and the end of the session, and handles disk errors. The recorder
//! decides what is written.

mod continuity;
mod disk_space;
mod events;
mod parts;

pub(crate) use crate::recording::logbook_sink::disk_space::DiskPolicy;

use std::sync::Arc;
use std::time::Duration;

use chrono::{DateTime, Utc};
use logbook::{LogbookError, SessionWriter};
use rig::{Clock, SystemClock};

use crate::events::event_log::EventLog;
use crate::monitoring::heartbeat::{Heartbeats, IdleOnDrop, Part};
use crate::recording::frame_sink::FrameSink;
use crate::recording::published::Published;
use crate::recording::session_status::SessionStatus;
use survey::error_chain as chain;

/// Maximum time of a write; if it takes longer, the disk is considered to hang.
const WRITE_TIME_LIMIT: Duration = Duration::from_secs(60);

/// Writes one session.
pub(crate) struct LogbookSink {
    pub status: Arc<SessionStatus>,
    pub writer: SessionWriter,
    pub clock: SystemClock,
    pub events: EventLog,
    pub heartbeats: Arc<Heartbeats>,
    pub disk: DiskPolicy,
    /// The last frame before a gap of a resumed session, for comparison with the next frame.
    pub before: Option<logbook::FrameRecord>,
    /// Wall time at zero of the monotonic clock, computed from the last frame.
    pub began: Option<DateTime<Utc>>,
    /// Whether the frames are from a recording: they keep their wall times at any playback speed.
    pub is_recording: bool,
}

impl FrameSink for LogbookSink {
    fn frames(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError> {
        let Some(first) = frames.first() else {
            return Ok(());
        };
        self.roll(first.frame.wall)?;
        self.compare_with_previous(&first.frame)?;
        self.check_clock(&first.frame)?;
        self.store(frames)?;
        let now = self.clock.monotonic();
        for published in frames {
            let frame = &published.frame;
            let durable = now.saturating_sub(frame.monotonic + frame.duration);
            let _ = published.durable.set(durable);
            tracing::debug!(
                session = self.status.facts.id,
                frame = frame.sequence,
                us = durable.as_micros() as u64,
                "durable"
            );
        }
        Ok(())
    }

    fn late_map(&mut self, frame: &Arc<Published>) -> Result<(), LogbookError> {
        let Some(record) = &frame.record else {
            return Ok(());
        };
        match self.writer.late_map(frame.frame.sequence, record) {
            // the session rolled over or changed its file meanwhile: the frame is recorded, and the map can be
            // recomputed
            Err(LogbookError::NoSuchFrame { .. }) => Ok(()),
            Err(error) if error.is_disk() || error.is_locked() => {
                tracing::debug!("{}", chain(&error));
                Ok(())
            }
            other => other,
        }
    }
}

impl LogbookSink {
    /// Sequence of the last frame that is on disk.
    pub(super) fn acknowledged(&self) -> u64 {
        self.writer.acknowledged()
    }

    /// Starts a write: the next heartbeat is due within [`WRITE_TIME_LIMIT`], unless this is dropped before.
    pub(super) fn begin_write(&self) -> IdleOnDrop {
        let now = self.clock.monotonic();
        self.heartbeats
            .set_deadline(Part::Record, now, WRITE_TIME_LIMIT);
        IdleOnDrop(Arc::clone(&self.heartbeats), Part::Record)
    }

    /// Records the end of the session. If the file is locked by another process or deleted, the next part records it.
    pub(super) fn end(&mut self, at: DateTime<Utc>, reason: &str) -> Result<(), LogbookError> {
        let ended = match self.writer.end(at, reason) {
            // the writer has waited for a quarter of a second; a stop must not wait longer
            Err(error) if error.is_locked() || error.is_gone() => {
                self.renew(&error)?;
                self.writer.end(at, reason)
            }
            ended => ended,
        };
        if ended.is_ok() {
            self.status.set_closed();
        }
        ended
    }
}
