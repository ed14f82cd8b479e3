//! Queue of messages waiting to be served: in order for each sender, round-robin between senders; tracks calls without
//! a reply until they have been served.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::os::fd::OwnedFd;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use super::header::{self, Header};

/// Sender of the broker's own messages; cannot be forged.
const BROKER: &str = "org.freedesktop.DBus";

/// Most calls without a reply of one sender, waiting or running. The bus does not limit them.
const UNANSWERED_EACH: usize = 16;
/// The same for all untrusted senders together.
const UNANSWERED_ALL: usize = 1024;
/// Longest call without a reply, bytes; the daemon's methods need far less.
const LONGEST_UNANSWERED: usize = 64 * 1024;

/// Most bytes waiting; more stay in the bus, which limits calls that expect a reply.
const MOST_BYTES: usize = 64 << 20;

/// A message, or a line of the authentication before the first.
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
    /// Senders that are not served until one of their calls without a reply has finished.
    paused: BTreeSet<String>,
    /// Connected senders that may control the rig.
    trusted: BTreeSet<String>,
    /// Whether the last call served was of a trusted sender.
    trusted_had_turn: bool,
    /// Calls without an answer of each sender.
    unanswered: BTreeMap<String, Unanswered>,
    unanswered_all: usize,
    bytes: usize,
    ended: bool,
}

/// Calls without a reply of one sender.
#[derive(Debug, Default)]
struct Unanswered {
    /// Waiting or running calls by serial number, which may be used twice.
    numbers: BTreeMap<u32, usize>,
    all: usize,
    under_way: usize,
}

impl Queue {
    /// An empty queue; `acts` tells whether a method changes something, by interface and member.
    pub(crate) fn new(has_effect: fn(&str, &str) -> bool) -> Self {
        Self {
            has_effect,
            waiting: Mutex::default(),
            arrived: Notify::new(),
            drained: Condvar::new(),
        }
    }

    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Serves this sender before untrusted ones, until [`Queue::forget`].
    pub(crate) fn prefer(&self, sender: &str) {
        let mut waiting = self.waiting();
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
        let mut waiting = self.waiting();
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
        let served = self.waiting().is_served(sender, serial);
        if served {
            self.arrived.notify_one();
        }
        served
    }

    /// Adds a message after those of its sender. Waits if too many bytes are queued.
    pub(super) fn push(&self, message: &[u8], descriptors: Vec<OwnedFd>) -> Disposition {
        let mut waiting = self.waiting();
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
                let mut waiting = self.waiting();
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
        self.waiting().ended = true;
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
            // the daemon subscribes to no other's signals, and anybody may send them
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
            // alternates: trusted senders must not block everybody else
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

#[cfg(test)]
mod tests {
    use zbus::Message;
    use zbus::message::Flags;

    use super::*;

    fn queue() -> Queue {
        Queue::new(|_, member| member == "Stop")
    }

    fn call(sender: &str, member: &str, answered: bool, number: u32) -> Message {
        let mut call = Message::method_call("/", member)
            .interface("org.tactus.Tactus1.Session1")
            .sender(sender);
        if !answered {
            call = call.with_flags(Flags::NO_REPLY_EXPECTED);
        }
        call.build(&number).unwrap()
    }

    fn push(queue: &Queue, message: &Message) -> Disposition {
        queue.push(message.data().bytes(), Vec::new())
    }

    /// Sender and number of each call that is taken now.
    fn taken(queue: &Queue) -> Vec<(String, u32)> {
        let mut taken = Vec::new();
        while let Some(next) = take(queue) {
            let header = header::read(&next.bytes).unwrap();
            let sender = header.sender.to_owned();
            queue.is_served(&sender, header.serial);
            let (_, body) = next.bytes.split_last_chunk::<4>().unwrap();
            taken.push((sender, u32::from_ne_bytes(*body)));
        }
        let left = queue.waiting();
        assert_eq!((left.bytes, left.calls.len()), (0, 0));
        taken
    }

    fn take(queue: &Queue) -> Option<Incoming> {
        queue.waiting().take()
    }

    fn pairs(taken: &[(String, u32)]) -> Vec<(&str, u32)> {
        taken
            .iter()
            .map(|(sender, number)| (sender.as_str(), *number))
            .collect()
    }

    #[test]
    fn senders_are_served_by_turns_and_each_in_its_order() {
        let queue = queue();
        for number in 0..3 {
            push(&queue, &call(":1.1", "Stop", number != 1, number));
        }
        push(&queue, &call(":1.2", "State", true, 9));
        assert_eq!(
            pairs(&taken(&queue)),
            [(":1.1", 0), (":1.2", 9), (":1.1", 1), (":1.1", 2)]
        );
    }

    #[test]
    fn a_flood_without_answers_is_cut_and_others_are_kept() {
        let queue = queue();
        let dispositions: Vec<Disposition> = (0..100)
            .map(|number| push(&queue, &call(":1.1", "Stop", false, number)))
            .collect();
        let lost = dispositions
            .iter()
            .filter(|disposition| **disposition == Disposition::Dropped)
            .count();
        assert_eq!(lost, 100 - UNANSWERED_EACH);
        // the bus limits callers that wait for a reply, and none of their calls is lost
        for number in 0..100 {
            assert_eq!(
                push(&queue, &call(":1.1", "Stop", true, number)),
                Disposition::Queued
            );
        }
        assert_eq!(
            push(&queue, &call(":1.2", "Stop", false, 5)),
            Disposition::Queued
        );
        let taken = taken(&queue);
        assert_eq!(taken.len(), UNANSWERED_EACH + 100 + 1);
        assert_eq!(taken[1], (":1.2".to_owned(), 5));
    }

    #[test]
    fn a_call_without_answer_counts_until_it_has_been_served() {
        let queue = queue();
        let stop = call(":1.1", "Stop", false, 0);
        for _ in 0..UNANSWERED_EACH {
            assert_eq!(push(&queue, &stop), Disposition::Queued);
        }
        assert_eq!(push(&queue, &stop), Disposition::Dropped);
        // one at a time for an untrusted sender
        assert!(take(&queue).is_some());
        assert!(take(&queue).is_none());
        assert_eq!(push(&queue, &stop), Disposition::Dropped);
        let serial = stop.primary_header().serial_num().get();
        assert!(!queue.is_served(":1.2", serial));
        assert!(queue.is_served(":1.1", serial));
        assert_eq!(push(&queue, &stop), Disposition::Queued);
        assert!(take(&queue).is_some());
        assert!(take(&queue).is_none());
        // a sender that disconnects is not waited for
        queue.forget(":1.1");
        assert!(!queue.is_served(":1.1", serial));
        assert_eq!(queue.waiting().unanswered_all, 0);
        assert!(queue.waiting().unanswered.is_empty());
        assert_eq!(taken(&queue).len(), UNANSWERED_EACH - 1);
    }

    #[test]
    fn unanswered_senders_leave_slots_for_trusted_ones() {
        let queue = queue();
        let mut lost = 0;
        for sender in 0..2 * UNANSWERED_ALL {
            let disposition = push(&queue, &call(&format!(":1.{sender}"), "Stop", false, 0));
            lost += usize::from(disposition == Disposition::Dropped);
        }
        assert_eq!(lost, UNANSWERED_ALL);
        queue.prefer(":2.1");
        assert_eq!(
            push(&queue, &call(":2.1", "Stop", false, 7)),
            Disposition::Queued
        );
        assert_eq!(taken(&queue)[0], (":2.1".to_owned(), 7));
    }

    #[test]
    fn the_trusted_have_every_second_turn() {
        let queue = queue();
        for number in 0..2 {
            push(&queue, &call(":1.1", "State", true, number));
            push(&queue, &call(":1.2", "State", true, number));
            push(&queue, &call(":1.3", "State", true, number));
        }
        queue.prefer(":1.3");
        assert_eq!(
            pairs(&taken(&queue)),
            [
                (":1.3", 0),
                (":1.1", 0),
                (":1.3", 1),
                (":1.2", 0),
                (":1.1", 1),
                (":1.2", 1)
            ]
        );
        queue.forget(":1.3");
        assert!(queue.waiting().trusted.is_empty());
    }

    #[test]
    fn what_has_no_effect_is_not_kept() {
        let queue = queue();
        assert_eq!(
            push(&queue, &call(":1.1", "State", false, 0)),
            Disposition::Ignored
        );
        let signal = |sender: &str| {
            let signal = Message::signal("/", "org.example.A", "Happened");
            signal.sender(sender).build(&()).unwrap()
        };
        assert_eq!(push(&queue, &signal(":1.1")), Disposition::Ignored);
        push(&queue, &call(":1.1", "State", true, 1));
        assert_eq!(push(&queue, &signal(BROKER)), Disposition::Queued);
        let first = queue.waiting().take().unwrap();
        assert!(header::read(&first.bytes).unwrap().is_signal());
        assert_eq!(pairs(&taken(&queue)), [(":1.1", 1)]);
    }

    #[tokio::test]
    async fn what_came_before_the_end_is_still_taken() {
        let queue = queue();
        push(&queue, &call(":1.1", "State", true, 1));
        queue.end();
        assert!(queue.next().await.is_some());
        assert!(queue.next().await.is_none());
    }
}
