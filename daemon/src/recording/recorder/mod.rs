//! The way of a frame after acquisition, on a thread of its own: quality, then the sinks in order: logbook (durable), then
//! everybody who listens. Maps come from the [`ReconstructionWorker`]: the record waits for one a little, and is written without it.

mod continuity;
mod disk_space;
mod events;
mod maps;
#[cfg(test)]
mod tests;

pub(crate) use crate::recording::recorder::disk_space::Disk;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};
use dbus::stream::{Body, Record};
use eit::Pressure;
use logbook::{LogbookError, SessionWriter};
use rig::{Clock, SystemClock};
use survey::{Baseline, Checks, Frame, Map, Quality};
use tokio::sync::mpsc::{self, error::TryRecvError};

use crate::events::event_log::EventLog;
use crate::monitoring::heartbeat::{Heartbeats, Part, Rests};
use crate::recording::order::{Order, QUEUE, SHUT_DOWN};
use crate::recording::reconstruction_worker::{MapOutcome, Mapped, ReconstructionWorker};
use crate::recording::session_status::{Published, SessionStatus};
use survey::error_chain as chain;

/// With so many waiting, nobody waits for a map.
const HURRY: usize = QUEUE / 2;

/// Frames that one sync is enough for.
const MOST_TOGETHER: usize = 64;
/// Between looks for more of them.
const LOOK: Duration = Duration::from_millis(1);
/// A disk that takes longer for a write is one that hangs.
const FOR_A_WRITE: Duration = Duration::from_secs(60);

/// Writes one session.
pub(crate) struct Recorder {
    pub status: Arc<SessionStatus>,
    pub writer: SessionWriter,
    pub clock: SystemClock,
    pub checks: Checks,
    pub task: Task,
    pub events: EventLog,
    pub heartbeats: Arc<Heartbeats>,
    pub disk: Disk,
    /// The last frame before a gap that the session goes on after; its next frame is compared with it.
    pub before: Option<logbook::Record>,
    /// Whether frames wait for their maps however many there are: those of a recording do not pass by.
    pub patient: bool,
    /// Wall time when the monotonic clock began, by the last frame.
    pub began: Option<DateTime<Utc>>,
}

/// What is made of the frames.
pub(crate) enum Task {
    /// The mean of so many.
    Baseline { frames: Vec<Frame>, wanted: u64 },
    /// A map of each.
    Maps {
        worker: ReconstructionWorker,
        /// The frame whose map is late.
        late: Option<Box<Row>>,
        /// Frames without a map, because the method was still busy.
        missed: u64,
    },
}

impl Task {
    pub(crate) fn maps(worker: ReconstructionWorker) -> Self {
        Self::Maps {
            worker,
            late: None,
            missed: 0,
        }
    }
}

/// A frame on its way to the disk.
pub(crate) struct Row {
    frame: Frame,
    quality: Quality,
    mapped: Option<Mapped>,
    reconstruction: Duration,
    durable: Duration,
}

impl Recorder {
    /// Works until the session is closed. Returns the baseline, where one was recorded to its end. Blocks: not for an
    /// async task.
    ///
    /// # Errors
    /// The disk refused; everything acknowledged before is on it. The session has then been told to stop.
    pub(crate) fn run(
        mut self,
        mut orders: mpsc::Receiver<Order>,
    ) -> Result<Option<Baseline>, LogbookError> {
        let mut waiting = VecDeque::new();
        while let Some(order) = waiting.pop_front().or_else(|| orders.blocking_recv()) {
            let now = self.clock.monotonic();
            self.heartbeats.promise(Part::Record, now, FOR_A_WRITE);
            let _rests = Rests(Arc::clone(&self.heartbeats), Part::Record);
            let outcome = match order {
                Order::Frame(first) => {
                    let frames = gather(*first, &mut orders, &mut waiting, self.disk.gathers());
                    self.frames(frames, &orders)
                }
                Order::Event(event) => self.event(event),
                Order::MapReady => self.late_map(),
                Order::LookAtPlace => self.look_at_place(),
                Order::Close { at, reason } => return self.close(at, &reason),
                Order::Leave { at, reason } => {
                    self.last_map()?;
                    self.event(self.event_at(at, SHUT_DOWN, &reason))?;
                    return Ok(None);
                }
            };
            // what was said of the disk meanwhile
            if let Err(error) = outcome.and_then(|()| self.settle()) {
                self.status.stop(&chain(&error));
                // what is still on its way has nowhere to go
                orders.close();
                while let Some(order) = waiting.pop_front().or_else(|| orders.blocking_recv()) {
                    if let Order::Frame(_) = order {
                        self.status.count_dropped(1);
                    }
                }
                if !self.status.is_left_open() {
                    self.close_if_possible();
                }
                return Err(error);
            }
        }
        let at = self.clock.wall();
        self.close(at, "the daemon let go of the session")
    }

    /// Frames that were waiting together go to the disk with one sync.
    fn frames(
        &mut self,
        frames: Vec<Frame>,
        orders: &mpsc::Receiver<Order>,
    ) -> Result<(), LogbookError> {
        let mut rows: Vec<Row> = Vec::with_capacity(frames.len());
        let (mut left, patient) = (frames.len(), self.patient);
        // of the frames of this call, the one whose map is late
        let mut late = None;
        for frame in frames {
            left -= 1;
            self.late_map()?;
            let mut row = Row {
                quality: self.checks.of(&frame),
                frame,
                mapped: None,
                reconstruction: Duration::ZERO,
                durable: Duration::ZERO,
            };
            match self.ask_for_map(&row.frame, || !patient && orders.len() + left >= HURRY) {
                Some(MapOutcome::Made(made)) => self.made(*made, &mut row)?,
                Some(MapOutcome::Late) => late = Some(rows.len()),
                Some(MapOutcome::Busy) => self.missed_a_map()?,
                Some(MapOutcome::Suspended) | None => {}
            }
            rows.push(row);
        }
        let count = rows.len() as u64;
        if let Some(first) = rows.first() {
            self.roll(first.frame.wall)?;
        }
        if let Some(first) = rows.first() {
            self.compare_with_before(first)?;
            self.watch_the_clock(&first.frame)?;
        }
        let last = match self.store(&rows) {
            Ok(last) => last,
            Err(error) => {
                self.status.count_dropped(count);
                return Err(error);
            }
        };
        let now = self.clock.monotonic();
        for (index, mut row) in rows.into_iter().enumerate() {
            row.frame.sequence = last + 1 + index as u64 - count;
            row.durable = now.saturating_sub(row.frame.monotonic + row.frame.duration);
            tracing::debug!(
                session = self.status.facts.id,
                frame = row.frame.sequence,
                us = row.durable.as_micros() as u64,
                "durable"
            );
            if late == Some(index)
                && let Task::Maps { late, .. } = &mut self.task
            {
                *late = Some(Box::new(row.without_map()));
            }
            self.publish(row);
        }
        Ok(())
    }

    fn publish(&mut self, row: Row) {
        if !self.status.readers.is_empty() {
            self.stream(&row.frame, frame_body(&row.frame));
            self.stream_map(&row);
        }
        if let Task::Baseline { frames, .. } = &mut self.task {
            frames.push(row.frame.clone());
        }
        self.status.publish(row.published());
    }

    fn publish_map(&self, row: Row) {
        if !self.status.readers.is_empty() {
            self.stream_map(&row);
        }
        self.status.publish_map(row.published());
    }

    fn stream_map(&self, row: &Row) {
        let Some(mapped) = &row.mapped else {
            return;
        };
        if let Some(pressure) = &mapped.pressure {
            self.stream(&row.frame, pressure_body(pressure));
        }
        self.stream(&row.frame, map_body(&mapped.map));
    }

    fn stream(&self, frame: &Frame, body: Body) {
        self.status.readers.publish(&Record {
            sequence: frame.sequence,
            wall_ns: survey::nanoseconds(frame.wall),
            gap: 0,
            simulated: frame.simulated,
            body,
        });
    }

    fn close(mut self, at: DateTime<Utc>, reason: &str) -> Result<Option<Baseline>, LogbookError> {
        let kept = self.last_map().and_then(|()| self.keep_baseline(at));
        match kept {
            Ok(kept) => {
                self.end(at, reason)?;
                Ok(kept)
            }
            Err(error) => {
                self.close_if_possible();
                Err(error)
            }
        }
    }

    /// Writes the end of the session, after a write that failed: what could not be written is lost, and the end may be
    /// written all the same. Where it is not, its mark says it.
    fn close_if_possible(&mut self) {
        let (at, reason) = (self.clock.wall(), self.status.stop_reason());
        if let Err(error) = self.end(at, &reason) {
            tracing::debug!("{}", chain(&error));
        }
    }

    /// A file that another process holds locked, or that is gone, is left: the next part says the end.
    fn end(&mut self, at: DateTime<Utc>, reason: &str) -> Result<(), LogbookError> {
        let ended = match self.writer.end(at, reason) {
            // the writer has waited a quarter of a second, and whoever stops a session does not wait longer
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

    /// The mean of the frames, where there are as many as were wanted.
    fn keep_baseline(&mut self, at: DateTime<Utc>) -> Result<Option<Baseline>, LogbookError> {
        let made = match &self.task {
            Task::Baseline { frames, wanted } if frames.len() as u64 >= *wanted => {
                Baseline::from_frames(self.status.facts.id.clone(), frames)
            }
            _ => return Ok(None),
        };
        match made {
            Ok(made) => {
                self.persist(|writer| writer.baseline(&made))?;
                self.settle()?;
                Ok(Some(made))
            }
            Err(error) => {
                self.event(self.event_at(at, "baseline", &chain(&error)))?;
                Ok(None)
            }
        }
    }
}

impl Row {
    fn without_map(&self) -> Self {
        Self {
            frame: self.frame.clone(),
            quality: self.quality.clone(),
            mapped: None,
            reconstruction: Duration::ZERO,
            durable: self.durable,
        }
    }

    fn published(self) -> Published {
        let (map, found, pressure) = match self.mapped {
            Some(mapped) => (Some(mapped.map), mapped.found, mapped.pressure),
            None => (None, None, None),
        };
        Published {
            frame: self.frame,
            quality: self.quality,
            map,
            found,
            pressure,
            reconstruction: self.reconstruction,
            durable: self.durable,
        }
    }
}

/// The frames that wait behind the first one, and those that come `within` this time, up to whatever else waits.
fn gather(
    first: Frame,
    orders: &mut mpsc::Receiver<Order>,
    waiting: &mut VecDeque<Order>,
    within: Duration,
) -> Vec<Frame> {
    let began = Instant::now();
    let mut frames = vec![first];
    while waiting.is_empty() && frames.len() < MOST_TOGETHER {
        match orders.try_recv() {
            Ok(Order::Frame(frame)) => frames.push(*frame),
            // looked for with every frame
            Ok(Order::MapReady | Order::LookAtPlace) => {}
            Ok(other) => waiting.push_back(other),
            Err(TryRecvError::Empty) if began.elapsed() < within => std::thread::sleep(LOOK),
            Err(_) => break,
        }
    }
    frames
}

fn frame_body(frame: &Frame) -> Body {
    Body::Frame {
        volts: volts(&frame.readings),
        flags: frame
            .readings
            .iter()
            .map(|reading| reading.flag())
            .collect(),
    }
}

fn map_body(map: &Map) -> Body {
    Body::Map {
        values: map.values.clone(),
        mesh_hash: map.mesh_hash.clone(),
        method: map.method.clone(),
    }
}

fn pressure_body(pressure: &Pressure) -> Body {
    Body::Pressure {
        kpa: pressure.kpa.clone(),
        newtons: pressure.newtons,
    }
}

/// Voltages as numbers for the bus; NaN, which its flag explains, where there is none.
pub(crate) fn volts(readings: &[survey::Reading]) -> Vec<f64> {
    readings
        .iter()
        .map(|reading| reading.volts().map_or(f64::NAN, |volts| volts.0))
        .collect()
}
