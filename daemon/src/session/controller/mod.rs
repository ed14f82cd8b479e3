//! The controller, one per daemon: holds the rig, starts and ends sessions, keeps the baseline.

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

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, RwLock};

use chrono::{DateTime, Utc};
use dbus::Fault;
use rig::{Clock, RingTranscript, SystemClock};
use survey::{Baseline, Settings};
use tokio::sync::{Notify, watch};

use crate::acquisition::task::FrameSource;
use crate::events::event::BusEvent;
use crate::events::event_log::EventLog;
use crate::instruments::assembly::{Assembled, Bench};
use crate::instruments::identities::ExpectedIdentities;
use crate::instruments::lock::InstrumentLocks;
use crate::instruments::rig_plan::RigPlan;
use crate::monitoring::Observed;
use crate::monitoring::heartbeat::Heartbeats;
use crate::preparation::{FramesFrom, Prepared, Setup};
use crate::recording::end_marks::EndMarks;
use crate::recording::records::Records;
use crate::recording::session_status::SessionStatus;
use crate::session::state::{State, Trigger};
use survey::error_chain as chain;

/// What a configuration means; another one takes its place at a reload.
pub(crate) struct Runtime {
    pub setup: Setup,
    /// What clients draw maps on, made when the first of them asks.
    pub drawn: OnceLock<dbus::Geometry>,
    /// `None` for a recording.
    pub plan: Option<Arc<RigPlan>>,
    pub settings: Option<Settings>,
    pub bench: Bench,
    pub simulated: bool,
    pub clock: SystemClock,
    pub build: String,
    /// The file it was read from.
    pub config: PathBuf,
}

/// The state of the daemon, and all that changes it.
pub(crate) struct Controller {
    runtime: RwLock<Arc<Runtime>>,
    /// Where events are reported.
    pub events: EventLog,
    /// What the monitors read.
    pub observed: Observed,
    /// The sessions on disk.
    pub records: Records,
    /// How the running session measures.
    session_plan: watch::Sender<Option<Arc<RigPlan>>>,
    /// Whether the record has been read; no session is started before.
    begun: watch::Sender<bool>,
    /// What was said lately over the wires.
    pub transcript: RingTranscript,
    pub heartbeats: Arc<Heartbeats>,
    /// Which sessions have ended, whatever their files say.
    ends: Arc<EndMarks>,
    source: tokio::sync::Mutex<FrameSource>,
    /// The instruments that no other daemon may use.
    locks: Mutex<InstrumentLocks>,
    /// Somebody has agreed to other instruments.
    agreed: Notify,
    inner: Mutex<Inner>,
    /// What is remarkable of the baseline with this id.
    remarked: tokio::sync::Mutex<Option<(String, Vec<String>)>>,
}

struct Inner {
    state: State,
    baseline: Option<Arc<Baseline>>,
    active: Option<Arc<SessionStatus>>,
    /// An interrupted session that cannot be resumed yet.
    interrupted: Option<Arc<SessionStatus>>,
    recent: VecDeque<Arc<SessionStatus>>,
    /// Why the rig cannot be used, until it is found again.
    rig_fault: Option<String>,
    /// Stops the self-test that runs.
    test: Option<rig::StopButton>,
    /// Why a person must look first: relays found closed at the start.
    closed: Option<String>,
    identities: ExpectedIdentities,
    /// Others than the known ones were found; nobody has agreed yet.
    others: Option<ExpectedIdentities>,
    /// The source could not be verified off.
    source_unknown: bool,
    /// The relays could not be verified open.
    relays_unknown: bool,
    recovery: Option<Recovery>,
    /// A configuration that waits for the end of a session.
    waiting: Option<Box<Prepared>>,
}

/// A lost rig being looked for.
#[derive(Debug, Clone)]
pub(crate) struct Recovery {
    /// What was lost, or what stands in the way.
    pub what: String,
    /// Tries so far.
    pub tries: u64,
    /// When the next one is due; `None` while one is under way.
    pub next: Option<tokio::time::Instant>,
    pub since: DateTime<Utc>,
    /// Whether only a person can go on.
    pub person: bool,
}

impl Controller {
    /// Takes over a rig or a recording that has been prepared; nothing runs yet.
    pub(crate) fn new(
        prepared: Prepared,
        bench: Bench,
        assembled: Option<Assembled>,
        records: Records,
        transcript: RingTranscript,
        clock: SystemClock,
    ) -> Arc<Self> {
        let simulated = prepared.is_simulated();
        let (rig, identities, closed) = match assembled {
            Some(assembled) => (Some(assembled.rig), assembled.identities, assembled.closed),
            None => (None, ExpectedIdentities::default(), None),
        };
        let Prepared {
            setup,
            frames,
            file,
        } = prepared;
        let slow = records.takes_long();
        let (source, settings, plan, baseline) = match frames {
            FramesFrom::Rig(plan) => {
                let settings = plan.settings();
                let source = FrameSource::Rig {
                    rig,
                    plan: Arc::clone(&plan),
                };
                let baseline = match slow {
                    true => None,
                    false => latest_baseline(&records, clock.wall()),
                };
                (source, Some(settings), Some(plan), baseline)
            }
            FramesFrom::Recording {
                recording,
                baseline,
            } => {
                let settings = recording.frames().settings();
                (
                    FrameSource::Recording(recording),
                    settings,
                    None,
                    Some(*baseline),
                )
            }
        };
        let events = EventLog::new(setup.record_directory.clone());
        let ends = EndMarks::open(&setup.record_directory, &setup.config.runtime_directory());
        Arc::new(Self {
            runtime: RwLock::new(Arc::new(Runtime {
                build: format!("tactusd {}", env!("CARGO_PKG_VERSION")),
                setup,
                drawn: OnceLock::new(),
                plan,
                settings,
                bench,
                simulated,
                clock,
                config: file,
            })),
            events,
            observed: Observed::new(clock),
            session_plan: watch::Sender::default(),
            records,
            begun: watch::Sender::new(!slow),
            transcript,
            heartbeats: Arc::default(),
            ends: Arc::new(ends),
            source: tokio::sync::Mutex::new(source),
            locks: Mutex::default(),
            agreed: Notify::new(),
            remarked: tokio::sync::Mutex::default(),
            inner: Mutex::new(Inner {
                state: match &closed {
                    Some(why) => State::Faulted(why.clone()),
                    None => State::Idle,
                },
                baseline: baseline.map(Arc::new),
                active: None,
                interrupted: None,
                recent: VecDeque::new(),
                rig_fault: closed.clone(),
                closed,
                identities,
                others: None,
                source_unknown: false,
                relays_unknown: false,
                recovery: None,
                waiting: None,
                test: None,
            }),
        })
    }

    /// Whether so many sessions are to be read that it is done beside the start, by [`Controller::read_the_record`].
    pub(crate) fn has_much_to_read(&self) -> bool {
        !*self.begun.borrow()
    }

    /// Reads the record, however long that takes, and takes the last baseline from it.
    pub(crate) async fn read_the_record(self: &Arc<Self>) {
        let controller = Arc::clone(self);
        let now = self.runtime().clock.wall();
        let found =
            tokio::task::spawn_blocking(move || latest_baseline(&controller.records, now)).await;
        if !self.is_recording()
            && let Ok(Some(baseline)) = found
        {
            self.inner().baseline = Some(Arc::new(baseline));
            self.events.publish(&BusEvent::Daemon);
        }
    }

    /// The record has been read, and what was interrupted goes on: sessions may be started.
    pub(crate) fn begin_to_start(&self) {
        self.begun.send_replace(true);
    }

    /// Waits until sessions may be started.
    async fn may_start(&self) {
        // the sender lives in self
        let _ = self.begun.subscribe().wait_for(|begun| *begun).await;
    }

    /// So many sessions of the record, the newest first, where named those that come after the one with this id.
    ///
    /// # Errors
    /// The record cannot be read, or there is no such session.
    pub(crate) fn listed(
        &self,
        count: usize,
        before: Option<&str>,
    ) -> Result<Vec<logbook::SessionSummary>, Fault> {
        self.records.listed(count, before)
    }

    /// Holds what was claimed as long as it lives.
    pub(crate) fn hold(&self, locks: InstrumentLocks) {
        *self.locks.lock().unwrap_or_else(PoisonError::into_inner) = locks;
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the configuration in force means.
    pub(crate) fn runtime(&self) -> Arc<Runtime> {
        let runtime = self.runtime.read().unwrap_or_else(PoisonError::into_inner);
        Arc::clone(&runtime)
    }

    /// The instruments that are known.
    pub(crate) fn identities(&self) -> ExpectedIdentities {
        self.inner().identities.clone()
    }

    /// What is known of the source: `off` (verified), `in use`, `unknown`.
    pub(crate) fn source_state(&self) -> &'static str {
        let inner = self.inner();
        match &inner.state {
            _ if inner.source_unknown => "unknown",
            State::Baseline | State::Acquiring | State::Testing => "in use",
            _ => "off",
        }
    }

    /// The lost rig that is being looked for, if one is.
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

    /// The running session, else the one that was interrupted and cannot go on yet: what a stop ends.
    pub(crate) fn to_stop(&self) -> Option<Arc<SessionStatus>> {
        let inner = self.inner();
        inner
            .active
            .as_ref()
            .or(inner.interrupted.as_ref())
            .cloned()
    }

    /// The running session, one that cannot go on yet, and those that ended a short while ago.
    pub(crate) fn sessions(&self) -> Vec<Arc<SessionStatus>> {
        let inner = self.inner();
        let now = inner.active.iter().chain(&inner.interrupted);
        inner.recent.iter().chain(now).cloned().collect()
    }

    /// How the running session measures, else how one would; `None` for a recording.
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

    /// Changes the state; a refusal leaves it.
    fn change_state(&self, trigger: Trigger) -> Result<(), crate::session::state::Refusal> {
        let outcome = {
            let mut inner = self.inner();
            let state = std::mem::replace(&mut inner.state, State::Idle);
            match state.after(trigger) {
                Ok(next) => {
                    inner.state = next;
                    Ok(())
                }
                Err((kept, error)) => {
                    inner.state = kept;
                    Err(error)
                }
            }
        };
        if outcome.is_ok() {
            let status = self.state().to_string();
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Status(&status)]);
            self.events.publish(&BusEvent::Daemon);
        }
        outcome
    }

    /// Ends whatever runs and leaves the source off and verified. Where it is not `for_good`, a measurement goes on with
    /// the next daemon.
    ///
    /// # Errors
    /// What could not be made safe.
    pub(crate) async fn shut_down(&self, why: &str, for_good: bool) -> Result<(), String> {
        self.stop_test();
        if let Some(status) = self.to_stop() {
            let goes_on = !for_good
                && status.facts.kind == logbook::SessionKind::Measurement
                && self.runtime().setup.config.record.resume
                && !self.is_recording();
            match goes_on {
                true => status.leave(why),
                false => status.stop(why),
            }
            status.ended().await;
        }
        if self.rig_fault().is_some() {
            self.reassemble_rig().await?;
        }
        self.make_safe().await
    }

    /// Source off and relays open, verified, as soon as nobody else works with the rig.
    pub(crate) async fn make_safe(&self) -> Result<(), String> {
        let source = self.source.lock().await;
        match &*source {
            FrameSource::Rig {
                rig: Some(rig),
                plan,
            } => rig
                .safe_off(&plan.plan.wiring)
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
