//! Relays opened and read back, and the one that did not move named.

use std::collections::BTreeMap;

use rig::{RigError, Stream};
use scpi::ChannelEntry;
use survey::Relay;

use super::readings::split_error;
use super::{Unit, compact, garbled};
use crate::command::{Command, Route, System};

impl<S: Stream> Unit<S> {
    /// Opens relays, reads them back, and then looks whether a move made since the last time was refused, in one message.
    pub(in crate::driver) async fn open(&mut self, relays: &[Relay]) -> Result<(), RigError> {
        self.closed_before_opening(&[], relays).await.map(drop)
    }

    /// As [`Unit::open`]; before, it reads back which of `asked` are closed.
    pub(in crate::driver) async fn closed_before_opening(
        &mut self,
        asked: &[Relay],
        relays: &[Relay],
    ) -> Result<Vec<bool>, RigError> {
        let mut message = Vec::new();
        let mut counts = Vec::new();
        if !asked.is_empty() {
            message.push(Route::Closed(compact(asked)).into());
            counts.push(asked.len());
        }
        if !relays.is_empty() {
            message.push(Route::Open(compact(relays)).into());
            message.push(Route::Closed(compact(relays)).into());
            counts.push(relays.len());
        }
        message.push(System::NextError.into());
        let (said, answer) = self.ask(message, self.link.deadline()).await?;
        let (states, error) = split_error(&answer);
        let error = self.error(&said, error)?;
        let unchecked = std::mem::take(&mut self.unchecked);
        if error.code != 0 {
            // What is still closed is worse than what was refused.
            self.drain("").await.ok();
            let closed = self.read_closed(relays).await?;
            self.all_open(relays, &closed)?;
            if unchecked || !asked.is_empty() {
                return Err(self.refused("a relay move since the last check".to_owned(), error));
            }
            tracing::warn!(instrument = self.link.instrument(), %error, "left in the error queue");
            return Ok(Vec::new());
        }
        let pieces: Vec<&str> = states.split(';').collect();
        if pieces.len() != counts.len().max(1) {
            let expected = format!("{} lists of states", counts.len());
            return Err(garbled(self.link.instrument(), &said, &answer, &expected));
        }
        let mut found = Vec::with_capacity(counts.len());
        for (piece, count) in pieces.into_iter().zip(counts) {
            found.push(self.states(&said, piece, count)?);
        }
        if !relays.is_empty() {
            let closed = found.pop().unwrap_or_default();
            self.all_open(relays, &closed)?;
        }
        Ok(found.pop().unwrap_or_default())
    }

    pub(super) fn all_open(&self, relays: &[Relay], closed: &[bool]) -> Result<(), RigError> {
        let stuck: Vec<Relay> = relays
            .iter()
            .zip(closed)
            .filter(|(_, closed)| **closed)
            .map(|(relay, _)| *relay)
            .collect();
        match stuck.is_empty() {
            true => Ok(()),
            false => Err(RigError::StillClosed {
                instrument: self.link.instrument().to_owned(),
                relays: stuck,
            }),
        }
    }

    pub(super) fn states(
        &self,
        asked: &str,
        answer: &str,
        count: usize,
    ) -> Result<Vec<bool>, RigError> {
        let states: Result<Vec<bool>, _> = answer.split(',').map(scpi::parse_boolean).collect();
        match states {
            Ok(states) if states.len() == count => Ok(states),
            Ok(_) | Err(_) => Err(garbled(
                self.link.instrument(),
                asked,
                answer,
                &format!("{count} states, each 0 or 1"),
            )),
        }
    }

    pub(in crate::driver) async fn read_closed(
        &mut self,
        relays: &[Relay],
    ) -> Result<Vec<bool>, RigError> {
        if relays.is_empty() {
            return Ok(Vec::new());
        }
        let question = Route::Closed(compact(relays)).into();
        let (asked, answer) = self.ask(vec![question], self.link.deadline()).await?;
        self.states(&asked, &answer, relays.len())
    }

    /// The relay move among these that the relays do not show.
    pub(super) async fn not_obeyed(&mut self, said: &[Command]) -> Option<String> {
        let mut meant: BTreeMap<Relay, (bool, &Command)> = BTreeMap::new();
        for command in said {
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
