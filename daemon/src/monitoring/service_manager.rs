//! Messages to systemd, or to another service manager that `NOTIFY_SOCKET` names.
//!
//! A separate thread sends the messages in order: the socket buffers a few messages (`net.unix.max_dgram_qlen`), and
//! then blocks the sender. A service manager that does not read must not block a measurement or its end.

use std::fmt::Write;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::Duration;

use sd_notify::NotifyState;

/// Maximum time that [`finish`] waits for messages that are not sent yet.
const END: Duration = Duration::from_secs(1);

enum Message {
    States(String),
    Alive,
    /// Replies when every message before it has been sent.
    End(Sender<()>),
}

static QUEUE: LazyLock<Sender<Message>> = LazyLock::new(|| {
    let (queue, messages) = mpsc::channel();
    // without the thread, messages are dropped, as without a service manager
    let _ = std::thread::Builder::new()
        .name("notify".to_owned())
        .spawn(move || send(&messages));
    queue
});
/// Whether a watchdog message is queued; a second one would be redundant.
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

/// Sends a watchdog message, unless one is queued.
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
