//! Opens relays and reads them back; names the relay that did not move.

use std::collections::BTreeMap;

use rig::{RigError, Stream};
use scpi::ChannelEntry;
use survey::Relay;

use super::{Unit, compact};
use crate::command::{Command, Route};

impl<S: Stream> Unit<S> {
    /// Opens relays, reads them back, and then checks whether an earlier move was rejected, in one message.
    pub(in crate::driver) async fn open(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        self.closed_before_opening(&[], relays).await.map(drop)
    }

    /// As [`Unit::open`]; before opening, it reads back which of `requested` are closed.
    pub(in crate::driver) async fn closed_before_opening(
        &mut self,
        requested: &[Relay],
        relays: &[Relay],
    ) -> Result<Vec<bool>, RigError> {
        let mut message = Vec::new();
        let mut counts = Vec::new();
        if !requested.is_empty() {
            message.push(Route::Closed(compact(requested)).into());
            counts.push(requested.len());
        }
        if !relays.is_empty() {
            message.push(Route::Open(compact(relays)).into());
            message.push(Route::Closed(compact(relays)).into());
            counts.push(relays.len());
        }
        let deadline = self.conversation.link().deadline();
        let replies = self.send(message, deadline).await?;
        let unchecked = std::mem::take(&mut self.unchecked);
        if replies.error.code != 0 {
            // relays that are still closed are reported rather than the rejected command
            self.conversation.drain_further_errors().await;
            let closed = self.read_closed(relays).await?;
            self.conversation.check_open(relays, &closed)?;
            if unchecked || !requested.is_empty() {
                let command = "a relay move since the last check";
                return Err(self.conversation.refused(command, replies.error));
            }
            let (instrument, error) = (self.conversation.instrument(), replies.error);
            tracing::warn!(instrument, %error, "left in the error queue");
            return Ok(Vec::new());
        }
        if replies.answers.len() != counts.len() {
            let expected = format!("{} lists of states", counts.len());
            return Err(self.garbled(&replies, expected));
        }
        let mut found = Vec::with_capacity(counts.len());
        for (answer, count) in replies.answers.iter().zip(counts) {
            found.push(self.states(&replies.message, answer, count)?);
        }
        if !relays.is_empty() {
            let closed = found.pop().unwrap_or_default();
            self.conversation.check_open(relays, &closed)?;
        }
        Ok(found.pop().unwrap_or_default())
    }

    fn states(&self, message: &str, answer: &str, count: usize) -> Result<Vec<bool>, RigError> {
        let states: Result<Vec<bool>, _> = answer.split(',').map(scpi::parse_boolean).collect();
        states
            .ok()
            .filter(|states| states.len() == count)
            .ok_or_else(|| {
                let expected = format!("{count} states, each 0 or 1");
                self.conversation.garbled(message, answer, expected)
            })
    }

    pub(in crate::driver) async fn read_closed(
        &mut self,
        relays: &[Relay],
    ) -> Result<Vec<bool>, RigError> {
        if relays.is_empty() {
            return Ok(Vec::new());
        }
        let query = Route::Closed(compact(relays)).into();
        let deadline = self.conversation.link().deadline();
        let (message, answer) = self.ask(vec![query], deadline).await?;
        self.states(&message, &answer, relays.len())
    }

    /// The command among these whose relay moves are not in the relay states read back.
    pub(super) async fn move_not_made(&mut self, sent: &[Command]) -> Option<String> {
        let mut meant: BTreeMap<Relay, (bool, &Command)> = BTreeMap::new();
        for command in sent {
            let (list, closed) = match command {
                Command::Route(Route::Close(list)) => (list, true),
                Command::Route(Route::Open(list)) => (list, false),
                _ => continue,
            };
            for entry in list.entries() {
                let (first, last) = match entry {
                    ChannelEntry::One(one) => (*one, *one),
                    ChannelEntry::Range(first, last) => (*first, *last),
                };
                for relay in first..=last {
                    meant.insert(Relay(relay), (closed, command));
                }
            }
        }
        let relays: Vec<Relay> = meant.keys().copied().collect();
        let found = self.read_closed(&relays).await.ok()?;
        let found = relays.iter().zip(found);
        let mut other = found.filter_map(|(relay, found)| {
            let (closed, command) = meant.get(relay)?;
            (*closed != found).then_some(*command)
        });
        other.next().map(Command::to_string)
    }
}
