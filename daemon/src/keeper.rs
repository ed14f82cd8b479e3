//! Who keeps watch: one per daemon, holds the rig, starts and ends sessions, remembers the baseline.

mod asked;
mod rig_again;
mod run;

pub(crate) use asked::no_baseline;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bus::Fault;
use logbook::LogbookError;
use rig::SystemClock;
use survey::{Baseline, Settings};

use crate::herald::{Herald, Notice};
use crate::live::Live;
use crate::model::chain;
use crate::prepare::{FramesFrom, Prepared, RigPlan, Setup};
use crate::rig_assembly::{Assembled, Bench, Found};
use crate::session::{Event, State};
use crate::watch::FrameSource;

/// What never changes while the daemon runs.
pub(crate) struct House {
    pub setup: Setup,
    /// `None` for a recording.
    pub plan: Option<Arc<RigPlan>>,
    pub settings: Option<Settings>,
    pub bench: Bench,
    pub simulated: bool,
    pub instruments: Vec<Found>,
    pub modules: Vec<String>,
    pub clock: SystemClock,
    pub build: String,
}

/// The daemon's one head.
pub(crate) struct Keeper {
    pub house: House,
    pub herald: Herald,
    source: tokio::sync::Mutex<FrameSource>,
    inner: Mutex<Inner>,
}

struct Inner {
    state: State,
    baseline: Option<Arc<Baseline>>,
    active: Option<Arc<Live>>,
    recent: VecDeque<Arc<Live>>,
    /// Why the rig cannot be used, until it is found again.
    rig_fault: Option<String>,
}

impl Keeper {
    /// Takes over a rig or a recording that has been prepared; nothing runs yet.
    pub(crate) fn new(
        prepared: Prepared,
        bench: Bench,
        assembled: Option<Assembled>,
        clock: SystemClock,
    ) -> Arc<Self> {
        let simulated = prepared.is_simulated();
        let (rig, instruments, modules) = match assembled {
            Some(assembled) => (
                Some(assembled.rig),
                assembled.instruments,
                assembled.modules,
            ),
            None => (None, Vec::new(), Vec::new()),
        };
        let Prepared { setup, frames } = prepared;
        let (source, settings, plan, baseline) = match frames {
            FramesFrom::Rig(plan) => {
                let settings = rig::settings(&plan.plan, plan.meter);
                let source = FrameSource::Rig {
                    rig,
                    plan: Arc::clone(&plan),
                };
                let latest =
                    logbook::latest_baseline(&setup.record_directory).unwrap_or_else(|error| {
                        tracing::warn!("the last baseline cannot be read: {}", chain(&error));
                        None
                    });
                let baseline = latest.map(|(_, baseline)| baseline);
                (source, Some(settings), Some(plan), baseline)
            }
            FramesFrom::Recording {
                recording,
                baseline,
            } => {
                let settings = recording.settings();
                (
                    FrameSource::Recording(recording),
                    settings,
                    None,
                    Some(*baseline),
                )
            }
        };
        Arc::new(Self {
            house: House {
                build: format!("tactusd {}", env!("CARGO_PKG_VERSION")),
                setup,
                plan,
                settings,
                bench,
                simulated,
                instruments,
                modules,
                clock,
            },
            herald: Herald::default(),
            source: tokio::sync::Mutex::new(source),
            inner: Mutex::new(Inner {
                state: State::Idle,
                baseline: baseline.map(Arc::new),
                active: None,
                recent: VecDeque::new(),
                rig_fault: None,
            }),
        })
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn state(&self) -> State {
        self.inner().state.clone()
    }

    pub(crate) fn baseline(&self) -> Option<Arc<Baseline>> {
        self.inner().baseline.clone()
    }

    pub(crate) fn active(&self) -> Option<Arc<Live>> {
        self.inner().active.clone()
    }

    /// The running session and those that ended a short while ago.
    pub(crate) fn sessions(&self) -> Vec<Arc<Live>> {
        let inner = self.inner();
        inner.recent.iter().chain(&inner.active).cloned().collect()
    }

    /// Whether frames come from a recording.
    pub(crate) fn is_recording(&self) -> bool {
        self.house.plan.is_none()
    }

    /// Why an instrument cannot be used; `None` when all can.
    pub(crate) fn rig_fault(&self) -> Option<String> {
        self.inner().rig_fault.clone()
    }

    /// Changes the state; a refusal leaves it.
    fn happened(&self, event: Event) -> Result<(), crate::session::Refusal> {
        let outcome = {
            let mut inner = self.inner();
            let state = std::mem::replace(&mut inner.state, State::Idle);
            match state.after(event) {
                Ok(next) => {
                    inner.state = next;
                    Ok(())
                }
                Err((kept, refusal)) => {
                    inner.state = kept;
                    Err(refusal)
                }
            }
        };
        if outcome.is_ok() {
            let status = self.state().to_string();
            let _ = sd_notify::notify(&[sd_notify::NotifyState::Status(&status)]);
            self.herald.say(&Notice::Daemon);
        }
        outcome
    }

    /// Ends whatever runs and leaves the source off and verified.
    ///
    /// # Errors
    /// What could not be made safe.
    pub(crate) async fn shut_down(&self, why: &str) -> Result<(), String> {
        if let Some(live) = self.active() {
            live.stop(why);
            live.ended().await;
        }
        if self.rig_fault().is_some() {
            self.find_rig_again().await?;
        }
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

/// A logbook's refusal as a fault on the bus.
pub(crate) fn disk_fault(error: &LogbookError) -> Fault {
    if error.is_disk() {
        Fault::DiskRefused(chain(error))
    } else {
        Fault::Failed(chain(error))
    }
}
