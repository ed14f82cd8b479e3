//! The way of a frame after acquisition, on a thread of its own: quality, map, then the sinks, the logbook first. The record
//! waits for a map of the [`ReconstructionWorker`] a little, and is written without it.

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
use crate::recording::order::{Order, QUEUE};
use crate::recording::published::Published;
use crate::recording::reconstruction_worker::{MapOutcome, ReconstructionWorker};
use crate::recording::session_status::SessionStatus;
use crate::recording::stream_sink::StreamSink;
use survey::error_chain as chain;

/// With so many waiting, nobody waits for a map.
const HURRY: usize = QUEUE / 2;

/// Frames that one sync is enough for.
const MOST_TOGETHER: usize = 64;
/// Between looks for more of them.
const LOOK: Duration = Duration::from_millis(1);

/// Records one session.
pub(crate) struct Recorder {
    status: Arc<SessionStatus>,
    logbook: LogbookSink,
    /// The sinks behind the logbook.
    sinks: [Box<dyn FrameSink>; 2],
    checks: Checks,
    task: Task,
    /// Whether frames wait for their maps however many there are: those of a recording do not pass by.
    patient: bool,
}

/// What is made of the frames.
// one per session: its size does not matter
#[allow(clippy::large_enum_variant)]
pub(crate) enum Task {
    /// The mean of so many.
    Baseline { frames: Vec<Frame>, wanted: u64 },
    /// A map of each.
    Maps {
        worker: ReconstructionWorker,
        /// The frame whose map is late.
        late: Option<Arc<Published>>,
        /// Frames without a map, because the method was still busy.
        missed: u64,
        /// Which frames are to have one.
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
    /// Records frames by the logbook, and publishes those that are durable; `patient` where frames are never recorded
    /// without a map because others wait.
    pub(crate) fn new(logbook: LogbookSink, checks: Checks, task: Task, patient: bool) -> Self {
        let status = Arc::clone(&logbook.status);
        Self {
            sinks: [
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
            let _rests = self.logbook.begins_to_write();
            let outcome = match order {
                Order::Frame(first) => {
                    let frames = gather(
                        *first,
                        &mut orders,
                        &mut waiting,
                        self.logbook.disk.gathers(),
                    );
                    self.frames(frames, &orders)
                }
                Order::Event(event) => self.logbook.event(event),
                Order::MapReady => self.late_map(),
                Order::LookAtPlace => self.logbook.look_at_place(),
                Order::Close { at, reason } => return self.close(at, &reason),
                Order::Leave { at, reason } => {
                    self.last_map()?;
                    let event = self.logbook.event_at(at, EventKind::ShutDown, &reason);
                    self.logbook.event(event)?;
                    return Ok(None);
                }
            };
            // what was said of the disk meanwhile
            if let Err(error) = outcome.and_then(|()| self.logbook.settle()) {
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
        let at = self.logbook.clock.wall();
        self.close(at, "the daemon let go of the session")
    }

    /// Frames that were waiting together go to the disk with one sync.
    fn frames(
        &mut self,
        frames: Vec<Frame>,
        orders: &mpsc::Receiver<Order>,
    ) -> Result<(), LogbookError> {
        let mut taken: Vec<Published> = Vec::with_capacity(frames.len());
        let (mut left, patient) = (frames.len(), self.patient);
        // of the frames of this call, the one whose map is late
        let mut late = None;
        let mut sequence = self.logbook.acknowledged();
        for mut frame in frames {
            left -= 1;
            self.late_map()?;
            sequence += 1;
            frame.sequence = sequence;
            let mut published = Published::new(self.checks.of(&frame), frame);
            match self.ask_for_map(&published.frame, || {
                !patient && orders.len() + left >= HURRY
            }) {
                Some(MapOutcome::Made(made)) => self.made(*made, &mut published)?,
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

    /// Writes the end of the session, after a write that failed: what could not be written is lost, and the end may be
    /// written all the same. Where it is not, its mark says it.
    fn close_if_possible(&mut self) {
        let (at, reason) = (self.logbook.clock.wall(), self.status.stop_reason());
        if let Err(error) = self.logbook.end(at, &reason) {
            tracing::debug!("{}", chain(&error));
        }
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
