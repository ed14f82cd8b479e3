//! What happens to the rig, told to everybody: the log, the bus, and the record of the session under way, or where there
//! is none the daemon's own chronicle.

use chrono::{DateTime, Utc};
use rig::Clock;
use tokio::sync::mpsc;

use crate::events::broadcast::Notice;
use crate::recording::recorder::Order;
use crate::recording::session_status::Live;
use crate::session::controller::Keeper;

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
    pub live: &'a Live,
    pub record: &'a mpsc::Sender<Order>,
}

impl Keeper {
    /// Tells everybody. The record is waited for: what is told as having happened is on its way to the disk.
    pub(crate) async fn tell(&self, whom: Option<Concerned<'_>>, kind: &'static str, text: &str) {
        let at = self.house().clock.wall();
        self.tell_of(at, kind, text, whom.map(|whom| whom.live.facts.id.as_str()));
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
            self.observed.tally.gap(at, text);
        }
        self.observed.aloud.say(kind, session, text);
        if session.is_none() {
            self.observed.chronicle.note(at, kind, text);
        }
        self.herald.say(&Notice::Happened(Happening {
            at,
            kind,
            text: text.to_owned(),
            session: session.map(str::to_owned),
        }));
    }
}
