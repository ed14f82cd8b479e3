//! Reconnects a lost rig while no session needs it, and the operator's commands on the rig: open the relays, accept
//! other instruments.

use std::sync::Arc;

use crate::events::kind::EventKind;
use dbus::Fault;
use rig::Clock;

use crate::acquisition::task::FrameSource;
use crate::events::event::BusEvent;
use crate::instruments::assembly::{AssemblyError, OnClosedRelays, SourceState, assemble};
use crate::instruments::identities::{ACCEPT_HINT, ExpectedIdentities};
use crate::session::controller::recovery::RECONNECT_INTERVALS;
use crate::session::controller::{Controller, Recovery};
use crate::session::state::Trigger;

impl Controller {
    /// Starts a task that reconnects the rig after a fault, unless one is running.
    pub(super) fn look_for_rig(self: &Arc<Self>) {
        let since = self.runtime().clock.wall();
        let mut inner = self.inner();
        let what = inner.rig_fault.clone().unwrap_or_default();
        let looks = std::mem::replace(&mut inner.looking, true);
        match &mut inner.recovery {
            Some(recovery) if looks => recovery.what = what,
            recovery => {
                *recovery = Some(Recovery {
                    what,
                    tries: 0,
                    next: None,
                    since,
                    person: false,
                });
            }
        }
        if !looks {
            tokio::spawn(Arc::clone(self).retry_until_found());
        }
    }

    /// Whether the rig has no fault any more; if so, notes that the reconnecting task ends.
    fn is_found(&self) -> bool {
        let mut inner = self.inner();
        inner.looking = inner.rig_fault.is_some();
        !inner.looking
    }

    /// Retries until every instrument is back and verified off, or a session has reconnected it.
    async fn retry_until_found(self: Arc<Self>) {
        let mut pause = RECONNECT_INTERVALS.0;
        loop {
            tokio::select! {
                () = tokio::time::sleep(pause) => {}
                () = self.agreed.notified() => {}
            }
            if self.is_found() {
                return;
            }
            if self.state().is_busy() {
                continue;
            }
            match self.reassemble_rig().await {
                Ok(()) => {
                    let _ = self.change_state(Trigger::Recovered);
                    if self.is_found() {
                        return;
                    }
                }
                Err(text) => {
                    pause = (pause * 2).min(RECONNECT_INTERVALS.1);
                    self.next_try(None, &text, pause).await;
                }
            }
        }
    }

    /// Stores the expected instruments for the next daemon.
    pub(crate) async fn keep_identities(&self) {
        let (identities, runtime) = (self.identities(), self.runtime());
        let kept =
            tokio::task::spawn_blocking(move || identities.keep(&runtime.setup.record_directory))
                .await;
        if let Ok(Err(error)) = kept {
            self.report(None, EventKind::Fault, &survey::error_chain(&error))
                .await;
        }
    }

    /// The instruments to expect; `None` while those of a new configuration have not been reached.
    pub(super) fn expected(&self) -> Option<ExpectedIdentities> {
        let inner = self.inner();
        (!inner.rig_is_new).then(|| inner.identities.clone())
    }

    /// Expects these instruments from now on if they are the first ones of a new configuration.
    pub(super) async fn expect_if_new(&self, found: &ExpectedIdentities) {
        {
            let mut inner = self.inner();
            if !std::mem::take(&mut inner.rig_is_new) {
                return;
            }
            inner.identities = found.clone();
        }
        self.keep_identities().await;
        self.events.publish(&BusEvent::ObjectsChanged);
    }

    /// Unexpected instruments were found at the start: refuses measuring until the operator accepts them, or the
    /// expected ones are back.
    pub(crate) async fn wait_for_the_expected(
        self: &Arc<Self>,
        identities: ExpectedIdentities,
        found: &str,
        source_off: bool,
    ) {
        let text = format!("{found}; {ACCEPT_HINT}");
        {
            let mut inner = self.inner();
            inner.identities = identities;
            inner.source_state = match source_off {
                true => SourceState::Off,
                false => SourceState::Unknown,
            };
        }
        self.rig_lost(&text);
    }

    /// Sets the fault of a rig that cannot be used and that no session reconnects, and starts to reconnect it.
    pub(super) fn rig_lost(self: &Arc<Self>, text: &str) {
        self.inner().rig_fault = Some(text.to_owned());
        let _ = self.change_state(Trigger::Fault(text.to_owned()));
        self.events.publish(&BusEvent::Instruments);
        self.look_for_rig();
    }

    /// Reassembles the rig; afterwards its source is verified off.
    pub(super) async fn reassemble_rig(&self) -> Result<(), String> {
        let mut source = self.source.lock().await;
        if let Some(closed) = self.inner().closed.clone() {
            return Err(closed);
        }
        let FrameSource::Rig { rig, plan } = &mut *source else {
            return Ok(());
        };
        if rig.is_none() {
            let assembled = self.retry_assembly(None, plan).await?;
            *rig = Some(assembled.rig);
            let text = "the rig is back; its source is off, its settings applied, both verified";
            self.report(None, EventKind::Reconnected, text).await;
        }
        {
            let mut inner = self.inner();
            inner.rig_fault = None;
            inner.recovery = None;
        }
        self.events.publish(&BusEvent::Instruments);
        Ok(())
    }

    /// Handles a failed [`Controller::open_all`]: the rig must be reconnected, unless measuring is refused anyway until
    /// the relays are open.
    fn not_opened(self: &Arc<Self>, error: &AssemblyError) -> Fault {
        let text = survey::error_chain(error);
        let refused = {
            let mut inner = self.inner();
            let before = inner.source_state;
            inner.source_state = match error.source_state() {
                // the source had been reached before, and may be on
                SourceState::NeverReached if before != SourceState::NeverReached => {
                    SourceState::Unknown
                }
                now => now,
            };
            // relays that were found closed at the start still are
            inner.relays_unknown |= error.leaves_relays_unknown() || inner.closed.is_some();
            inner.closed.is_some()
        };
        match refused {
            true => self.events.publish(&BusEvent::Instruments),
            false => self.rig_lost(&text),
        }
        Fault::InstrumentFault(text)
    }

    /// Operator's command: switches the source off and opens every relay, both verified. Lifts the refusal to measure
    /// after relays were found closed at the start.
    ///
    /// # Errors
    /// A session is running, or a part of the rig could not be made safe.
    pub(crate) async fn open_all(self: &Arc<Self>) -> Result<String, Fault> {
        if self.state().is_busy() {
            return Err(Fault::SessionActive(
                "a session is running and uses the relays; stop it first".into(),
            ));
        }
        let mut source = self.source.lock().await;
        let FrameSource::Rig { rig, plan } = &mut *source else {
            return Err(Fault::Unsupported("a recording has no relays".into()));
        };
        // the rig is reassembled: its settings are applied only now that the state of the relays is known
        *rig = None;
        let (simulated_rig, expected) = (self.runtime().simulated_rig.clone(), self.expected());
        let assembled = assemble(
            plan,
            &simulated_rig,
            &self.transcript,
            OnClosedRelays::Open,
            expected.as_ref(),
        )
        .await;
        let assembled = match assembled {
            Ok(assembled) => assembled,
            Err(error) => {
                drop(source);
                return Err(self.not_opened(&error));
            }
        };
        *rig = Some(assembled.rig);
        drop(source);
        self.expect_if_new(&assembled.identities).await;
        let was = {
            let mut inner = self.inner();
            inner.rig_fault = None;
            inner.recovery = None;
            inner.source_state = SourceState::Off;
            inner.relays_unknown = false;
            inner.closed.take()
        };
        let _ = self.change_state(Trigger::Recovered);
        self.events.publish(&BusEvent::Instruments);
        let text = match was {
            Some(was) => format!("the source is off and every relay open, verified; before: {was}"),
            None => "the source is off and every relay open, verified".to_owned(),
        };
        self.report(None, EventKind::Opened, &text).await;
        Ok(text)
    }

    /// Operator's command: accepts the instruments found in place of the expected ones.
    ///
    /// # Errors
    /// There is nothing to accept.
    pub(crate) async fn accept(&self) -> Result<String, Fault> {
        let agreed = {
            let mut inner = self.inner();
            let others = inner.others.take();
            others.map(|others| {
                let text = inner.identities.differs(&others).unwrap_or_default();
                inner.identities = others;
                text
            })
        };
        let Some(text) = agreed else {
            return Err(Fault::Unsupported(
                "no other instruments wait to be accepted; `tactus instruments` shows those that are known".into(),
            ));
        };
        self.observed.forget_relays();
        self.keep_identities().await;
        let text = format!("a person accepted other instruments: {text}");
        self.report(None, EventKind::Accepted, &text).await;
        self.events.publish(&BusEvent::Instruments);
        self.agreed.notify_one();
        Ok(text)
    }
}
