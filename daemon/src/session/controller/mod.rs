//! The controller (one per daemon): owns the instruments, starts and stops sessions, keeps the current baseline.

mod baselines;
mod reconnect;
mod recovery;
mod reload;
mod resume;
mod rig_events;
mod run;
mod self_test;
mod session_end;
mod session_options;
mod waiting;

pub(crate) use crate::session::controller::session_options::{no_baseline, no_plan};

use std::collections::{HashMap, VecDeque};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock};

use chrono::{DateTime, Utc};
use dbus::Fault;
use rig::{Clock, RingTranscript, SystemClock, safe_off};
use sd_notify::NotifyState;
use survey::{Baseline, Settings};
use tokio::sync::{Notify, OwnedMutexGuard, watch};

use crate::acquisition::task::FrameSource;
use crate::alarms::AlarmDesk;
use crate::events::event::{BusEvent, Event};
use crate::events::event_log::EventLog;
use crate::instruments::assembly::{Assembled, SourceState};
use crate::instruments::identities::ExpectedIdentities;
use crate::instruments::lock::InstrumentLocks;
use crate::instruments::rig_plan::RigPlan;
use crate::instruments::simulation::SimulatedRig;
use crate::locked::locked;
use crate::monitoring::Observed;
use crate::monitoring::heartbeat::Heartbeats;
use crate::monitoring::service_manager;
use crate::preparation::{FramesFrom, Prepared, Setup};
use crate::recording::end_marks::EndMarks;
use crate::recording::records::Records;
use crate::recording::session_status::SessionStatus;
use crate::session::state::{State, Trigger};
use survey::error_chain as chain;

/// The resolved configuration; replaced at a reload.
pub(crate) struct Runtime {
    pub setup: Setup,
    /// Geometry for drawing maps, computed at the first request.
    pub drawn: OnceLock<dbus::Geometry>,
    /// `None` for a recording.
    pub plan: Option<Arc<RigPlan>>,
    pub settings: Option<Settings>,
    pub simulated_rig: Option<SimulatedRig>,
    pub simulated: bool,
    pub clock: SystemClock,
    /// The file it was read from.
    pub config: PathBuf,
}

impl Runtime {
    /// The resolved configuration, and where its frames come from.
    fn of(
        prepared: Prepared,
        simulated_rig: Option<SimulatedRig>,
        clock: SystemClock,
    ) -> (Self, FramesFrom) {
        let simulated = prepared.is_simulated();
        let config = prepared.source.file().to_owned();
        let Prepared { setup, frames, .. } = prepared;
        let (plan, settings) = match &frames {
            FramesFrom::Rig(plan) => (Some(Arc::clone(plan)), Some(plan.settings())),
            FramesFrom::Recording { recording, .. } => (None, recording.frames().settings()),
        };
        let runtime = Self {
            setup,
            drawn: OnceLock::new(),
            plan,
            settings,
            simulated_rig,
            simulated,
            clock,
            config,
        };
        (runtime, frames)
    }
}

/// The state of the daemon, and the operations that change it.
pub(crate) struct Controller {
    runtime: Mutex<Arc<Runtime>>,
    /// Where events are reported.
    pub events: EventLog,
    /// The daemon's problems and the rules of `[[alarm]]`.
    pub alarms: AlarmDesk,
    /// Data for the monitors.
    pub observed: Observed,
    /// The sessions on disk.
    pub records: Records,
    /// The plan of the running session.
    session_plan: watch::Sender<Option<Arc<RigPlan>>>,
    /// Whether sessions may be started: the record has been read.
    begun: watch::Sender<bool>,
    /// Recent messages to and from the instruments.
    pub transcript: RingTranscript,
    pub heartbeats: Arc<Heartbeats>,
    /// Marks of ended sessions, independent of their files.
    ends: Arc<EndMarks>,
    source: tokio::sync::Mutex<FrameSource>,
    /// Locked while a session begins: a stop of the daemon waits until the session exists and can be stopped.
    beginning: tokio::sync::Mutex<()>,
    /// Locked while a configuration is applied, and from the checks of a start until its session has begun: a reload in
    /// between would invalidate the checks.
    reloading: Arc<tokio::sync::Mutex<()>>,
    /// The locks of the instruments, which no other daemon may use.
    locks: Mutex<InstrumentLocks>,
    /// Notified when the operator has accepted other instruments.
    agreed: Notify,
    inner: Mutex<Inner>,
    /// Remarks on baselines by id, without those on their noise.
    remarked: Arc<tokio::sync::Mutex<HashMap<String, Vec<String>>>>,
}

struct Inner {
    state: State,
    /// Whether the daemon is being stopped: no operation that uses the source may begin.
    stopping: bool,
    baseline: Option<Arc<Baseline>>,
    active: Option<Arc<SessionStatus>>,
    /// An interrupted session that cannot be resumed yet.
    interrupted: Option<Arc<SessionStatus>>,
    recent: VecDeque<Arc<SessionStatus>>,
    /// Why the rig cannot be used, until it is reconnected.
    rig_fault: Option<String>,
    /// Stops the running self-test.
    test: Option<rig::StopButton>,
    /// Why measuring is refused until an operator has checked: relays found closed at the start.
    closed: Option<String>,
    identities: ExpectedIdentities,
    /// Whether no instrument of a configuration with another rig has been reached since its reload: `identities` are
    /// those of the rig before, and any are accepted, as at the reload.
    rig_is_new: bool,
    /// Unexpected instruments that were found and not accepted yet.
    others: Option<ExpectedIdentities>,
    source_state: SourceState,
    /// Whether the relays could not be verified open.
    relays_unknown: bool,
    recovery: Option<Recovery>,
    /// Whether a task tries to reconnect the lost rig.
    looking: bool,
    /// A configuration to be applied at the end of the session.
    waiting: Option<Box<Prepared>>,
}

impl Inner {
    /// Refuses to begin an operation that uses the source while the daemon is being stopped.
    fn check_not_stopping(&self) -> Result<(), Fault> {
        match self.stopping {
            true => Err(Fault::SessionActive("the daemon is being stopped".into())),
            false => Ok(()),
        }
    }
}

/// A lost rig that is being reconnected.
#[derive(Debug, Clone)]
pub(crate) struct Recovery {
    /// What was lost, or what prevents reconnecting.
    pub what: String,
    /// Attempts so far.
    pub tries: u64,
    /// Time of the next attempt; `None` during one.
    pub next: Option<tokio::time::Instant>,
    pub since: DateTime<Utc>,
    /// Whether the operator must act first.
    pub person: bool,
}

impl Controller {
    /// Takes over a prepared rig or recording; nothing is started.
    pub(crate) fn new(
        prepared: Prepared,
        simulated_rig: Option<SimulatedRig>,
        assembled: Option<Assembled>,
        records: Records,
        transcript: RingTranscript,
        clock: SystemClock,
    ) -> Arc<Self> {
        let (rig, identities, closed) = match assembled {
            Some(assembled) => (Some(assembled.rig), assembled.identities, assembled.closed),
            None => (None, ExpectedIdentities::default(), None),
        };
        let (runtime, frames) = Runtime::of(prepared, simulated_rig, clock);
        let setup = &runtime.setup;
        let slow = records.takes_long();
        let (source, baseline) = match frames {
            FramesFrom::Rig(plan) => {
                let baseline = match slow {
                    true => None,
                    false => latest_baseline(&records, clock.wall()),
                };
                (FrameSource::Rig { rig, plan }, baseline)
            }
            FramesFrom::Recording {
                recording,
                baseline,
            } => (FrameSource::Recording(recording), Some(*baseline)),
        };
        let events = EventLog::new(setup.record_directory.clone());
        let (alarms, changes) = AlarmDesk::open(&setup.record_directory, &setup.config);
        for change in changes {
            events.report(Event::new(clock.wall(), change.kind, &change.text, None));
        }
        let ends = EndMarks::open(&setup.record_directory, &setup.config.runtime_directory());
        Arc::new(Self {
            runtime: Mutex::new(Arc::new(runtime)),
            events,
            alarms,
            observed: Observed::new(clock),
            session_plan: watch::Sender::default(),
            records,
            begun: watch::Sender::new(!slow),
            transcript,
            heartbeats: Arc::default(),
            ends: Arc::new(ends),
            source: tokio::sync::Mutex::new(source),
            beginning: tokio::sync::Mutex::default(),
            reloading: Arc::default(),
            locks: Mutex::default(),
            agreed: Notify::new(),
            remarked: Arc::default(),
            inner: Mutex::new(Inner {
                state: match &closed {
                    Some(why) => State::Faulted(why.clone()),
                    None => State::Idle,
                },
                stopping: false,
                baseline: baseline.map(Arc::new),
                active: None,
                interrupted: None,
                recent: VecDeque::new(),
                rig_fault: closed.clone(),
                closed,
                identities,
                rig_is_new: false,
                others: None,
                source_state: SourceState::Off,
                relays_unknown: false,
                recovery: None,
                looking: false,
                waiting: None,
                test: None,
            }),
        })
    }

    /// Whether the record has so many unread sessions that it is read after the start, by
    /// [`Controller::read_the_record`].
    pub(crate) fn has_much_to_read(&self) -> bool {
        !*self.begun.borrow()
    }

    /// Reads the record, and makes its last baseline the current one.
    pub(crate) async fn read_the_record(self: &Arc<Self>) {
        let found = self.last_baseline().await;
        if !self.is_recording() && found.is_some() {
            self.inner().baseline = found;
            self.events.publish(&BusEvent::Daemon);
        }
    }

    /// The last baseline of the record.
    async fn last_baseline(self: &Arc<Self>) -> Option<Arc<Baseline>> {
        let (controller, now) = (Arc::clone(self), self.runtime().clock.wall());
        let found = tokio::task::spawn_blocking(move || latest_baseline(&controller.records, now));
        found.await.ok().flatten().map(Arc::new)
    }

    /// Allows sessions to start, after the record has been read and interrupted sessions have been resumed.
    pub(crate) fn begin_to_start(&self) {
        self.begun.send_replace(true);
    }

    /// Waits until sessions may be started.
    async fn may_start(&self) {
        // cannot fail: the sender is in `self`
        let _ = self.begun.subscribe().wait_for(|begun| *begun).await;
    }

    /// Keeps the locks of the instruments.
    pub(crate) fn hold(&self, locks: InstrumentLocks) {
        *locked(&self.locks) = locks;
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        locked(&self.inner)
    }

    /// The resolved configuration in force.
    pub(crate) fn runtime(&self) -> Arc<Runtime> {
        Arc::clone(&locked(&self.runtime))
    }

    /// The expected instruments.
    pub(crate) fn identities(&self) -> ExpectedIdentities {
        self.inner().identities.clone()
    }

    /// State of the source: `off` (verified), `in use`, `unknown`.
    pub(crate) fn source_state(&self) -> &'static str {
        let inner = self.inner();
        match &inner.state {
            _ if inner.source_state != SourceState::Off => "unknown",
            State::Baseline | State::Acquiring | State::Testing => "in use",
            _ => "off",
        }
    }

    /// The lost rig that is being reconnected, if any.
    pub(crate) fn recovery(&self) -> Option<Recovery> {
        self.inner().recovery.clone()
    }

    pub(crate) fn state(&self) -> State {
        self.inner().state.clone()
    }

    pub(crate) fn baseline(&self) -> Option<Arc<Baseline>> {
        self.inner().baseline.clone()
    }

    pub(crate) fn active(&self) -> Option<Arc<SessionStatus>> {
        self.inner().active.clone()
    }

    /// The session that a stop ends: the running one, or an interrupted one waiting to be resumed.
    pub(crate) fn to_stop(&self) -> Option<Arc<SessionStatus>> {
        let inner = self.inner();
        inner
            .active
            .as_ref()
            .or(inner.interrupted.as_ref())
            .cloned()
    }

    /// The running session, one waiting to be resumed, and those that ended recently.
    pub(crate) fn sessions(&self) -> Vec<Arc<SessionStatus>> {
        let inner = self.inner();
        let now = inner.active.iter().chain(&inner.interrupted);
        inner.recent.iter().chain(now).cloned().collect()
    }

    /// The plan of the running session, else of the next one; `None` for a recording.
    pub(crate) fn plan(&self) -> Option<Arc<RigPlan>> {
        let of_session = self.session_plan.borrow().clone();
        of_session.or_else(|| self.runtime().plan.clone())
    }

    /// Whether frames come from a recording.
    pub(crate) fn is_recording(&self) -> bool {
        self.runtime().plan.is_none()
    }

    /// Why an instrument cannot be used; `None` when all can.
    pub(crate) fn rig_fault(&self) -> Option<String> {
        self.inner().rig_fault.clone()
    }

    /// Changes the state, and returns the one before; unchanged if the transition is refused.
    fn change_state(&self, trigger: Trigger) -> Result<State, crate::session::state::Refusal> {
        let outcome = {
            let mut inner = self.inner();
            let state = std::mem::replace(&mut inner.state, State::Idle);
            match state.clone().after(trigger) {
                Ok(next) => {
                    inner.state = next;
                    Ok(state)
                }
                Err((kept, error)) => {
                    inner.state = kept;
                    Err(error)
                }
            }
        };
        if outcome.is_ok() {
            let status = self.state().to_string();
            service_manager::notify(&[NotifyState::Status(&status)]);
            self.events.publish(&BusEvent::Daemon);
        }
        outcome
    }

    /// Ends the running session or test, and leaves the source off and verified. Unless `for_good`, the next daemon
    /// resumes a measurement.
    ///
    /// # Errors
    /// A part of the rig could not be made safe.
    pub(crate) async fn shut_down(&self, why: &str, for_good: bool) -> Result<(), String> {
        self.inner().stopping = true;
        self.stop_test();
        self.no_session_begins().await;
        if let Some(status) = self.to_stop() {
            let goes_on = !for_good
                && status.facts.kind == logbook::SessionKind::Measurement
                && self.runtime().setup.config.record.resume
                && !self.is_recording();
            match goes_on {
                true => status.end_resumable(why),
                false => status.stop(why),
            }
            status.ended().await;
        }
        if self.rig_fault().is_some() {
            self.reassemble_rig().await?;
        }
        self.make_safe().await
    }

    /// Waits until no configuration is being applied; none is applied while the guard is held.
    async fn without_reload(&self) -> OwnedMutexGuard<()> {
        Arc::clone(&self.reloading).lock_owned().await
    }

    /// Waits until a session that is beginning has begun. It can be stopped only then; if it were not stopped, it would
    /// switch the current on later.
    pub(crate) async fn no_session_begins(&self) {
        drop(self.beginning.lock().await);
    }

    /// Switches the source off and opens the relays, both verified, as soon as the rig is not in use.
    pub(crate) async fn make_safe(&self) -> Result<(), String> {
        let source = self.source.lock().await;
        match &*source {
            FrameSource::Rig {
                rig: Some(rig),
                plan,
            } => safe_off(rig, &plan.plan.wiring)
                .await
                .map_err(|error| error.to_string()),
            FrameSource::Rig { rig: None, .. } => {
                Err("the rig was lost and has not come back; its state is unknown".to_owned())
            }
            FrameSource::Recording(_) => Ok(()),
        }
    }
}

fn latest_baseline(records: &Records, now: DateTime<Utc>) -> Option<Baseline> {
    records.latest_baseline(now).unwrap_or_else(|error| {
        tracing::warn!("the last baseline cannot be read: {}", chain(&error));
        None
    })
}
