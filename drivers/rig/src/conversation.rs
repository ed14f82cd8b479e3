//! SCPI messages to one instrument: each ends with a query of the error queue; replies are split into answers and error
//! entry. Makes the errors of instruments, with the instrument's name.

use std::fmt;
use std::time::Duration;

use scpi::{Common, ErrorEntry, join_units};
use survey::Relay;

use crate::{Link, RigError, Stream};

/// Longest command and longest reply repeated in an error, characters.
const SHOWN_COMMAND: usize = 160;
const SHOWN_ANSWER: usize = 80;

/// A link to an instrument with an error queue.
#[derive(Debug)]
pub struct Conversation<S> {
    link: Link<S>,
    next_error: String,
    most_errors: usize,
}

/// The reply to one message.
#[derive(Debug, Clone, PartialEq)]
pub struct Replies {
    /// The message as it was sent, the query of the error queue included.
    pub message: String,
    /// The whole reply.
    pub reply: String,
    /// The replies to the queries, in order; a rejected query has none.
    pub answers: Vec<String>,
    /// The oldest entry of the error queue; code 0 if it was empty.
    pub error: ErrorEntry,
}

impl<S: Stream> Conversation<S> {
    /// A conversation over a link. `next_error` is the query that takes the oldest error; after `most_errors` entries
    /// the queue counts as broken.
    pub fn new(link: Link<S>, next_error: impl fmt::Display, most_errors: usize) -> Self {
        Self {
            link,
            next_error: next_error.to_string(),
            most_errors,
        }
    }

    /// The link.
    pub fn link(&self) -> &Link<S> {
        &self.link
    }

    /// The link, to resynchronise it.
    pub fn link_mut(&mut self) -> &mut Link<S> {
        &mut self.link
    }

    /// Name and address for messages.
    pub fn instrument(&self) -> &str {
        self.link.instrument()
    }

    /// Sends `*IDN?` and returns the reply. `is_expected` checks its fields (maker, model, serial number, firmware,
    /// without surrounding blanks); `expected` is the name of the expected instrument in the error.
    ///
    /// # Errors
    /// [`RigError::WrongInstrument`] if `is_expected` returns false, or an error of the link.
    pub async fn identify(
        &mut self,
        expected: &str,
        is_expected: impl FnOnce(&[&str]) -> bool,
    ) -> Result<String, RigError> {
        let found = self.link.ask(&Common::Identify.to_string()).await?;
        let fields: Vec<&str> = found.split(',').map(str::trim).collect();
        if is_expected(&fields) {
            return Ok(found);
        }
        Err(RigError::WrongInstrument {
            instrument: self.instrument().to_owned(),
            expected: expected.to_owned(),
            found,
        })
    }

    /// Sends commands, the last of which is a query, in one segment; returns the message and its reply.
    ///
    /// # Errors
    /// An error of the link.
    pub async fn ask(
        &mut self,
        commands: &[impl fmt::Display],
        deadline: Duration,
    ) -> Result<(String, String), RigError> {
        let message = join_units(commands);
        let reply = self.link.ask_within(&message, deadline).await?;
        Ok((message, reply))
    }

    /// Sends commands and a query of the error queue in one segment, with the link's timeout.
    ///
    /// # Errors
    /// An error of the link, or a reply without an error entry.
    pub async fn send(&mut self, commands: &[impl fmt::Display]) -> Result<Replies, RigError> {
        self.send_within(commands, self.link.deadline()).await
    }

    /// Like [`Conversation::send`] with an individual timeout.
    ///
    /// # Errors
    /// As [`Conversation::send`].
    pub async fn send_within(
        &mut self,
        commands: &[impl fmt::Display],
        deadline: Duration,
    ) -> Result<Replies, RigError> {
        let mut message = join_units(commands);
        if !message.is_empty() {
            message.push_str(";:");
        }
        message.push_str(&self.next_error);
        let reply = self.link.ask_within(&message, deadline).await?;
        let (answers, error) = split_error(&reply);
        let error = error
            .parse()
            .map_err(|_| self.garbled(&message, &reply, "answers, an error entry last"))?;
        let answers = match answers {
            "" => Vec::new(),
            answers => answers.split(';').map(str::to_owned).collect(),
        };
        Ok(Replies {
            message,
            reply,
            answers,
            error,
        })
    }

    /// Removes errors from the error queue until it is empty, and logs each.
    ///
    /// # Errors
    /// An error of the link, or a queue that does not become empty.
    pub async fn drain_errors(&mut self) -> Result<(), RigError> {
        for _ in 0..self.most_errors {
            let error = self.send(&[] as &[&str]).await?.error;
            if error.code == 0 {
                return Ok(());
            }
            tracing::warn!(instrument = self.instrument(), %error, "left in the error queue");
        }
        let expected = "an end of the error queue";
        Err(self.garbled(&self.next_error, "one error after another", expected))
    }

    /// Like [`Conversation::drain_errors`], for a caller that reports an earlier error: a failure must not replace that
    /// error, and is only logged.
    pub async fn drain_further_errors(&mut self) {
        if let Err(cause) = self.drain_errors().await {
            tracing::warn!(instrument = self.instrument(), %cause, "while reading further errors");
        }
    }

    /// The error for a command that was followed by this entry of the error queue.
    pub fn refused(&self, command: impl Into<String>, error: ErrorEntry) -> RigError {
        RigError::Refused {
            instrument: self.instrument().to_owned(),
            command: command.into(),
            code: error.code,
            message: error.message,
        }
    }

    /// The error for a reply that does not have the expected form; command and reply are shortened.
    pub fn garbled(&self, command: &str, answer: &str, expected: impl Into<String>) -> RigError {
        RigError::Garbled {
            instrument: self.instrument().to_owned(),
            command: command.chars().take(SHOWN_COMMAND).collect(),
            answer: answer.chars().take(SHOWN_ANSWER).collect(),
            expected: expected.into(),
        }
    }

    /// The error for a setting that reads back differently from what was set.
    pub fn mismatch(&self, setting: &str, set: impl ToString, read: impl ToString) -> RigError {
        RigError::Mismatch {
            instrument: self.instrument().to_owned(),
            setting: setting.to_owned(),
            set: set.to_string(),
            read: read.to_string(),
        }
    }

    /// The error for an operation that the instrument cannot do; `what` is, for example, `scan relay 1042`.
    pub fn unable(&self, what: impl Into<String>) -> RigError {
        RigError::Unable {
            instrument: self.instrument().to_owned(),
            what: what.into(),
        }
    }

    /// Checks that relays are open; `closed` holds the state read back for each of `relays`, in the same order.
    ///
    /// # Errors
    /// [`RigError::StillClosed`] with the relays that are closed.
    pub fn check_open(&self, relays: &[Relay], closed: &[bool]) -> Result<(), RigError> {
        let states = relays.iter().zip(closed);
        let relays: Vec<Relay> = states
            .filter_map(|(relay, closed)| closed.then_some(*relay))
            .collect();
        if relays.is_empty() {
            return Ok(());
        }
        Err(RigError::StillClosed {
            instrument: self.instrument().to_owned(),
            relays,
        })
    }
}

/// Splits a reply into its answers and the error entry at the end. The entry begins at the first piece that is text:
/// its text may contain a semicolon.
fn split_error(reply: &str) -> (&str, &str) {
    let mut from = 0;
    for piece in reply.split(';') {
        if piece.contains(['"', '\'']) {
            return (reply[..from].trim_end_matches(';'), &reply[from..]);
        }
        from += piece.len() + 1;
    }
    (reply, "")
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tracing::field::Field;
    use tracing::span::{Attributes, Id, Record};
    use tracing::{Event, Metadata};

    use super::*;

    /// Runs `task` against an instrument with these replies; returns what the instrument received, and the result.
    async fn with<T>(
        replies: &str,
        task: impl AsyncFnOnce(&mut Conversation<tokio::io::DuplexStream>) -> T,
    ) -> (String, T) {
        let (here, mut there) = tokio::io::duplex(4096);
        let link = Link::new(here, "a meter", Duration::from_secs(1));
        let mut conversation = Conversation::new(link, "SYST:ERR?", 3);
        let instrument = async {
            let mut received = String::new();
            for reply in replies.lines() {
                while !received.ends_with('\n') {
                    received.push(char::from(there.read_u8().await.unwrap()));
                }
                there.write_all(reply.as_bytes()).await.unwrap();
                there.write_all(b"\n").await.unwrap();
                received.push('|');
            }
            received
        };
        tokio::join!(instrument, task(&mut conversation))
    }

    #[tokio::test]
    async fn answers_are_split_from_the_error_entry() {
        let (received, replies) = with(
            "1;2;-113,\"Undefined header; near B?\"",
            async |conversation| conversation.send(&["A?", "B?", "*C"]).await.unwrap(),
        )
        .await;
        assert_eq!(received, "A?;:B?;*C;:SYST:ERR?\n|");
        assert_eq!(replies.answers, ["1", "2"]);
        assert_eq!(replies.error.code, -113);
        assert_eq!(replies.error.message, "Undefined header; near B?");
    }

    #[tokio::test]
    async fn reply_without_an_error_entry_is_garbled() {
        let (_, sent) = with("1;2", async |conversation| {
            conversation.send(&["A?", "B?"]).await
        })
        .await;
        let error = sent.unwrap_err().to_string();
        assert!(error.contains("'A?;:B?;:SYST:ERR?' with '1;2'"), "{error}");
    }

    #[tokio::test]
    async fn error_queue_without_an_end_is_given_up() {
        let (received, drained) = with("-1,\"a\"\n-2,\"b\"\n0,\"c\"", async |conversation| {
            conversation.drain_errors().await
        })
        .await;
        assert_eq!(received.matches("SYST:ERR?").count(), 3);
        drained.unwrap();
        let (_, drained) = with("-1,\"a\"\n-2,\"b\"\n-3,\"c\"", async |conversation| {
            conversation.drain_errors().await
        })
        .await;
        let error = drained.unwrap_err().to_string();
        assert!(error.contains("an end of the error queue"), "{error}");
    }

    /// Collects the fields of the events that are logged.
    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<String>>);

    impl tracing::Subscriber for Log {
        fn enabled(&self, _: &Metadata<'_>) -> bool {
            true
        }
        fn new_span(&self, _: &Attributes<'_>) -> Id {
            Id::from_u64(1)
        }
        fn record(&self, _: &Id, _: &Record<'_>) {}
        fn record_follows_from(&self, _: &Id, _: &Id) {}
        fn event(&self, event: &Event<'_>) {
            let mut text = self.0.lock().unwrap();
            event.record(&mut |field: &Field, value: &dyn fmt::Debug| {
                text.push_str(&format!("{field}={value:?};"));
            });
        }
        fn enter(&self, _: &Id) {}
        fn exit(&self, _: &Id) {}
    }

    #[tokio::test]
    async fn failure_to_empty_the_error_queue_is_logged() {
        let log = Log::default();
        let _guard = tracing::subscriber::set_default(log.clone());
        with("-1,\"a\"\n-2,\"b\"\n-3,\"c\"", async |conversation| {
            conversation.drain_further_errors().await;
        })
        .await;
        let text = log.0.lock().unwrap();
        assert!(
            text.contains("while reading further errors")
                && text.contains("an end of the error queue"),
            "{text}"
        );
    }
}
