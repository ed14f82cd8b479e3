//! Recovery of a session whose rig was lost: suspends it, reconnects with increasing intervals, checks identities, sets
//! up and verifies the rig, and resumes. Every step is an event of the record and a signal on the bus.

use std::sync::Arc;
use std::time::Duration;

use crate::events::kind::EventKind;
use rig::{AcquireError, CleanupError, Clock, RigError};
use tokio::time::Instant;

use crate::acquisition::failed_frame;
use crate::acquisition::task::FrameSource;
use crate::events::event::BusEvent;
use crate::instruments::assembly::{
    Assembled, AssemblyError, OnClosedRelays, SourceState, assemble, open_relays,
};
use crate::instruments::identities::ACCEPT_HINT;
use crate::instruments::rig_plan::RigPlan;
use crate::session::controller::rig_events::ActiveSession;
use crate::session::controller::{Controller, Recovery};
use crate::session::state::Trigger;
use survey::error_chain as chain;

/// First and longest interval between attempts to reconnect.
pub(super) const RECONNECT_INTERVALS: (Duration, Duration) =
    (Duration::from_millis(200), Duration::from_secs(10));

/// Number of consecutive failed frames, with the rig reconnected in between, after which the session ends.
pub(super) const MOST_FAILED: u32 = 3;

/// Whether reconnecting can help: not if the rig cannot do what was requested.
pub(super) fn may_pass(error: &AcquireError) -> bool {
    match error.cause() {
        None => false,
        Some(cause) => !matches!(
            cause,
            RigError::CurrentOutOfRange { .. }
                | RigError::VoltageOutOfRange { .. }
                | RigError::Unable { .. }
        ),
    }
}

impl Controller {
    /// Stores and reports the state of the rig after an attempt to make it safe; `cleanup` is `None` if everything was
    /// verified.
    pub(super) async fn report_safety(
        &self,
        session: Option<ActiveSession<'_>>,
        cleanup: Option<&CleanupError>,
    ) {
        let source = cleanup.is_some_and(|cleanup| cleanup.source.is_some());
        let relays = cleanup.is_some_and(|cleanup| cleanup.relays.is_some());
        {
            let mut inner = self.inner();
            inner.source_state = match source {
                true => SourceState::Unknown,
                false => SourceState::Off,
            };
            inner.relays_unknown = relays;
        }
        match (source, relays) {
            (true, true) => {
                let text = "neither the source nor the switch can be made safe: the sheet may be live; switch the source \
                            off by hand";
                self.report(session, EventKind::Alarm, text).await;
            }
            (true, false) => {
                let text = "source state unknown; the injecting relays are open and verified";
                self.report(session, EventKind::SourceUnknown, text).await;
            }
            _ => {}
        }
    }

    /// Reports the parts of the rig that are safe again after their state was unknown.
    pub(super) async fn report_safe_again(
        &self,
        session: Option<ActiveSession<'_>>,
        source: bool,
        relays: bool,
    ) {
        if source {
            let text = "the source answers again: off, verified";
            self.report(session, EventKind::SourceOff, text).await;
        }
        if relays {
            let text = "the switch answers again: the relays are open, verified";
            self.report(session, EventKind::RelaysOpen, text).await;
        }
    }

    /// Suspends the session until the rig is reconnected; `false` if the session was stopped before.
    pub(super) async fn recover(
        self: &Arc<Self>,
        session: ActiveSession<'_>,
        source: &mut FrameSource,
        error: &AcquireError,
    ) -> bool {
        let FrameSource::Rig { rig, plan } = source else {
            return false;
        };
        // its links may be unsynchronised, and its settings may be lost: the rig is reassembled
        *rig = None;
        let text = failed_frame::describe(error);
        {
            let mut inner = self.inner();
            inner.rig_fault = Some(text.clone());
            inner.recovery = Some(Recovery {
                what: text.clone(),
                tries: 0,
                next: Some(Instant::now() + RECONNECT_INTERVALS.0),
                since: self.runtime().clock.wall(),
                person: false,
            });
        }
        session.status.set_last_error(&text);
        session.status.set_suspended(true);
        let _ = self.change_state(Trigger::Suspend);
        self.events.publish(&BusEvent::Instruments);
        let suspended = "the session is suspended; the daemon tries to reconnect the rig";
        self.report(Some(session), EventKind::Suspended, suspended)
            .await;

        let mut stop = session.status.stop_request();
        let mut pause = RECONNECT_INTERVALS.0;
        let assembled = loop {
            tokio::select! {
                () = stop.requested() => {
                    self.inner().recovery = None;
                    self.events.publish(&BusEvent::Daemon);
                    return false;
                }
                () = self.agreed.notified() => {}
                () = tokio::time::sleep(pause) => {}
            }
            match self.retry_assembly(Some(session), plan).await {
                Ok(assembled) => break assembled,
                Err(text) => {
                    pause = (pause * 2).min(RECONNECT_INTERVALS.1);
                    self.next_try(Some(session), &text, pause).await;
                }
            }
        };
        let names: Vec<String> = assembled
            .identities
            .instruments
            .iter()
            .map(|found| format!("{} {}", found.role, found.identity))
            .collect();
        *rig = Some(assembled.rig);
        let back = format!("the same instruments are back: {}", names.join("; "));
        self.report(Some(session), EventKind::Reconnected, &back)
            .await;
        let applied = "the source is off, verified; the settings were applied again and read back";
        self.report(Some(session), EventKind::SettingsVerified, applied)
            .await;
        {
            let mut inner = self.inner();
            inner.rig_fault = None;
            inner.recovery = None;
        }
        session.status.set_last_error("");
        session.status.set_suspended(false);
        let _ = self.change_state(Trigger::Resume);
        self.events.publish(&BusEvent::Instruments);
        self.report(Some(session), EventKind::Resumed, "the session continues")
            .await;
        true
    }

    /// Reports a failed attempt (the first, second, fourth, eighth ... as an event), and the time of the next one.
    pub(super) async fn next_try(
        &self,
        session: Option<ActiveSession<'_>>,
        text: &str,
        pause: Duration,
    ) {
        let (tries, person) = {
            let mut inner = self.inner();
            let person = inner.others.is_some();
            let Some(recovery) = &mut inner.recovery else {
                return;
            };
            recovery.tries += 1;
            recovery.next = Some(Instant::now() + pause);
            recovery.person = person;
            text.clone_into(&mut recovery.what);
            (recovery.tries, person)
        };
        self.events.publish(&BusEvent::Daemon);
        if tries.is_power_of_two() {
            let next = match person {
                true => "waiting for `tactus instruments accept`".to_owned(),
                false => format!("next in {:.1} s", pause.as_secs_f64()),
            };
            let text = format!("attempt {tries} failed, {next}: {text}");
            self.report(session, EventKind::Reconnecting, &text).await;
        } else {
            tracing::debug!(tries, "{text}");
        }
    }

    /// One attempt to reconnect the expected rig. Parts that respond are made safe, even if others are missing.
    pub(super) async fn retry_assembly(
        &self,
        session: Option<ActiveSession<'_>>,
        plan: &RigPlan,
    ) -> Result<Assembled, String> {
        let (simulated_rig, expected) = (self.runtime().simulated_rig.clone(), self.expected());
        if let Some(recovery) = &mut self.inner().recovery {
            recovery.next = None;
        }
        let outcome = assemble(
            plan,
            &simulated_rig,
            &self.transcript,
            OnClosedRelays::Open,
            expected.as_ref(),
        )
        .await;
        let now = match &outcome {
            Ok(_) => SourceState::Off,
            Err(error) => error.source_state(),
        };
        let (before, opened) = {
            let mut inner = self.inner();
            let before = inner.source_state;
            // the last known state of a source that is not reached is kept
            if now != SourceState::NeverReached {
                inner.source_state = now;
            }
            let error = outcome.as_ref().err();
            inner.relays_unknown |= error.is_some_and(AssemblyError::leaves_relays_unknown);
            // an assembled rig has its relays verified open
            let opened = outcome.is_ok() && std::mem::take(&mut inner.relays_unknown);
            (before, opened)
        };
        let source = (before, now) == (SourceState::Unknown, SourceState::Off);
        self.report_safe_again(session, source, opened).await;
        match outcome {
            Ok(assembled) => {
                {
                    let mut inner = self.inner();
                    inner.others = None;
                    inner.identities.modules = assembled.identities.modules.clone();
                }
                self.expect_if_new(&assembled.identities).await;
                Ok(assembled)
            }
            Err(AssemblyError::Others { text, found, .. }) => {
                let text = format!("{text}; {ACCEPT_HINT}");
                let new = self.inner().others.replace(*found.clone()) != Some(*found);
                if new {
                    self.report(session, EventKind::OthersFound, &text).await;
                }
                Err(text)
            }
            Err(error) => {
                self.inner().others = None;
                let unknown = self.inner().relays_unknown;
                if unknown && open_relays(plan, &simulated_rig).await.is_ok() {
                    self.inner().relays_unknown = false;
                    self.report_safe_again(session, false, true).await;
                }
                Err(chain(&error))
            }
        }
    }
}
