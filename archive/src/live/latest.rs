//! The newest message of each topic. Nothing else is stored for a broker that accepts no messages, so memory stays
//! bounded and no old message follows an outage.

use std::collections::BTreeMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

/// A message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Message {
    /// JSON.
    pub payload: String,
    /// Whether the broker retains it until the next one; other messages expire there.
    pub lasting: bool,
}

/// Messages by their topics.
pub(super) type Messages = BTreeMap<String, Message>;

/// The newest message of each topic, with a number that increases with each change.
#[derive(Debug, Default)]
pub(super) struct Latest {
    inner: Mutex<Inner>,
    changed: Notify,
}

#[derive(Debug, Default)]
struct Inner {
    number: u64,
    messages: BTreeMap<String, (u64, Message)>,
}

impl Latest {
    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Replaces all messages. An unchanged lasting message is not sent again.
    pub(super) fn replace(&self, messages: Messages) {
        let mut inner = self.inner();
        let mut before = std::mem::take(&mut inner.messages);
        for (topic, message) in messages {
            let same = before
                .remove(&topic)
                .filter(|(_, known)| known.lasting && *known == message);
            let entry = same.unwrap_or_else(|| {
                inner.number += 1;
                (inner.number, message)
            });
            inner.messages.insert(topic, entry);
        }
        drop(inner);
        self.changed.notify_one();
    }

    /// At most `most` messages that are not in `sent` (topic and number), with their numbers.
    pub(super) fn unsent(
        &self,
        sent: &BTreeMap<String, u64>,
        most: usize,
    ) -> Vec<(String, u64, Message)> {
        let inner = self.inner();
        let new = inner
            .messages
            .iter()
            .filter(|(topic, (number, _))| sent.get(*topic) != Some(number));
        new.take(most)
            .map(|(topic, (number, message))| (topic.clone(), *number, message.clone()))
            .collect()
    }

    /// Waits until messages have been replaced since the last wait.
    pub(super) async fn changed(&self) {
        self.changed.notified().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(payload: &str, lasting: bool) -> Message {
        Message {
            payload: payload.to_owned(),
            lasting,
        }
    }

    #[test]
    fn only_the_newest_message_of_a_topic_is_kept() {
        let latest = Latest::default();
        let mut sent = BTreeMap::new();
        for round in 0..1000 {
            let messages = [
                ("a".to_owned(), message(&round.to_string(), false)),
                ("b".to_owned(), message("same", true)),
            ];
            latest.replace(messages.into());
        }
        let new = latest.unsent(&sent, 10);
        let texts: Vec<_> = new.iter().map(|(_, _, m)| m.payload.as_str()).collect();
        assert_eq!(texts, ["999", "same"]);
        sent.extend(new.into_iter().map(|(topic, number, _)| (topic, number)));
        assert!(latest.unsent(&sent, 10).is_empty());
        // unchanged messages: those that expire at the broker are sent again, lasting ones are not
        latest.replace(
            [
                ("a".to_owned(), message("999", false)),
                ("b".to_owned(), message("same", true)),
            ]
            .into(),
        );
        let again = latest.unsent(&sent, 10);
        assert_eq!(again.len(), 1);
        assert_eq!(again[0].0, "a");
        latest.replace(Messages::new());
        assert!(latest.unsent(&BTreeMap::new(), 10).is_empty());
    }
}
