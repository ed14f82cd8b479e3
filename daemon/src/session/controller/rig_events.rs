//! Events of the rig: reported, and written to the record of the running session.

use rig::Clock;
use tokio::sync::mpsc;

use crate::alarms::Change;
use crate::events::event::Event;
use crate::events::kind::EventKind;
use crate::recording::recorder_message::RecorderMessage;
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;

/// The session concerned, and the queue to its record.
#[derive(Clone, Copy)]
pub(crate) struct ActiveSession<'a> {
    pub status: &'a SessionStatus,
    pub record: &'a mpsc::Sender<RecorderMessage>,
}

impl Controller {
    /// Reports an event, and waits until it is queued for the record of its session.
    pub(crate) async fn report(
        &self,
        session: Option<ActiveSession<'_>>,
        kind: EventKind,
        text: &str,
    ) {
        let at = self.runtime().clock.wall();
        let id = session.map(|session| session.status.facts.id.as_str());
        let event = Event::new(at, kind, text, id);
        self.events.report(event.clone());
        if let Some(session) = session {
            // fails only if the record has failed, which ends the session and is reported by it
            let _ = session.record.send(RecorderMessage::Event(event)).await;
        }
    }

    /// Reports changes of alarms. Those of rules are also queued for the record of the running session, if its queue is
    /// not full.
    pub(crate) fn report_changes(&self, changes: Vec<Change>) {
        let at = self.runtime().clock.wall();
        for change in changes {
            let session = self.active().filter(|_| change.of_session);
            let recorded = session.filter(|status| {
                let id = Some(status.facts.id.as_str());
                let event = Event::new(at, change.kind, &change.text, id);
                status.record_event(event)
            });
            let id = recorded.as_ref().map(|status| status.facts.id.as_str());
            self.events
                .report(Event::new(at, change.kind, &change.text, id));
        }
    }
}
