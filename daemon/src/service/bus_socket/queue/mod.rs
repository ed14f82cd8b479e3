//! Queue of messages waiting to be served: in order for each sender, round-robin between senders. Counts calls that
//! expect no reply until they have been served.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::os::fd::OwnedFd;
use std::sync::{Condvar, Mutex, PoisonError};

use tokio::sync::Notify;

use super::header::{self, Header};

use crate::locked::locked;

/// Sender of the broker's own messages; cannot be forged.
const BROKER: &str = "org.freedesktop.DBus";

/// Maximum number of calls of one sender that expect no reply, waiting or running. The bus does not limit them.
const UNANSWERED_EACH: usize = 16;
/// When the calls of all senders reach this number, further ones of untrusted senders are dropped.
const UNANSWERED_ALL: usize = 1024;
/// Maximum size of such a call, bytes; the daemon's methods need far less.
const LONGEST_UNANSWERED: usize = 64 * 1024;

/// Maximum number of bytes waiting. Further messages stay in the bus, which limits calls that expect a reply.
const MOST_BYTES: usize = 64 << 20;

/// A message, or a line of the authentication before the first message.
#[derive(Debug)]
pub(super) struct Incoming {
    pub(super) bytes: Vec<u8>,
    pub(super) descriptors: Vec<OwnedFd>,
}

/// What is done with a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Disposition {
    Queued,
    /// Dropped: it has no effect.
    Ignored,
    /// Dropped: it may have an effect, but its sender exceeds the limit.
    Dropped,
}

/// The messages that wait.
#[derive(Debug)]
pub(crate) struct Queue {
    /// Whether a method changes something, by interface and member.
    has_effect: fn(&str, &str) -> bool,
    waiting: Mutex<Waiting>,
    arrived: Notify,
    drained: Condvar,
}

#[derive(Debug, Default)]
struct Waiting {
    /// Replies to the daemon's own calls, and the broker's signals.
    first: VecDeque<Incoming>,
    /// Calls by sender, and whether each expects a reply.
    calls: BTreeMap<String, VecDeque<(Incoming, bool)>>,
    /// Order of service: trusted senders, and all others. Each sender with calls is in one of them once, or in
    /// `paused`.
    turns: [VecDeque<String>; 2],
    /// Senders that are not served until their running call that expects no reply has finished.
    paused: BTreeSet<String>,
    /// Connected senders that may control the rig.
    trusted: BTreeSet<String>,
    /// Whether the last call served was of a trusted sender.
    trusted_had_turn: bool,
    /// Calls that expect no reply, by sender.
    unanswered: BTreeMap<String, Unanswered>,
    unanswered_all: usize,
    bytes: usize,
    ended: bool,
}

/// Calls of one sender that expect no reply.
#[derive(Debug, Default)]
struct Unanswered {
    /// Number of waiting or running calls for each serial number, which a sender may use twice.
    numbers: BTreeMap<u32, usize>,
    all: usize,
    under_way: usize,
}

impl Queue {
    /// An empty queue; `has_effect` tells whether a method changes something, by interface and member.
    pub(crate) fn new(has_effect: fn(&str, &str) -> bool) -> Self {
        Self {
            has_effect,
            waiting: Mutex::default(),
            arrived: Notify::new(),
            drained: Condvar::new(),
        }
    }

    /// Serves this sender before untrusted ones, until [`Queue::forget`].
    pub(crate) fn prefer(&self, sender: &str) {
        let mut waiting = locked(&self.waiting);
        if !waiting.trusted.insert(sender.to_owned()) {
            return;
        }
        waiting.resume_sender(sender);
        let [trusted, others] = &mut waiting.turns;
        if let Some(at) = others.iter().position(|other| other == sender) {
            trusted.extend(others.remove(at));
        }
        drop(waiting);
        self.arrived.notify_one();
    }

    /// Removes a sender that has left the bus; its name is never reused.
    pub(crate) fn forget(&self, sender: &str) {
        let mut waiting = locked(&self.waiting);
        waiting.trusted.remove(sender);
        if let Some(own) = waiting.unanswered.remove(sender) {
            waiting.unanswered_all -= own.all;
        }
        waiting.resume_sender(sender);
        drop(waiting);
        self.arrived.notify_one();
    }

    /// Records that a call has been served; returns whether its sender expected no reply.
    pub(super) fn is_served(&self, sender: &str, serial: u32) -> bool {
        let served = locked(&self.waiting).is_served(sender, serial);
        if served {
            self.arrived.notify_one();
        }
        served
    }

    /// Adds a message after those of its sender. Waits if too many bytes are queued.
    pub(super) fn push(&self, message: &[u8], descriptors: Vec<OwnedFd>) -> Disposition {
        let mut waiting = locked(&self.waiting);
        while waiting.bytes >= MOST_BYTES && !waiting.ended {
            waiting = self
                .drained
                .wait(waiting)
                .unwrap_or_else(PoisonError::into_inner);
        }
        let disposition = waiting.enqueue(message, descriptors, self.has_effect);
        drop(waiting);
        if disposition == Disposition::Queued {
            self.arrived.notify_one();
        }
        disposition
    }

    /// The next message; `None` when the connection has ended and the queue is empty.
    pub(super) async fn next(&self) -> Option<Incoming> {
        loop {
            {
                let mut waiting = locked(&self.waiting);
                let full = waiting.bytes >= MOST_BYTES;
                if let Some(next) = waiting.take() {
                    if full {
                        self.drained.notify_all();
                    }
                    return Some(next);
                }
                if waiting.ended {
                    return None;
                }
            }
            self.arrived.notified().await;
        }
    }

    /// Ends the queue.
    pub(super) fn end(&self) {
        locked(&self.waiting).ended = true;
        self.arrived.notify_one();
        self.drained.notify_all();
    }
}

impl Waiting {
    fn enqueue(
        &mut self,
        message: &[u8],
        descriptors: Vec<OwnedFd>,
        has_effect: fn(&str, &str) -> bool,
    ) -> Disposition {
        let Some(header) = header::read(message).filter(Header::is_call) else {
            // the daemon subscribes only to signals of the broker, and any user may send others
            let of_others = |header: Header<'_>| header.is_signal() && header.sender != BROKER;
            if header::read(message).is_some_and(of_others) {
                return Disposition::Ignored;
            }
            self.bytes += message.len();
            self.first.push_back(Incoming {
                bytes: message.to_vec(),
                descriptors,
            });
            return Disposition::Queued;
        };
        let sender = header.sender;
        let trusted = self.trusted.contains(sender);
        if !header.wants_answer() {
            if !has_effect(header.interface, header.member) {
                return Disposition::Ignored;
            }
            let own = self.unanswered.get(sender).map_or(0, |own| own.all);
            let too_many =
                own >= UNANSWERED_EACH || (!trusted && self.unanswered_all >= UNANSWERED_ALL);
            if too_many || message.len() > LONGEST_UNANSWERED {
                return Disposition::Dropped;
            }
            let own = self.unanswered.entry(sender.to_owned()).or_default();
            *own.numbers.entry(header.serial).or_default() += 1;
            own.all += 1;
            self.unanswered_all += 1;
        }
        self.bytes += message.len();
        let mut bytes = message.to_vec();
        header::ask_for_answer(&mut bytes);
        let calls = self.calls.entry(sender.to_owned()).or_default();
        if calls.is_empty() {
            self.turns[usize::from(!trusted)].push_back(sender.to_owned());
        }
        // no method takes descriptors, and queued ones would use up the daemon's limit
        let descriptors = Vec::new();
        calls.push_back((Incoming { bytes, descriptors }, header.wants_answer()));
        Disposition::Queued
    }

    fn is_served(&mut self, sender: &str, serial: u32) -> bool {
        let Some(own) = self.unanswered.get_mut(sender) else {
            return false;
        };
        let Some(count) = own.numbers.get_mut(&serial) else {
            return false;
        };
        *count -= 1;
        if *count == 0 {
            own.numbers.remove(&serial);
        }
        own.all -= 1;
        own.under_way = own.under_way.saturating_sub(1);
        if own.all == 0 {
            self.unanswered.remove(sender);
        }
        self.unanswered_all -= 1;
        self.resume_sender(sender);
        true
    }

    /// Serves this sender again.
    fn resume_sender(&mut self, sender: &str) {
        if let Some(sender) = self.paused.take(sender) {
            let to = usize::from(!self.trusted.contains(&sender));
            self.turns[to].push_back(sender);
        }
    }

    fn take(&mut self) -> Option<Incoming> {
        let next = match self.first.pop_front() {
            Some(first) => first,
            None => self.take_call()?,
        };
        self.bytes -= next.bytes.len();
        Some(next)
    }

    fn take_call(&mut self) -> Option<Incoming> {
        loop {
            // alternates between the two groups: trusted senders must not block all others
            let order = match self.trusted_had_turn {
                true => [1, 0],
                false => [0, 1],
            };
            let from = order.into_iter().find(|of| !self.turns[*of].is_empty())?;
            let sender = self.turns[from].pop_front()?;
            let calls = self.calls.get_mut(&sender)?;
            let (_, answered) = calls.front()?;
            if !answered && let Some(own) = self.unanswered.get_mut(&sender) {
                // each call may query polkit, which replies to one query at a time
                if from == 1 && own.under_way > 0 {
                    self.paused.insert(sender);
                    continue;
                }
                own.under_way += 1;
            }
            self.trusted_had_turn = from == 0;
            let (next, _) = calls.pop_front()?;
            if calls.is_empty() {
                self.calls.remove(&sender);
            } else {
                let to = usize::from(!self.trusted.contains(&sender));
                self.turns[to].push_back(sender);
            }
            return Some(next);
        }
    }
}
