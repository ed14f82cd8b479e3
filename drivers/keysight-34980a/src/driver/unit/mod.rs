//! The conversation with one mainframe: deferred commands, queries, parsing of replies.

mod readings;
mod relays;
mod settings;

use std::collections::BTreeMap;
use std::time::Duration;

use rig::{Conversation, MeterSettings, Replies, RigError, Stream};
use scpi::{ChannelEntry, ChannelList, join_units};
use survey::Relay;

use crate::command::{Command, HeaderForm, Quantity};

#[derive(Debug)]
pub(super) struct Unit<S> {
    pub(super) conversation: Conversation<S>,
    /// Relay moves deferred to the next query.
    pub(super) held: Vec<Command>,
    /// Moves were sent, and the error queue has not been queried since.
    pub(super) unchecked: bool,
    pub(super) prepared: Option<Prepared>,
    /// Range of each channel as last set; that of the bare voltmeter under `None`. Empty if not known.
    ranges: BTreeMap<Option<Relay>, f64>,
    /// Delay of each channel that was set individually; the others have the common delay.
    delays: BTreeMap<Relay, Duration>,
    /// The scan list as last set, ascending.
    listed: Vec<Relay>,
    /// Whether a measurement failed; all settings must then be sent again.
    doubted: bool,
    /// Whether `*RST` has been sent; it is sent once, before the first preparation.
    reset: bool,
    /// For settings with two forms of header: the form that the instrument has accepted.
    pub(super) headers: BTreeMap<Quantity, HeaderForm>,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Prepared {
    pub(super) meter: MeterSettings,
    /// The scan list in the requested order; the instrument scans in ascending order.
    pub(super) scan: Vec<Relay>,
    pub(super) deadline: Duration,
}

impl Prepared {
    fn ascending(&self) -> Vec<Relay> {
        let mut relays = self.scan.clone();
        relays.sort_unstable();
        relays
    }

    /// The scan list as written in commands; `(@)` means the bare voltmeter.
    fn list(&self) -> ChannelList {
        compact(&self.ascending())
    }

    /// Whether `other` needs the same settings.
    pub(super) fn is_set_as(&self, other: &Self) -> bool {
        self.meter == other.meter && self.scan == other.scan
    }
}

impl<S: Stream> Unit<S> {
    pub(super) fn new(conversation: Conversation<S>) -> Self {
        Self {
            conversation,
            held: Vec::new(),
            unchecked: false,
            prepared: None,
            ranges: BTreeMap::new(),
            delays: BTreeMap::new(),
            listed: Vec::new(),
            doubted: false,
            reset: false,
            headers: BTreeMap::new(),
        }
    }

    /// Sends the deferred commands together with these commands, the last of which is a query.
    pub(super) async fn ask(
        &mut self,
        commands: Vec<Command>,
        deadline: Duration,
    ) -> Result<(String, String), RigError> {
        let commands = self.with_held(commands);
        self.conversation.ask(&commands, deadline).await
    }

    /// Sends the deferred commands together with these commands and a query of the error queue.
    async fn send(
        &mut self,
        commands: Vec<Command>,
        deadline: Duration,
    ) -> Result<Replies, RigError> {
        let commands = self.with_held(commands);
        self.conversation.send_within(&commands, deadline).await
    }

    /// Takes the deferred moves and appends these commands. After a fault the deferred moves must not be sent later.
    fn with_held(&mut self, commands: Vec<Command>) -> Vec<Command> {
        let mut all = std::mem::take(&mut self.held);
        all.extend(commands);
        all
    }

    /// Sends several queries in one message, and returns a reply for each. No reply may contain a semicolon.
    async fn ask_all(&mut self, queries: Vec<Command>) -> Result<Replies, RigError> {
        let count = queries.len();
        let replies = self
            .send(queries, self.conversation.link().deadline())
            .await?;
        if replies.error.code != 0 {
            self.conversation.drain_further_errors().await;
            return Err(self.conversation.refused(replies.message, replies.error));
        }
        if replies.answers.len() != count {
            let expected = format!("{count} answers and an error entry");
            return Err(self.garbled(&replies, expected));
        }
        Ok(replies)
    }

    /// Sends settings and checks that none was rejected.
    async fn set(&mut self, commands: Vec<Command>) -> Result<(), RigError> {
        let sent = join_units(&commands);
        let deadline = self.conversation.link().deadline();
        let error = self.send(commands, deadline).await?.error;
        match error.code {
            0 => Ok(()),
            _ => Err(self.conversation.refused(sent, error)),
        }
    }

    fn garbled(&self, replies: &Replies, expected: impl Into<String>) -> RigError {
        let (message, reply) = (&replies.message, &replies.reply);
        self.conversation.garbled(message, reply, expected)
    }
}

/// The channel list of relays in their order, with consecutive numbers as ranges.
pub(super) fn compact(relays: &[Relay]) -> ChannelList {
    let mut entries: Vec<ChannelEntry> = Vec::new();
    for Relay(number) in relays.iter().copied() {
        // A range skips ABus relays, so those are always written out.
        let bus = number % 1000 > 900;
        match entries.last_mut() {
            Some(ChannelEntry::Range(_, last)) if !bus && *last + 1 == number => *last = number,
            _ => {
                let run = match entries.as_slice() {
                    [.., ChannelEntry::One(first), ChannelEntry::One(second)]
                        if !bus && first + 1 == *second && second + 1 == number =>
                    {
                        Some(*first)
                    }
                    _ => None,
                };
                match run {
                    Some(first) => {
                        entries.truncate(entries.len() - 2);
                        entries.push(ChannelEntry::Range(first, number));
                    }
                    None => entries.push(ChannelEntry::One(number)),
                }
            }
        }
    }
    entries.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_are_written_as_a_range_and_bus_relays_never() {
        let written = |numbers: &[u32]| {
            let relays: Vec<Relay> = numbers.iter().copied().map(Relay).collect();
            compact(&relays).to_string()
        };
        assert_eq!(written(&[]), "(@)");
        assert_eq!(written(&[1001, 1002, 1003, 1004]), "(@1001:1004)");
        assert_eq!(written(&[1001, 1002, 1005]), "(@1001,1002,1005)");
        assert_eq!(written(&[1003, 1002, 1001]), "(@1003,1002,1001)");
        assert_eq!(written(&[1911, 1912, 1913]), "(@1911,1912,1913)");
        assert_eq!(
            written(&[1001, 1002, 1003, 1036, 1037, 1038]),
            "(@1001:1003,1036:1038)"
        );
    }
}
