//! What happens to the rig, told to everybody: the log, the bus, and the record of the session under way, or where there
//! is none the daemon's own chronicle.

use chrono::{DateTime, Utc};
use rig::Clock;
use tokio::sync::mpsc;

use crate::events::broadcast::BusEvent;
use crate::recording::order::Order;
use crate::recording::session_status::SessionStatus;
use crate::session::controller::Controller;

/// One thing that happened.
#[derive(Debug, Clone)]
pub(crate) struct Happening {
    pub at: DateTime<Utc>,
    /// A word for programs, such as `frame-failed`.
    pub kind: &'static str,
    /// A sentence for people.
    pub text: String,
    /// Id of the session that it happened to.
    pub session: Option<String>,
}

/// The session that something happens to, and the way to its record.
#[derive(Clone, Copy)]
pub(crate) struct Concerned<'a> {
    pub status: &'a SessionStatus,
    pub record: &'a mpsc::Sender<Order>,
}

impl Controller {
    /// Tells everybody. The record is waited for: what is told as having happened is on its way to the disk.
    pub(crate) async fn tell(&self, whom: Option<Concerned<'_>>, kind: &'static str, text: &str) {
        let at = self.runtime().clock.wall();
        self.tell_of(
            at,
            kind,
            text,
            whom.map(|whom| whom.status.facts.id.as_str()),
        );
        if let Some(whom) = whom {
            let order = Order::Event {
                at,
                kind,
                text: text.to_owned(),
            };
            // a record that has failed has ended its session, which says so
            let _ = whom.record.send(order).await;
        }
    }

    /// Tells everybody but the record, which whoever calls sees to.
    pub(crate) fn tell_of(
        &self,
        at: DateTime<Utc>,
        kind: &'static str,
        text: &str,
        session: Option<&str>,
    ) {
        let text = &*survey::printable(text);
        if kind == "frame-failed" {
            self.observed.counters.gap(at, text);
        }
        self.observed.rate_limit.say(kind, session, text);
        if session.is_none() {
            self.observed.daemon_log.note(at, kind, text);
        }
        self.broadcast.say(&BusEvent::Happened(Happening {
            at,
            kind,
            text: text.to_owned(),
            session: session.map(str::to_owned),
        }));
    }
}
