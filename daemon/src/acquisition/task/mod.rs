//! The acquisition task of one session: waits for the schedule, takes a frame, and sends it to the recorder. Clients
//! cannot delay it.

mod progress;
mod recorded;
#[cfg(test)]
mod tests;

pub(crate) use crate::acquisition::task::progress::AcquisitionProgress;

use std::sync::Arc;
use std::time::Duration;

use crate::events::kind::EventKind;
use imaging::recorded::RecordedError;
use rig::{
    AcquireError, Clock, EndReason, InjectionReadings, InjectionSink, RingTranscript, Stop,
    SystemClock,
};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, oneshot, watch};

use crate::acquisition::measuring::Measuring;
use crate::acquisition::playback::Recording;
use crate::acquisition::schedule::{Next, Schedule};
use crate::events::event::{BusEvent, Event};
use crate::events::event_log::EventLog;
use crate::instruments::assembly::AnyRig;
use crate::instruments::rig_plan::{InstrumentAddresses, RigPlan};
use crate::monitoring::heartbeat::{Heartbeats, IdleOnDrop, Part};
use crate::recording::recorder_message::RecorderMessage;
use crate::recording::session_status::SessionStatus;

/// Margin of the heartbeat beyond the longest time that a frame may take.
const HEARTBEAT_MARGIN: Duration = Duration::from_secs(120);

/// Where frames come from.
pub(crate) enum FrameSource {
    Rig {
        /// `None` after a fault, until the rig has been assembled again.
        rig: Option<AnyRig>,
        plan: Arc<RigPlan>,
    },
    Recording(Box<Recording>),
}

/// Why acquisition ended.
#[derive(Debug)]
pub(crate) enum AcquisitionEnd {
    /// As requested or scheduled.
    Done(String),
    /// The rig failed. It is safe, unless the text reports otherwise.
    Rig(Box<AcquireError>),
    /// The rig had been lost before the session used it.
    NoRig,
    /// The recording can no longer be read.
    Recording(Box<RecordedError>),
}

impl AcquisitionEnd {
    /// Text for people.
    pub(crate) fn text(&self) -> String {
        match self {
            Self::Done(reason) => reason.clone(),
            Self::Rig(error) => crate::acquisition::failed_frame::describe(error),
            Self::NoRig => "the rig was lost before the frame".to_owned(),
            Self::Recording(error) => survey::error_chain(error.as_ref()),
        }
    }
}

/// The inputs of the acquisition loop, except the source of frames.
pub(crate) struct Acquisition {
    pub status: Arc<SessionStatus>,
    pub schedule: Schedule,
    /// Speed of a recording; `None` for the configured one.
    pub speed: Option<f64>,
    pub clock: SystemClock,
    pub recorder: mpsc::Sender<RecorderMessage>,
    /// Reports pauses and their ends.
    pub pauses: mpsc::Sender<Pause>,
    /// Transcript of the messages to and from the instruments.
    pub transcript: RingTranscript,
    pub heartbeats: Arc<Heartbeats>,
    pub progress: AcquisitionProgress,
    pub measuring: Measuring,
    /// Receives the readings of each injection; `None` if they are not needed.
    pub injections: Option<mpsc::Sender<InjectionReadings>>,
    pub events: EventLog,
    /// The current plan of the session.
    pub plan: watch::Sender<Option<Arc<RigPlan>>>,
}

/// Acquisition pauses, or continues.
#[derive(Debug)]
pub(crate) struct Pause {
    pub pauses: bool,
    /// Completed when the daemon's state has changed, which acquisition waits for.
    pub applied: oneshot::Sender<()>,
}

/// Why a wait ended.
enum WaitEnd {
    Due,
    Stopped,
}

impl Acquisition {
    /// Takes frames until the schedule ends, a stop is requested, or a fault. After a fault of the rig it can be called
    /// again to continue.
    pub(crate) async fn run(&mut self, source: &mut FrameSource) -> AcquisitionEnd {
        if let (FrameSource::Recording(recording), None) = (&mut *source, self.progress.began) {
            recording.rewind(self.speed);
        }
        let _rests = IdleOnDrop(Arc::clone(&self.heartbeats), Part::Acquisition);
        let mut stop = self.status.stop_request();
        let mut suspend = self.status.suspend_request();
        let mut held = self.status.held();
        let mut grants = self.status.grants();
        let now = self.clock.monotonic();
        let began = *self.progress.began.get_or_insert(now);
        loop {
            // a hold may begin while the session is suspended, and the reverse
            while *suspend.borrow() || *held.borrow() {
                if *suspend.borrow() && matches!(source, FrameSource::Rig { .. }) {
                    let now = self.clock.monotonic();
                    let missed = self.progress.skip_missed(&self.schedule, now);
                    self.count_missed(missed).await;
                }
                let requested = self.wait_while_suspended(&mut suspend, &mut stop).await;
                if !requested.is_zero() {
                    // not counted: no frame was wanted during the pause
                    let now = self.clock.monotonic();
                    self.progress.skip_missed(&self.schedule, now);
                }
                self.progress.shift +=
                    requested + self.wait_while_suspended(&mut held, &mut stop).await;
                if stop.is_requested() {
                    break;
                }
                if !requested.is_zero() {
                    let text = format!("suspended on request for {:.0} s", requested.as_secs_f64());
                    self.note(EventKind::Paused, text).await;
                }
            }
            let AcquisitionProgress {
                taken, last, shift, ..
            } = self.progress;
            if stop.is_requested() {
                return AcquisitionEnd::Done(self.status.stop_reason());
            }
            let now = self.clock.monotonic();
            let (mut due, missed) = match self.schedule.next(began, taken, last, now) {
                Next::End(reason) => return AcquisitionEnd::Done(reason.to_owned()),
                Next::Frame { due, missed } => (due, missed),
            };
            if let FrameSource::Recording(recording) = source {
                match recording.due() {
                    Ok(Some(offset)) => due = began + shift + offset,
                    Ok(None) => return self.end_of_recording(),
                    Err(error) => match self.leave_out(recording, error).await {
                        Ok(()) => continue,
                        Err(ended) => return ended,
                    },
                }
            } else if missed > 0 {
                self.progress.skip_missed(&self.schedule, now);
                self.count_missed(missed).await;
            }
            let waited = match &mut grants {
                Some(grants) => {
                    self.heartbeats.set_idle(Part::Acquisition);
                    wait_for_grant(grants, taken, &mut stop).await
                }
                None => self.until(due, &mut stop, &mut suspend, &mut held).await,
            };
            match waited {
                WaitEnd::Stopped => return AcquisitionEnd::Done(self.status.stop_reason()),
                WaitEnd::Due if *suspend.borrow() || *held.borrow() => continue,
                WaitEnd::Due => {}
            }
            self.set_deadline(self.longest(source));
            let taken = match source {
                FrameSource::Rig {
                    rig: Some(rig),
                    plan,
                } => {
                    self.transcript.next_transcript();
                    let injections = self.injections.clone().map(|to| InjectionSink {
                        frame: self.status.acquired() + 1,
                        to,
                    });
                    let frame = self
                        .measuring
                        .frame(rig, plan, self.clock, &stop, injections)
                        .await;
                    self.report_measuring().await;
                    frame
                        .map(Some)
                        .map_err(|error| AcquisitionEnd::Rig(Box::new(error)))
                }
                FrameSource::Rig { rig: None, .. } => Err(AcquisitionEnd::NoRig),
                FrameSource::Recording(recording) => {
                    match recording.next(self.clock.monotonic(), self.clock.wall()) {
                        Ok(frame) => Ok(frame),
                        Err(error) => match self.leave_out(recording, error).await {
                            Ok(()) => continue,
                            Err(ended) => Err(ended),
                        },
                    }
                }
            };
            let frame = match taken {
                Ok(Some(frame)) => frame,
                Ok(None) => return self.end_of_recording(),
                Err(AcquisitionEnd::Rig(error))
                    if stop.is_requested()
                        && error.made_safe.is_ok()
                        && matches!(error.reason, EndReason::Stop(_)) =>
                {
                    return AcquisitionEnd::Done(self.status.stop_reason());
                }
                Err(ended) => return ended,
            };
            self.progress.taken += 1;
            self.progress.last = Some(due);
            self.status.count_acquired();
            // the recorder may wait for space, and has its own heartbeat
            self.heartbeats.set_idle(Part::Acquisition);
            let handed_over = match self
                .recorder
                .try_send(RecorderMessage::Frame(Box::new(frame)))
            {
                Ok(()) => true,
                Err(TrySendError::Closed(_)) => false,
                Err(TrySendError::Full(frame)) => match source {
                    FrameSource::Recording(_) => self.recorder.send(frame).await.is_ok(),
                    FrameSource::Rig { .. } => self.wait_for_the_logbook(frame).await,
                },
            };
            if !handed_over {
                return AcquisitionEnd::Done(self.status.stop_reason());
            }
        }
    }

    fn set_deadline(&self, within: Duration) {
        let now = self.clock.monotonic();
        self.heartbeats.set_deadline(Part::Acquisition, now, within);
    }

    /// The longest time that a frame may take. If it takes longer, something hangs that no I/O timeout has ended.
    fn longest(&self, source: &FrameSource) -> Duration {
        match source {
            FrameSource::Rig { plan, .. } => {
                let now = self.measuring.now();
                let plan = now.as_ref().unwrap_or(plan);
                longest_frame(plan.plan.duration(&plan.timing), &plan.instruments)
            }
            FrameSource::Recording(_) => HEARTBEAT_MARGIN,
        }
    }

    /// Reports events about ranges and offsets, and the changed plan.
    async fn report_measuring(&mut self) {
        for (kind, text) in self.measuring.take_events() {
            let at = self.clock.wall();
            let event = Event::new(at, kind, &text, Some(&self.status.facts.id));
            self.plan.send_replace(self.measuring.now());
            self.events.publish(&BusEvent::Happened(event.clone()));
            self.record(event).await;
        }
    }

    async fn record(&self, event: Event) {
        // a full queue (for example at a full disk) does not mean that acquisition hangs: the record has its own
        // heartbeat
        self.heartbeats.set_idle(Part::Acquisition);
        // a recorder that has ended is noticed at the next frame
        let _ = self.recorder.send(RecorderMessage::Event(event)).await;
    }

    /// Waits until the logbook accepts the frame; false if it has ended. The logbook is the only sink that may delay
    /// acquisition: between frames, with the source off; the pause is reported.
    async fn wait_for_the_logbook(&self, frame: RecorderMessage) -> bool {
        self.report_pause(true).await;
        self.status.set_suspended(true);
        self.status
            .set_last_error("the logbook cannot keep up; acquisition waits, the source is off");
        let since = self.clock.monotonic();
        let sent = self.recorder.send(frame).await.is_ok();
        let waited = self.clock.monotonic().saturating_sub(since);
        if waited > Duration::from_secs(1) {
            let text = format!(
                "the logbook could not keep up for {:.1} s",
                waited.as_secs_f64()
            );
            self.note(EventKind::Paused, text).await;
        }
        self.report_pause(false).await;
        self.status.set_suspended(false);
        self.status.set_last_error("");
        sent
    }

    /// Returns when the daemon's state reflects the pause.
    async fn report_pause(&self, pauses: bool) {
        let (applied, done) = oneshot::channel();
        if self.pauses.send(Pause { pauses, applied }).await.is_ok() {
            let _ = done.await;
        }
    }

    /// Writes an event to the record only: it explains a gap.
    async fn note(&self, kind: EventKind, text: String) {
        let at = self.clock.wall();
        let event = Event::new(at, kind, &text, Some(&self.status.facts.id));
        self.record(event).await;
    }

    /// Waits while suspended; returns the duration.
    async fn wait_while_suspended(
        &self,
        suspend: &mut watch::Receiver<bool>,
        stop: &mut Stop,
    ) -> Duration {
        if !*suspend.borrow() {
            return Duration::ZERO;
        }
        let from = self.clock.monotonic();
        self.heartbeats.set_idle(Part::Acquisition);
        // the daemon's state changes first: a client that sees the session suspended also finds the daemon suspended
        self.report_pause(true).await;
        self.status.set_suspended(true);
        tokio::select! {
            () = stop.requested() => {}
            _ = suspend.wait_for(|suspended| !*suspended) => {}
        }
        self.report_pause(false).await;
        self.status.set_suspended(false);
        self.clock.monotonic() - from
    }

    async fn until(
        &self,
        due: Duration,
        stop: &mut Stop,
        suspend: &mut watch::Receiver<bool>,
        held: &mut watch::Receiver<bool>,
    ) -> WaitEnd {
        let wait = due.saturating_sub(self.clock.monotonic());
        self.set_deadline(wait.saturating_add(HEARTBEAT_MARGIN));
        if wait.is_zero() {
            // lets other tasks run between back-to-back frames
            tokio::task::yield_now().await;
            return if stop.is_requested() {
                WaitEnd::Stopped
            } else {
                WaitEnd::Due
            };
        }
        tokio::select! {
            () = stop.requested() => WaitEnd::Stopped,
            _ = suspend.wait_for(|suspended| *suspended) => WaitEnd::Due,
            _ = held.wait_for(|held| *held) => WaitEnd::Due,
            () = tokio::time::sleep(wait) => WaitEnd::Due,
        }
    }
}

/// The longest time that a frame of this planned duration may take, including a zero-current frame before it and the
/// timeouts of the instruments' replies and of switching off.
fn longest_frame(planned: Duration, instruments: &InstrumentAddresses) -> Duration {
    let timeouts = [
        &instruments.source,
        &instruments.switch,
        &instruments.voltmeter,
    ];
    let timeouts = timeouts.iter().fold(Duration::ZERO, |sum, (_, timeout)| {
        sum.saturating_add(*timeout)
    });
    let margin = HEARTBEAT_MARGIN.max(timeouts.saturating_mul(4));
    planned.saturating_mul(4).saturating_add(margin)
}

async fn wait_for_grant(grants: &mut watch::Receiver<u64>, taken: u64, stop: &mut Stop) -> WaitEnd {
    tokio::select! {
        () = stop.requested() => WaitEnd::Stopped,
        granted = grants.wait_for(|granted| *granted > taken) => match granted {
            Ok(_) => WaitEnd::Due,
            Err(_) => WaitEnd::Stopped,
        },
    }
}
