//! Events of the rig: reported, and written to the record of the session under way.

use chrono::{DateTime, Utc};
use rig::Clock;
use tokio::sync::mpsc;

use crate::events::event::Event;
use crate::events::kind::EventKind;
use crate::recording::order::Order;
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;

/// The session that something happens to, and the way to its record.
#[derive(Clone, Copy)]
pub(crate) struct ActiveSession<'a> {
    pub status: &'a SessionStatus,
    pub record: &'a mpsc::Sender<Order>,
}

impl Controller {
    /// Reports an event. The record is waited for: what is reported of a session is on its way to the disk.
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
            // a record that has failed has ended its session, which says so
            let _ = session.record.send(Order::Event(event)).await;
        }
    }

    /// Reports an event that the caller writes to the record, where it belongs there.
    pub(crate) fn report_unrecorded(
        &self,
        at: DateTime<Utc>,
        kind: EventKind,
        text: &str,
        session: Option<&str>,
    ) {
        self.events.report(Event::new(at, kind, text, session));
    }
}
