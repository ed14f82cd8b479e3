//! Records the end of a session in an end mark, before the end is reported; see [`crate::recording::end_marks`].

use std::sync::Arc;

use logbook::SessionKind;
use rig::Clock;

use crate::events::event::Event;
use crate::events::kind::EventKind;
use crate::recording::end_marks::{EndMarks, Marked};
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;
use survey::nanoseconds;

impl Controller {
    /// Marks the session as soon as its end is requested, while its last frame is still being measured: the daemon may
    /// be killed before the file is closed.
    pub(super) async fn mark_when_requested_to_end(self: Arc<Self>, status: Arc<SessionStatus>) {
        let mut stop = status.stop_request();
        tokio::select! {
            () = stop.requested() => {}
            _ = status.ended() => return,
        }
        if !status.is_left_open() {
            self.mark_end(&status, &status.stop_reason()).await;
        }
    }

    /// Marks the session as ended, once; only if the next daemon would otherwise resume it.
    pub(super) async fn mark_end(&self, status: &SessionStatus, reason: &str) {
        if status.facts.kind != SessionKind::Measurement || self.is_recording() {
            return;
        }
        status
            .marked
            .get_or_init(|| async {
                let at = nanoseconds(self.runtime().clock.wall());
                let (session, reason) = (status.facts.id.clone(), reason.to_owned());
                let marked = self.with_end_marks(move |ends| ends.mark(&session, at, &reason));
                marked.await.unwrap_or_else(|| Marked {
                    failures: vec!["the thread that writes it cannot be started".to_owned()],
                    ..Marked::default()
                })
            })
            .await;
    }

    /// After closing the record: removes the mark if the file records the end, and reports it otherwise.
    pub(super) async fn settle_end(&self, status: &SessionStatus, reason: &str) {
        if status.is_left_open() {
            return;
        }
        if !status.is_closed() {
            // an end may have been requested while the session was being left to the next daemon
            self.mark_end(status, reason).await;
        }
        let Some(marked) = status.marked.get() else {
            return;
        };
        if status.is_closed() {
            let session = status.facts.id.clone();
            self.with_end_marks(move |ends| ends.clear(&session)).await;
            return;
        }
        let kind = match marked.is_kept() {
            true => EventKind::NotClosed,
            false => EventKind::Alarm,
        };
        let text = marked.text(&status.facts.id);
        let at = self.runtime().clock.wall();
        self.events.report(Event::new(at, kind, &text, None));
    }

    /// Runs `act` on a separate thread: the end of a session must not wait for a client's reading request.
    pub(super) async fn with_end_marks<T: Send + 'static>(
        &self,
        act: impl FnOnce(&EndMarks) -> T + Send + 'static,
    ) -> Option<T> {
        let (say, done) = tokio::sync::oneshot::channel();
        let ends = Arc::clone(&self.ends);
        let thread = std::thread::Builder::new().name("ends".to_owned());
        thread
            .spawn(move || {
                let _ = say.send(act(&ends));
            })
            .ok()?;
        done.await.ok()
    }
}
