//! The recorder, on a separate thread: computes quality and map of each frame, then passes it to the sinks, the logbook
//! first. It waits a limited time for the map of the [`ReconstructionWorker`], then writes the frame without it.

mod maps;
#[cfg(test)]
mod tests;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use chrono::{DateTime, Utc};
use imaging::ReconstructionSettings;
use logbook::LogbookError;
use rig::Clock;
use survey::{Baseline, Checks, Frame};
use tokio::sync::mpsc::{self, error::TryRecvError};

use crate::events::kind::EventKind;
use crate::recording::frame_sink::FrameSink;
use crate::recording::logbook_sink::LogbookSink;
use crate::recording::published::Published;
use crate::recording::reconstruction_worker::{MapOutcome, ReconstructionWorker};
use crate::recording::recorder_message::{QUEUE, RecorderMessage};
use crate::recording::session_status::SessionStatus;
use crate::recording::stream_sink::StreamSink;
use survey::error_chain as chain;

/// Number of waiting frames from which a map is awaited only briefly.
const BUSY_QUEUE: usize = QUEUE / 2;

/// Maximum number of frames written with one sync.
const MOST_TOGETHER: usize = 64;
/// Time between two checks for more frames.
const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// Records one session.
pub(crate) struct Recorder {
    status: Arc<SessionStatus>,
    logbook: LogbookSink,
    /// The sinks after the logbook.
    sinks: Vec<Box<dyn FrameSink>>,
    checks: Checks,
    task: Task,
    /// Whether a frame waits for its map even if others are waiting, as the frames of a recording can.
    patient: bool,
}

/// The processing of frames.
// one per session: its size does not matter
#[allow(clippy::large_enum_variant)]
pub(crate) enum Task {
    /// Averages `wanted` frames.
    Baseline { frames: Vec<Frame>, wanted: u64 },
    /// Computes maps of the frames.
    Maps {
        worker: ReconstructionWorker,
        /// The frame whose map is late.
        late: Option<Arc<Published>>,
        /// Frames without a map because the method was busy.
        missed: u64,
        /// Selects the frames that get a map.
        settings: ReconstructionSettings,
    },
}

impl Task {
    pub(crate) fn maps(worker: ReconstructionWorker, settings: ReconstructionSettings) -> Self {
        Self::Maps {
            worker,
            late: None,
            missed: 0,
            settings,
        }
    }
}

impl Recorder {
    /// A recorder that writes frames to the logbook, and then publishes them. With `patient`, the wait for a map is not
    /// shortened if other frames are waiting.
    pub(crate) fn new(logbook: LogbookSink, checks: Checks, task: Task, patient: bool) -> Self {
        let status = Arc::clone(&logbook.status);
        Self {
            sinks: vec![
                Box::new(StreamSink(Arc::clone(&status))),
                Box::new(Arc::clone(&status)),
            ],
            status,
            logbook,
            checks,
            task,
            patient,
        }
    }

    /// Adds a sink, which receives frames after the others.
    pub(crate) fn and_to(mut self, sink: Box<dyn FrameSink>) -> Self {
        self.sinks.push(sink);
        self
    }

    /// Records until the session is closed. Returns the baseline if its recording was completed. Blocks: must not be
    /// called in an async task.
    ///
    /// # Errors
    /// A disk error. Everything acknowledged before is on disk, and the session has been requested to stop.
    pub(crate) fn run(
        mut self,
        mut orders: mpsc::Receiver<RecorderMessage>,
    ) -> Result<Option<Baseline>, LogbookError> {
        let mut waiting = VecDeque::new();
        while let Some(order) = waiting.pop_front().or_else(|| orders.blocking_recv()) {
            let _rests = self.logbook.begin_write();
            let outcome = match order {
                RecorderMessage::Frame(first) => {
                    let frames = gather(
                        *first,
                        &mut orders,
                        &mut waiting,
                        self.logbook.disk.gathers(),
                    );
                    let (before, number) = (self.logbook.acknowledged(), frames.len() as u64);
                    let written = self.frames(frames, &orders);
                    if written.is_err() {
                        let durable = self.logbook.acknowledged().saturating_sub(before);
                        self.status.count_dropped(number.saturating_sub(durable));
                    }
                    written
                }
                RecorderMessage::Event(event) => self.logbook.event(event),
                RecorderMessage::Order { order, by, reply } => {
                    let ordered = self.order_tracking(order, by);
                    ordered.map(|ordered| drop(reply.send(ordered)))
                }
                RecorderMessage::MapReady => self.late_map(),
                RecorderMessage::CheckFile => self.logbook.look_at_place(),
                RecorderMessage::Close { at, reason } => return self.close(at, &reason),
                RecorderMessage::Leave { at, reason } => {
                    self.last_map()?;
                    let event = self.logbook.event_at(at, EventKind::ShutDown, &reason);
                    self.logbook.event(event)?;
                    return Ok(None);
                }
            };
            // also writes events about the disk that were reported meanwhile
            if let Err(error) = outcome.and_then(|()| self.logbook.settle()) {
                self.status.stop(&chain(&error));
                // remaining messages are dropped
                orders.close();
                while let Some(order) = waiting.pop_front().or_else(|| orders.blocking_recv()) {
                    if let RecorderMessage::Frame(_) = order {
                        self.status.count_dropped(1);
                    }
                }
                if !self.status.is_left_open() {
                    self.close_if_possible();
                }
                return Err(error);
            }
        }
        let at = self.logbook.clock.wall();
        self.close(at, "the daemon ended while the session was open")
    }

    /// Writes frames that were waiting together with one sync.
    fn frames(
        &mut self,
        frames: Vec<Frame>,
        orders: &mpsc::Receiver<RecorderMessage>,
    ) -> Result<(), LogbookError> {
        let mut taken: Vec<Published> = Vec::with_capacity(frames.len());
        let (mut left, patient) = (frames.len(), self.patient);
        // index of the frame of this call whose map is late
        let mut late = None;
        let mut sequence = self.logbook.acknowledged();
        for mut frame in frames {
            left -= 1;
            match late.and_then(|index: usize| taken.get_mut(index)) {
                // the frame is not written yet
                Some(awaits) => {
                    if let Some(made) = self.late_outcome() {
                        late = None;
                        self.made(made, awaits)?;
                    }
                }
                None => self.late_map()?,
            }
            sequence += 1;
            frame.sequence = sequence;
            let mut published = Published::new(self.checks.of(&frame), frame);
            match self.ask_for_map(&published.frame, || {
                !patient && orders.len() + left >= BUSY_QUEUE
            }) {
                Some(MapOutcome::Ready(made)) => self.made(*made, &mut published)?,
                Some(MapOutcome::Late) => late = Some(taken.len()),
                Some(MapOutcome::Busy) => self.missed_a_map()?,
                Some(MapOutcome::Suspended) | None => {}
            }
            taken.push(published);
        }
        let taken: Vec<Arc<Published>> = taken.into_iter().map(Arc::new).collect();
        self.logbook.frames(&taken)?;
        let awaits = late.and_then(|index| taken.get(index));
        match &mut self.task {
            Task::Maps { late, .. } => *late = awaits.cloned().or(late.take()),
            Task::Baseline { frames, .. } => {
                frames.extend(taken.iter().map(|taken| taken.frame.clone()));
            }
        }
        for sink in &mut self.sinks {
            sink.frames(&taken)?;
        }
        Ok(())
    }

    fn close(mut self, at: DateTime<Utc>, reason: &str) -> Result<Option<Baseline>, LogbookError> {
        let kept = self.last_map().and_then(|()| self.keep_baseline(at));
        match kept {
            Ok(kept) => {
                self.logbook.end(at, reason)?;
                Ok(kept)
            }
            Err(error) => {
                self.close_if_possible();
                Err(error)
            }
        }
    }

    /// Tries to record the end of the session after a failed write: the end may be writable even if the frames were
    /// not. Otherwise only the end mark records it.
    fn close_if_possible(&mut self) {
        let (at, reason) = (self.logbook.clock.wall(), self.status.stop_reason());
        if let Err(error) = self.logbook.end(at, &reason) {
            tracing::debug!("{}", chain(&error));
        }
    }

    /// Averages and records the frames of a baseline, if there are as many as requested.
    fn keep_baseline(&mut self, at: DateTime<Utc>) -> Result<Option<Baseline>, LogbookError> {
        let made = match &self.task {
            Task::Baseline { frames, wanted } if frames.len() as u64 >= *wanted => {
                Baseline::from_frames(self.status.facts.id.clone(), frames)
            }
            _ => return Ok(None),
        };
        match made {
            Ok(made) => {
                self.logbook.persist(|writer| writer.baseline(&made))?;
                self.logbook.settle()?;
                Ok(Some(made))
            }
            Err(error) => {
                let event = self
                    .logbook
                    .event_at(at, EventKind::Baseline, &chain(&error));
                self.logbook.event(event)?;
                Ok(None)
            }
        }
    }
}

/// Collects the waiting frames, and those that arrive `within` this time, up to the next message of another kind.
fn gather(
    first: Frame,
    orders: &mut mpsc::Receiver<RecorderMessage>,
    waiting: &mut VecDeque<RecorderMessage>,
    within: Duration,
) -> Vec<Frame> {
    let began = Instant::now();
    let mut frames = vec![first];
    while waiting.is_empty() && frames.len() < MOST_TOGETHER {
        match orders.try_recv() {
            Ok(RecorderMessage::Frame(frame)) => frames.push(*frame),
            // both are checked with every frame anyway
            Ok(RecorderMessage::MapReady | RecorderMessage::CheckFile) => {}
            Ok(other) => waiting.push_back(other),
            Err(TryRecvError::Empty) if began.elapsed() < within => {
                std::thread::sleep(POLL_INTERVAL)
            }
            Err(_) => break,
        }
    }
    frames
}
