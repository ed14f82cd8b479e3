//! An interrupted session that cannot be resumed yet, because its rig is missing or its file cannot be opened. It is
//! published as a suspended session, so that a client can stop it.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use logbook::SessionKind;

use crate::events::event::BusEvent;
use crate::recording::session_status::{Facts, SessionEnd, SessionStatus};
use crate::session::controller::Controller;
use crate::session::controller::resume::NotResumed;

/// First time between two attempts to resume; it doubles after each attempt.
const RETRY: Duration = Duration::from_secs(1);
/// Maximum time between two attempts.
const RETRY_AT_MOST: Duration = Duration::from_secs(10);
/// How long a stop waits for the file to be closed; the separate end mark is durable by then.
const TO_CLOSE: Duration = Duration::from_millis(500);

impl Controller {
    /// Publishes the session, and retries until it is resumed, cannot be resumed any more, or is stopped.
    pub(super) fn wait_to_go_on(self: &Arc<Self>, path: PathBuf, id: String, why: &str) {
        let facts = Facts {
            id,
            kind: SessionKind::Measurement,
            simulated: self.runtime().simulated,
            baseline_id: String::new(),
            method: String::new(),
            every: Duration::ZERO,
        };
        let counters = Arc::clone(&self.observed.counters);
        let status = Arc::new(SessionStatus::new(facts, path, false, counters));
        status.set_suspended(true);
        status.set_last_error(why);
        self.inner().interrupted = Some(Arc::clone(&status));
        self.events
            .publish(&BusEvent::SessionAdded(status.facts.id.clone()));
        self.events.publish(&BusEvent::Daemon);
        tokio::spawn(Arc::clone(self).announce_frames(Arc::clone(&status)));
        tokio::spawn(Arc::clone(self).mark_when_requested_to_end(Arc::clone(&status)));
        tokio::spawn(Arc::clone(self).try_to_go_on(status));
    }

    async fn try_to_go_on(self: Arc<Self>, status: Arc<SessionStatus>) {
        let mut stop = status.stop_request();
        let mut pause = RETRY;
        loop {
            tokio::select! {
                biased;
                () = stop.requested() => return self.stop_waiting(&status).await,
                () = tokio::time::sleep(pause) => {}
            }
            if self.rig_fault().is_some() {
                continue;
            }
            match self.resume(status.path()).await {
                Ok(()) => return,
                Err(NotResumed::Later(why)) => {
                    status.set_last_error(&why);
                    pause = (pause * 2).min(RETRY_AT_MOST);
                }
                // another session has begun meanwhile, or the daemon is being stopped
                Err(_) if stop.is_requested() => return self.stop_waiting(&status).await,
                Err(not_resumed) => {
                    self.report_not_resumed(&status.path(), not_resumed).await;
                    return self.end_waiting(&status, "it could not be resumed".to_owned(), true);
                }
            }
        }
    }

    /// Writes the end mark first, so that a locked file or a full disk does not delay the stop.
    async fn stop_waiting(&self, status: &Arc<SessionStatus>) {
        let reason = status.stop_reason();
        let mut faulted = false;
        if !status.is_left_open() {
            self.mark_end(status, &reason).await;
            let path = status.path();
            let closing = self.close_interrupted(&path, &reason);
            if let Ok(true) = tokio::time::timeout(TO_CLOSE, closing).await {
                status.set_closed();
            }
            self.settle_end(status, &reason).await;
            faulted = !status.end_is_recorded();
        }
        self.end_waiting(status, reason, faulted);
    }

    fn end_waiting(&self, status: &Arc<SessionStatus>, reason: String, faulted: bool) {
        {
            let mut inner = self.inner();
            let shown = inner.interrupted.take();
            inner.interrupted = shown.filter(|shown| !Arc::ptr_eq(shown, status));
            self.remember(&mut inner, status);
        }
        status.end(SessionEnd { reason, faulted });
        self.events.publish(&BusEvent::Daemon);
    }

    /// Called when a session begins. If it is the waiting one, it replaces the waiting object on the bus; if it is
    /// another, the waiting one ends.
    pub(super) fn hand_over(self: &Arc<Self>, status: &Arc<SessionStatus>) {
        let Some(waited) = self.inner().interrupted.take() else {
            return;
        };
        if waited.facts.id != status.facts.id {
            return waited.stop("interrupted, and a later session was begun");
        }
        self.events
            .publish(&BusEvent::SessionRemoved(waited.facts.id.clone()));
        let status = Arc::clone(status);
        tokio::spawn(async move {
            let mut stop = waited.stop_request();
            tokio::select! {
                () = stop.requested() => match waited.is_left_open() {
                    true => status.end_resumable(&waited.stop_reason()),
                    false => status.end_for_good(&waited.stop_reason()),
                },
                _ = status.ended() => {}
            }
            waited.end(status.ended().await);
        });
    }
}
