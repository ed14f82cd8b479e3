//! The topics of a machine and their messages.

use std::time::Duration;

use dbus::json::{Alarm, Running, Status, utc};
use dbus::{AlarmReport, LatestQuantities};
use serde::Serialize;
use serde_json::{Map, Value};

use super::home_assistant::HomeAssistant;
use super::latest::{Message, Messages};
use crate::upload::Owner;

/// Version of the topics; it is their second part.
const VERSION: &str = "1";

/// The state that a daemon has reported.
pub(super) struct Reported {
    /// Its address.
    pub daemon: String,
    pub status: dbus::Status,
    pub alarms: Vec<AlarmReport>,
    /// Of the running session, with its id.
    pub quantities: Option<(String, LatestQuantities)>,
}

/// The topics of a machine.
#[derive(Debug)]
pub(super) struct Topics {
    /// `tactus/1/SITE/DAQ`.
    base: String,
    home_assistant: Option<HomeAssistant>,
}

impl Topics {
    /// `kept`: how long the broker keeps a message.
    pub(super) fn new(owner: &Owner, home_assistant: Option<String>, kept: Duration) -> Self {
        let base = format!("tactus/{VERSION}/{}/{}", owner.site, owner.daq);
        Self {
            home_assistant: home_assistant
                .map(|prefix| HomeAssistant::new(prefix, owner, base.clone(), kept)),
            base,
        }
    }

    fn topic(&self, name: &str) -> String {
        format!("{}/{name}", self.base)
    }

    /// The topic of the status, which is also that of the last will.
    pub(super) fn status(&self) -> String {
        self.topic("status")
    }

    /// The status message of a machine whose state is unknown at present.
    pub(super) fn offline(why: &str) -> Message {
        let state = serde_json::json!({"state": "offline", "reason": why});
        Message {
            payload: state.to_string(),
            lasting: true,
        }
    }

    /// The only message while the daemon cannot be reached, because all others would be outdated.
    pub(super) fn without_daemon(&self, why: &str) -> Messages {
        [(self.status(), Self::offline(why))].into()
    }

    /// All messages.
    pub(super) fn messages(&mut self, reported: Reported) -> Messages {
        let Reported {
            daemon,
            status,
            alarms,
            quantities,
        } = reported;
        let quantities = quantities.and_then(|(session, found)| of_frame(&session, found));
        let status = Status::from(status, daemon);
        let alarms: Vec<Alarm> = alarms.into_iter().map(Alarm::from).collect();
        let mut messages: Messages = [
            (self.topic("health"), json(&status.health)),
            (
                self.topic("session"),
                json::<Option<Running>>(&status.session),
            ),
            (self.topic("quantities"), json(&quantities)),
            (self.status(), json(&status)),
        ]
        .into();
        for alarm in &alarms {
            // another name cannot be part of a topic
            if imaging::quantities::is_name(&alarm.name) {
                messages.insert(self.topic(&format!("alarm/{}", alarm.name)), json(alarm));
            }
        }
        if let Some(home_assistant) = &mut self.home_assistant {
            let (topic, message) = home_assistant.announcement(&status, &alarms, &quantities);
            messages.insert(topic, message);
        }
        messages
    }
}

/// The quantities of a frame, with the frame's own fields first; `None` if the text is not an object, from a daemon
/// of a later version.
fn of_frame(session: &str, found: LatestQuantities) -> Option<Value> {
    let Ok(Value::Object(fields)) = serde_json::from_str(&found.json) else {
        return None;
    };
    let wall = utc(chrono::DateTime::from_timestamp_nanos(found.wall_ns));
    let mut all = Map::new();
    all.insert("session".to_owned(), session.into());
    all.insert("frame".to_owned(), found.sequence.into());
    all.insert("wall".to_owned(), wall.into());
    all.insert("simulated".to_owned(), found.simulated.into());
    all.extend(fields);
    Some(Value::Object(all))
}

/// A message that expires. Serialisation to JSON cannot fail: numbers that are not finite become null.
fn json<T: Serialize>(value: &T) -> Message {
    Message {
        payload: serde_json::to_string(value).unwrap_or_else(|_| "null".to_owned()),
        lasting: false,
    }
}
