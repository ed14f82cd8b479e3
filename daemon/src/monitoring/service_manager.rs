//! Messages to systemd, or to another service manager that `NOTIFY_SOCKET` names.
//!
//! A thread of its own sends them in their order: the socket takes a few messages (`net.unix.max_dgram_qlen`), and then whoever
//! sends waits. A service manager that does not read must stop neither a measurement nor the end of one.

use std::fmt::Write;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::Duration;

use sd_notify::NotifyState;

/// Longest wait at the end for messages that are not sent yet.
const END: Duration = Duration::from_secs(1);

enum Message {
    States(String),
    Alive,
    /// Everything before it is sent.
    End(Sender<()>),
}

static QUEUE: LazyLock<Sender<Message>> = LazyLock::new(|| {
    let (queue, messages) = mpsc::channel();
    // without the thread, messages go nowhere, as without a service manager
    let _ = std::thread::Builder::new()
        .name("notify".to_owned())
        .spawn(move || send(&messages));
    queue
});
/// A sign of life waits to be sent: another one would say nothing new.
static ALIVE: AtomicBool = AtomicBool::new(false);

fn send(messages: &Receiver<Message>) {
    for message in messages {
        let _ = match message {
            Message::States(text) => sd_notify::notify(&[NotifyState::Custom(&text)]),
            Message::Alive => {
                let sent = sd_notify::notify(&[NotifyState::Watchdog]);
                ALIVE.store(false, Ordering::Release);
                sent
            }
            Message::End(done) => {
                let _ = done.send(());
                Ok(())
            }
        };
    }
}

/// Sends states.
pub(crate) fn notify(states: &[NotifyState<'_>]) {
    let mut text = String::new();
    for (number, state) in states.iter().enumerate() {
        let _ = write!(text, "{}{state}", if number > 0 { "\n" } else { "" });
    }
    let _ = QUEUE.send(Message::States(text));
}

/// Sends a sign of life.
pub(crate) fn notify_alive() {
    if !ALIVE.swap(true, Ordering::AcqRel) {
        let _ = QUEUE.send(Message::Alive);
    }
}

/// Waits until everything is sent, for a second at most.
pub(crate) fn finish() {
    let (done, all_sent) = mpsc::channel();
    let _ = QUEUE.send(Message::End(done));
    let _ = all_sent.recv_timeout(END);
}
