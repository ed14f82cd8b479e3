//! Reloads the configuration. An invalid one changes nothing.

use std::sync::Arc;

use crate::events::kind::EventKind;
use dbus::Fault;

use crate::acquisition::task::FrameSource;
use crate::events::event::BusEvent;
use crate::instruments::assembly::{AnyRig, AssemblyError, OnClosedRelays, SourceState, assemble};
use crate::instruments::identities::ExpectedIdentities;
use crate::instruments::rig_plan::RigPlan;
use crate::locked::locked;
use crate::preparation::{FramesFrom, Prepared, prepare};
use crate::session::controller::{Controller, Runtime};
use crate::session::state::Trigger;
use config::Config;
use survey::error_chain as chain;

impl Controller {
    /// Reloads the configuration; during a session, it is applied when the session ends. If the configuration is
    /// refused, an earlier one that waits for the end of the session is discarded too, because the file has changed
    /// since.
    ///
    /// # Errors
    /// The file has problems, a change needs a restart, or the present rig cannot be switched off. The configuration in
    /// force is kept.
    pub(crate) async fn reload(self: &Arc<Self>) -> Result<String, Fault> {
        let outcome = self.reload_now().await.map_err(|fault| {
            let discarded = |text| match self.inner().waiting.take() {
                Some(_) => format!(
                    "{text}\nthe configuration waiting for the end of the session is discarded"
                ),
                None => text,
            };
            match fault {
                Fault::Configuration(text) => Fault::Configuration(discarded(text)),
                Fault::Unsupported(text) => Fault::Unsupported(discarded(text)),
                other => other,
            }
        });
        match &outcome {
            Ok(text) => self.report(None, EventKind::Reloaded, text).await,
            Err(fault) => {
                let text = format!("the configuration in force stays: {}", fault.text());
                self.report(None, EventKind::ReloadRefused, &text).await;
            }
        }
        outcome
    }

    async fn reload_now(self: &Arc<Self>) -> Result<String, Fault> {
        let path = self.runtime().config.clone();
        let prepared = tokio::task::spawn_blocking(move || prepare(&path))
            .await
            .map_err(|_| Fault::Failed("the configuration could not be read".into()))?
            .map_err(|problems| {
                let lines: Vec<String> = problems.iter().map(ToString::to_string).collect();
                Fault::Configuration(lines.join("\n"))
            })?;
        restart_needed(&self.runtime().setup.config, &prepared.setup.config)?;
        self.take_or_wait(prepared).await
    }

    /// Applies a configuration: immediately, or at the end of the session if one is running.
    pub(super) async fn take_or_wait(
        self: &Arc<Self>,
        prepared: Prepared,
    ) -> Result<String, Fault> {
        let _no_start = self.without_reload().await;
        if let Some(status) = self.active() {
            self.inner().waiting = Some(Box::new(prepared));
            return Ok(format!(
                "{} is valid; it takes effect when session {} ends",
                self.runtime().config.display(),
                status.facts.id
            ));
        }
        self.take(prepared).await
    }

    /// Applies a waiting configuration after the end of a session.
    pub(super) fn take_waiting(self: &Arc<Self>) {
        let controller = Arc::clone(self);
        tokio::spawn(async move {
            let _no_start = controller.without_reload().await;
            if controller.active().is_some() {
                // another session has begun: the configuration waits for its end
                return;
            }
            let Some(prepared) = controller.inner().waiting.take() else {
                return;
            };
            match controller.take(*prepared).await {
                Ok(text) => controller.report(None, EventKind::Reloaded, &text).await,
                Err(fault) => {
                    controller
                        .report(None, EventKind::ReloadRefused, &fault.text())
                        .await
                }
            }
        });
    }

    async fn take(self: &Arc<Self>, prepared: Prepared) -> Result<String, Fault> {
        let mut source = self.source.lock().await;
        let old = self.runtime();
        let file = prepared.source.file().display().to_string();
        let same_rig = same_rig(&old.setup.config, &prepared.setup.config);
        let kept = match &prepared.frames {
            FramesFrom::Rig(plan) if same_rig && same_simulation(&old, plan) => {
                old.simulated_rig.clone()
            }
            _ => None,
        };
        let simulated_rig = match kept {
            Some(kept) => Some(kept),
            None => prepared.simulated_rig().map_err(Fault::Configuration)?,
        };
        let (runtime, frames) = Runtime::of(prepared, simulated_rig, old.clock);
        let mut locks = locked(&self.locks).clone();
        if let Some(plan) = runtime.plan.clone() {
            let of_rig = tokio::task::spawn_blocking(move || locks.of_rig(&plan.instruments));
            locks = of_rig
                .await
                .map_err(|_| Fault::Failed("the instruments could not be locked".into()))?
                .map_err(|error| Fault::InstrumentFault(error.to_string()))?;
        }
        if let FrameSource::Rig { rig, plan } = &mut *source {
            self.give_up_rig(rig, plan).await?;
        }
        // replaced only now: until here the configuration in force may be kept, and needs its locks
        self.hold(locks);
        self.transcript.keep(runtime.setup.transcripts);
        let outcome = match frames {
            FramesFrom::Recording {
                recording,
                baseline,
            } => {
                *source = FrameSource::Recording(recording);
                self.inner().source_state = SourceState::Off;
                self.inner().baseline = Some(Arc::new(*baseline));
                Ok(ExpectedIdentities::default())
            }
            FramesFrom::Rig(plan) => {
                if old.plan.is_none() {
                    // the present baseline is the recording's
                    let last = self.last_baseline().await;
                    self.inner().baseline = last;
                }
                self.inner().rig_is_new |= !same_rig;
                let expected = self.expected();
                let expected = expected.filter(|expected| !expected.instruments.is_empty());
                let assembled = assemble(
                    &plan,
                    &runtime.simulated_rig,
                    &self.transcript,
                    OnClosedRelays::Open,
                    expected.as_ref(),
                )
                .await;
                let (rig, outcome) = match assembled {
                    Ok(assembled) => {
                        self.inner().source_state = SourceState::Off;
                        (Some(assembled.rig), Ok(assembled.identities))
                    }
                    Err(error) => {
                        if let AssemblyError::Unsafe(cleanup) = &error {
                            self.report_safety(None, Some(cleanup)).await;
                        }
                        self.inner().source_state = error.source_state();
                        (None, Err(chain(&error)))
                    }
                };
                *source = FrameSource::Rig { rig, plan };
                outcome
            }
        };
        let ended = self.alarms.take_rules(&runtime.setup.config).await;
        self.report_changes(ended);
        let same_rating = old.setup.config.relay_wear == runtime.setup.config.relay_wear;
        *locked(&self.runtime) = Arc::new(runtime);
        if !same_rig || !same_rating {
            self.observed.forget_relays();
        }
        // the remarks depend on the model
        self.remarked.lock().await.clear();
        drop(source);
        let text = match outcome {
            Ok(identities) => {
                {
                    let mut inner = self.inner();
                    inner.identities = identities;
                    inner.rig_is_new = false;
                    inner.others = None;
                    inner.rig_fault = None;
                    inner.recovery = None;
                    inner.closed = None;
                }
                self.keep_identities().await;
                let _ = self.change_state(Trigger::Recovered);
                format!("reloaded {file}")
            }
            Err(text) => {
                self.rig_lost(&text);
                format!("reloaded {file}, but its rig cannot be reached: {text}")
            }
        };
        self.events.publish(&BusEvent::ObjectsChanged);
        self.events.publish(&BusEvent::Daemon);
        Ok(text)
    }

    /// Makes the present rig safe before it is replaced. A lost rig that may be live is reconnected for that: the
    /// instruments of the new configuration do not show whether the source of the old one is off.
    ///
    /// # Errors
    /// The source is not verified off, or relays are not verified open.
    async fn give_up_rig(
        self: &Arc<Self>,
        rig: &mut Option<AnyRig>,
        plan: &RigPlan,
    ) -> Result<(), Fault> {
        let (source, relays) = self.unknown_parts();
        match rig.take() {
            Some(present) => {
                if let Err(error) = rig::safe_off(&present, &plan.plan.wiring).await {
                    let text = error.to_string();
                    self.report_safety(None, Some(&error)).await;
                    self.rig_lost(&text);
                    return Err(Fault::InstrumentFault(text));
                }
            }
            None if source || relays => {
                if let Err(text) = self.retry_assembly(None, plan).await {
                    return match self.unknown_parts() {
                        // the source is off and the relays are open: the lost instruments are not used again
                        (false, false) => Ok(()),
                        _ => Err(Fault::InstrumentFault(format!(
                            "the present rig cannot be switched off: {text}; connect it again, or switch it off by hand \
                             and restart tactusd"
                        ))),
                    };
                }
            }
            None => return Ok(()),
        }
        // what the assembly above found off and open is reported already
        let (source, relays) = {
            let mut inner = self.inner();
            let before = std::mem::replace(&mut inner.source_state, SourceState::Off);
            let relays = std::mem::take(&mut inner.relays_unknown);
            (before == SourceState::Unknown, relays)
        };
        self.report_safe_again(None, source, relays).await;
        Ok(())
    }

    /// Whether the source may be on, and whether relays may be closed.
    fn unknown_parts(&self) -> (bool, bool) {
        let inner = self.inner();
        let source = inner.source_state == SourceState::Unknown;
        (source, inner.relays_unknown)
    }
}

/// Refuses changes that need a restart: the daemon's connections, and the record's directory.
fn restart_needed(old: &Config, new: &Config) -> Result<(), Fault> {
    let what = match () {
        () if old.bus != new.bus => "[bus]",
        () if old.record.directory != new.record.directory => "record.directory",
        () => return Ok(()),
    };
    Err(Fault::Unsupported(format!(
        "{what} has changed, which needs a restart of tactusd; nothing was reloaded"
    )))
}

/// Whether the instruments are unchanged.
fn same_rig(old: &Config, new: &Config) -> bool {
    (&old.rig, &old.source, &old.switch, &old.voltmeter)
        == (&new.rig, &new.source, &new.switch, &new.voltmeter)
        && old.wiring == new.wiring
}

/// Whether profile and scene are unchanged; if so, the simulated sheet is kept.
fn same_simulation(old: &Runtime, plan: &RigPlan) -> bool {
    old.plan
        .as_deref()
        .is_some_and(|old| old.simulation == plan.simulation)
}
