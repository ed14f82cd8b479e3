//! Status of a session for clients: counters, the last frame and map, stream readers, and pending requests.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use chrono::{DateTime, Utc};
use dbus::Fault;
use imaging::tracking::TrackingOrder;
use logbook::{LogbookError, SessionKind};
use rig::{Stop, StopButton};
use tokio::sync::mpsc::WeakSender;
use tokio::sync::{OnceCell, SetOnce, oneshot, watch};

use crate::events::event::Event;
use crate::locked::locked;
use crate::monitoring::Counters;
use crate::monitoring::counters::LastFrame;
use crate::recording::end_marks::Marked;
use crate::recording::frame_sink::FrameSink;
use crate::recording::pace::Pace;
use crate::recording::published::Published;
use crate::recording::recorder_message::RecorderMessage;
use crate::recording::stream::Readers;

/// Constants of the session.
#[derive(Debug, Clone)]
pub(crate) struct Facts {
    pub id: String,
    pub kind: SessionKind,
    pub simulated: bool,
    /// Empty for a baseline session.
    pub baseline_id: String,
    /// Empty for a baseline session.
    pub method: String,
    /// Scheduled period from start to start of frames; zero is back to back.
    pub every: Duration,
}

/// Progress of the session.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct Progress {
    pub suspended: bool,
    pub last_error: String,
    /// Why it ended; `None` while it runs.
    pub ended: Option<SessionEnd>,
}

/// How the session ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SessionEnd {
    pub reason: String,
    pub faulted: bool,
}

/// The last frame, and the last frame with a map.
#[derive(Debug, Default)]
struct Latest {
    frame: Option<Arc<Published>>,
    with_map: Option<Arc<Published>>,
}

/// A session, shared by the tasks that work on it.
#[derive(Debug)]
pub(crate) struct SessionStatus {
    pub facts: Facts,
    /// The file currently written; a session that rolls over has several.
    path: Mutex<PathBuf>,
    pub readers: Readers,
    /// Whether the readers can receive the load after each injection, or why not; set when the session runs.
    pub injections: SetOnce<Result<(), &'static str>>,
    /// The queue of the session's recorder; set when the session runs.
    record: OnceLock<WeakSender<RecorderMessage>>,
    acquired: AtomicU64,
    durable: watch::Sender<u64>,
    dropped: AtomicU64,
    progress: watch::Sender<Progress>,
    latest: Mutex<Latest>,
    /// The largest loss that noise alone causes in a map; set with the first map, if the noise of a reading is known.
    pub map_noise: OnceLock<f64>,
    /// The last standard deviation of a map, and the sequence of its frame; `None` until a reader of the stream wants
    /// one.
    pub deviation: Mutex<Option<(u64, Vec<f64>)>>,
    button: StopButton,
    stop: Stop,
    suspend: watch::Sender<bool>,
    /// Whether acquisition is held, because the record cannot be written.
    held: watch::Sender<bool>,
    /// Frames granted so far; `None` for a session with a schedule.
    granted: Option<watch::Sender<u64>>,
    why: Mutex<String>,
    /// Whether the end was requested because of a failure.
    failed: AtomicBool,
    left_open: AtomicBool,
    /// Whether the end was requested for good: the next daemon must not resume the session.
    ended_for_good: AtomicBool,
    /// The end marks that were written; set before the session's file is closed.
    pub marked: OnceCell<Marked>,
    /// Whether the session's file records its end.
    closed: AtomicBool,
    /// Frames that failed.
    failures: AtomicU64,
    /// Counters over all sessions of the daemon.
    counters: Arc<Counters>,
    pace: Mutex<Pace>,
}

impl SessionStatus {
    /// A new session; with `step` each frame must be granted.
    pub(crate) fn new(facts: Facts, path: PathBuf, step: bool, counters: Arc<Counters>) -> Self {
        let (button, stop) = Stop::button();
        tracing::info!(
            session = facts.id,
            "{} {} begins: {}",
            facts.kind.as_str(),
            facts.id,
            path.display()
        );
        let pace = Pace::from(counters.now());
        Self {
            counters,
            pace: Mutex::new(pace),
            facts,
            path: Mutex::new(path),
            readers: Readers::default(),
            injections: SetOnce::new(),
            record: OnceLock::new(),
            acquired: AtomicU64::new(0),
            durable: watch::Sender::new(0),
            dropped: AtomicU64::new(0),
            progress: watch::Sender::new(Progress::default()),
            latest: Mutex::default(),
            map_noise: OnceLock::new(),
            deviation: Mutex::default(),
            button,
            stop,
            suspend: watch::Sender::new(false),
            held: watch::Sender::new(false),
            granted: step.then(|| watch::Sender::new(0)),
            why: Mutex::new(String::new()),
            failed: AtomicBool::new(false),
            left_open: AtomicBool::new(false),
            ended_for_good: AtomicBool::new(false),
            marked: OnceCell::new(),
            closed: AtomicBool::new(false),
            failures: AtomicU64::new(0),
        }
    }

    /// Sets the queue of the session's recorder.
    pub(crate) fn set_record(&self, record: WeakSender<RecorderMessage>) {
        let _ = self.record.set(record);
    }

    /// Queues an event for the session's record; false if the queue is full or does not exist.
    pub(crate) fn record_event(&self, event: Event) -> bool {
        let record = self.record.get().and_then(WeakSender::upgrade);
        record.is_some_and(|record| record.try_send(RecorderMessage::Event(event)).is_ok())
    }

    /// Gives an order to the tracked baseline; returns the number of the first frame to which it applies.
    ///
    /// # Errors
    /// Why the order cannot be carried out.
    pub(crate) async fn order_tracking(
        &self,
        order: TrackingOrder,
        by: String,
    ) -> Result<u64, Fault> {
        let ended = || Fault::NoSession(format!("session {} has ended", self.facts.id));
        let record = self.record.get().and_then(WeakSender::upgrade);
        let record = record.ok_or_else(ended)?;
        let (reply, ordered) = oneshot::channel();
        let message = RecorderMessage::Order { order, by, reply };
        record.send(message).await.map_err(|_| ended())?;
        // the queue is not kept open: the session may end meanwhile
        drop(record);
        let ordered = ordered.await.map_err(|_| ended())?;
        ordered.map_err(Fault::Unsupported)
    }

    /// Sets the number of frames already on disk.
    pub(crate) fn set_frames_on_disk(&self, frames: u64) {
        self.acquired.store(frames, Ordering::Relaxed);
        self.durable.send_replace(frames);
        if let Some(granted) = &self.granted {
            granted.send_replace(frames);
        }
    }

    /// Ends the session for now; the next daemon resumes it.
    pub(crate) fn end_resumable(&self, why: &str) {
        self.left_open.store(true, Ordering::SeqCst);
        self.stop(why);
    }

    /// Whether the next daemon should resume the session: it was left open, and no end for good was requested.
    pub(crate) fn is_left_open(&self) -> bool {
        self.left_open.load(Ordering::SeqCst) && !self.ended_for_good.load(Ordering::SeqCst)
    }

    /// Like [`SessionStatus::stop`], but the next daemon does not resume it even if this one is being stopped.
    pub(crate) fn end_for_good(&self, why: &str) {
        self.ended_for_good.store(true, Ordering::SeqCst);
        self.stop(why);
    }

    /// Whether the end is recorded in the session's file or in an end mark.
    pub(crate) fn end_is_recorded(&self) -> bool {
        self.is_closed() || self.marked.get().is_some_and(Marked::is_kept)
    }

    /// For an ended session: whether the next daemon would resume it.
    pub(crate) fn is_resumed_by_next_daemon(&self) -> bool {
        self.left_open.load(Ordering::SeqCst) && !self.end_is_recorded()
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::SeqCst)
    }

    /// Stores that the session's file records its end.
    pub(crate) fn set_closed(&self) {
        self.closed.store(true, Ordering::SeqCst);
    }

    pub(crate) fn path(&self) -> PathBuf {
        let path = locked(&self.path);
        path.clone()
    }

    /// Sets the file of the next part.
    pub(crate) fn set_path(&self, path: &Path) {
        let mut now = locked(&self.path);
        path.clone_into(&mut now);
    }

    pub(crate) fn acquired(&self) -> u64 {
        self.acquired.load(Ordering::Relaxed)
    }

    pub(crate) fn count_acquired(&self) {
        self.acquired.fetch_add(1, Ordering::Relaxed);
        self.counters.count_acquired();
    }

    pub(crate) fn durable(&self) -> u64 {
        *self.durable.borrow()
    }

    /// Follows the number of durable frames.
    pub(crate) fn follow_durable(&self) -> watch::Receiver<u64> {
        self.durable.subscribe()
    }

    pub(crate) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    pub(crate) fn count_dropped(&self, frames: u64) {
        self.dropped.fetch_add(frames, Ordering::Relaxed);
        self.counters.count_dropped(frames);
    }

    pub(crate) fn progress(&self) -> Progress {
        self.progress.borrow().clone()
    }

    /// Follows suspension, errors and the end.
    pub(crate) fn follow(&self) -> watch::Receiver<Progress> {
        self.progress.subscribe()
    }

    pub(crate) fn set_suspended(&self, suspended: bool) {
        self.progress.send_if_modified(|progress| {
            std::mem::replace(&mut progress.suspended, suspended) != suspended
        });
    }

    pub(crate) fn set_last_error(&self, text: &str) {
        self.progress.send_if_modified(|progress| {
            let changed = progress.last_error != text;
            if changed {
                text.clone_into(&mut progress.last_error);
            }
            changed
        });
    }

    /// Publishes the end of the session, as the last update.
    pub(crate) fn end(&self, end: SessionEnd) {
        // with the start, the only journal messages of a session without faults
        tracing::info!(
            session = self.facts.id,
            "{} has ended: {}; {} frames on disk, {} failed, {} dropped",
            self.facts.id,
            end.reason,
            self.durable(),
            self.failures(),
            self.dropped()
        );
        self.progress.send_modify(|progress| {
            if end.faulted {
                progress.last_error.clone_from(&end.reason);
            }
            progress.suspended = false;
            progress.ended = Some(end);
        });
    }

    /// Waits for the end.
    pub(crate) async fn ended(&self) -> SessionEnd {
        let mut follow = self.follow();
        loop {
            if let Some(end) = follow.borrow_and_update().ended.clone() {
                return end;
            }
            if follow.changed().await.is_err() {
                // not reached: the sender is in `self`
                std::future::pending::<()>().await;
            }
        }
    }

    pub(crate) fn latest_frame(&self) -> Option<Arc<Published>> {
        locked(&self.latest).frame.clone()
    }

    /// The last frame with a map.
    pub(crate) fn latest_map(&self) -> Option<Arc<Published>> {
        locked(&self.latest).with_map.clone()
    }

    /// Requests the end of the session; the first reason given is kept.
    pub(crate) fn stop(&self, why: &str) {
        let mut first = locked(&self.why);
        if first.is_empty() {
            why.clone_into(&mut first);
        }
        drop(first);
        self.button.press();
    }

    /// Like [`SessionStatus::stop`], and marks the session faulted.
    pub(crate) fn fail(&self, why: &str) {
        self.failed.store(true, Ordering::Relaxed);
        self.stop(why);
    }

    /// Whether the end was requested because of a failure.
    pub(crate) fn has_failed(&self) -> bool {
        self.failed.load(Ordering::Relaxed)
    }

    /// Frames that failed, and are not in the record.
    pub(crate) fn failures(&self) -> u64 {
        self.failures.load(Ordering::Relaxed)
    }

    /// Counts a frame that failed, with the time and the cause.
    pub(crate) fn count_failure(&self, at: DateTime<Utc>, cause: &str) {
        self.failures.fetch_add(1, Ordering::Relaxed);
        self.counters.count_failed(at, cause);
    }

    /// The reason of the stop request.
    pub(crate) fn stop_reason(&self) -> String {
        locked(&self.why).clone()
    }

    /// Subscribes to the stop request.
    pub(crate) fn stop_request(&self) -> Stop {
        self.stop.clone()
    }

    pub(crate) fn suspend(&self, suspend: bool) {
        if self.suspend.send_replace(suspend) && !suspend {
            locked(&self.pace).from = self.counters.now();
        }
    }

    /// Whether frames are due without a request: the session is not suspended and not in step mode.
    pub(crate) fn awaits_frames(&self) -> bool {
        self.granted.is_none() && !*self.suspend.borrow()
    }

    /// The time from which a frame is expected, by the daemon's clock, and the observed frame period.
    pub(crate) fn pace(&self) -> (Duration, Option<Duration>) {
        let pace = locked(&self.pace);
        (pace.from, pace.period())
    }

    /// Holds or releases acquisition, independent of client requests: the record has no space, or is locked.
    pub(crate) fn hold(&self, hold: bool) {
        self.held.send_replace(hold);
    }

    /// Subscribes to holds.
    pub(crate) fn held(&self) -> watch::Receiver<bool> {
        self.held.subscribe()
    }

    /// Subscribes to the suspend request.
    pub(crate) fn suspend_request(&self) -> watch::Receiver<bool> {
        self.suspend.subscribe()
    }

    /// Grants this many more frames and returns the new limit; `None` for a session with a schedule.
    pub(crate) fn grant(&self, frames: u64) -> Option<u64> {
        let granted = self.granted.as_ref()?;
        let mut upto = 0;
        granted.send_modify(|granted| {
            *granted = granted.saturating_add(frames);
            upto = *granted;
        });
        Some(upto)
    }

    /// Subscribes to granted frames; `None` for a session with a schedule.
    pub(crate) fn grants(&self) -> Option<watch::Receiver<u64>> {
        self.granted.as_ref().map(watch::Sender::subscribe)
    }
}

/// Updates the counters, the last frame and the last map, which clients read.
impl FrameSink for Arc<SessionStatus> {
    fn frames(&mut self, frames: &[Arc<Published>]) -> Result<(), LogbookError> {
        for published in frames {
            let sequence = published.frame.sequence;
            let frame = &published.frame;
            let last = LastFrame {
                session: self.facts.id.clone(),
                sequence,
                wall: frame.wall,
                taken: frame.monotonic + frame.duration,
            };
            let overloads = published.quality.overloads as u64;
            self.counters.count_durable(last, overloads);
            if published.map.is_some() {
                self.counters.count_map(published.reconstruction);
            }
            locked(&self.pace).count(frame.monotonic);
            {
                let mut latest = locked(&self.latest);
                if published.map.is_some() {
                    latest.with_map = Some(Arc::clone(published));
                }
                latest.frame = Some(Arc::clone(published));
            }
            self.durable.send_replace(sequence);
        }
        Ok(())
    }

    fn late_map(&mut self, published: &Arc<Published>) -> Result<(), LogbookError> {
        self.counters.count_map(published.reconstruction);
        let mut latest = locked(&self.latest);
        latest.with_map = Some(Arc::clone(published));
        Ok(())
    }
}
