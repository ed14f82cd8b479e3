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

/// Takes all calls that can be served now; returns sender and serial number of each.
fn taken(queue: &Queue) -> Vec<(String, u32)> {
    let mut taken = Vec::new();
    while let Some(next) = take(queue) {
        let header = header::read(&next.bytes).unwrap();
        let sender = header.sender.to_owned();
        queue.is_served(&sender, header.serial);
        let (_, body) = next.bytes.split_last_chunk::<4>().unwrap();
        taken.push((sender, u32::from_ne_bytes(*body)));
    }
    let left = locked(&queue.waiting);
    assert_eq!((left.bytes, left.calls.len()), (0, 0));
    taken
}

fn take(queue: &Queue) -> Option<Incoming> {
    locked(&queue.waiting).take()
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
    // calls that expect a reply are limited by the bus; none of them is dropped
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
    // an untrusted sender is served one call at a time
    assert!(take(&queue).is_some());
    assert!(take(&queue).is_none());
    assert_eq!(push(&queue, &stop), Disposition::Dropped);
    let serial = stop.primary_header().serial_num().get();
    assert!(!queue.is_served(":1.2", serial));
    assert!(queue.is_served(":1.1", serial));
    assert_eq!(push(&queue, &stop), Disposition::Queued);
    assert!(take(&queue).is_some());
    assert!(take(&queue).is_none());
    // the calls of a sender that has disconnected are no longer counted
    queue.forget(":1.1");
    assert!(!queue.is_served(":1.1", serial));
    assert_eq!(locked(&queue.waiting).unanswered_all, 0);
    assert!(locked(&queue.waiting).unanswered.is_empty());
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
    assert!(locked(&queue.waiting).trusted.is_empty());
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
    let first = locked(&queue.waiting).take().unwrap();
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
