//! A link: one client's session with the instrument, with its own input buffer and output queue.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{Notify, mpsc};
use tokio::task::JoinHandle;
use tokio::time::{Instant, timeout_at};

use crate::server::device::{MessageFramer, Refusal, Session};

/// Maximum number of messages waiting for execution; further writes wait.
const WAITING: usize = 16;
/// Why a read ended (VXI-11, B.6.5).
const BY_COUNT: u32 = 1;
const BY_CHARACTER: u32 = 2;
const BY_END: u32 = 4;

/// Error codes of VXI-11, table B.2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub(super) enum Fault {
    NotAccessible = 3,
    InvalidLink = 4,
    NotSupported = 8,
    OutOfResources = 9,
    LockedByAnother = 11,
    NoLock = 12,
    TimedOut = 15,
    Io = 17,
    Aborted = 23,
}

/// The parameters of a read.
#[derive(Debug, Clone, Copy)]
pub(super) struct ReadRequest {
    pub(super) most: usize,
    pub(super) until: Option<u8>,
    pub(super) deadline: Instant,
}

#[derive(Debug, Default)]
struct Queue {
    reply: Vec<u8>,
    given: usize,
    /// Messages received but not executed yet.
    pending: usize,
    /// Number of device clears: messages received before the last one get no reply.
    cleared: u64,
    lost: bool,
}

impl Queue {
    fn left(&self) -> &[u8] {
        &self.reply[self.given..]
    }

    fn empty(&mut self) {
        self.reply.clear();
        self.given = 0;
    }
}

/// The input of a link in the order of arrival (IEEE 488.2, 6.1.4): a trigger waits for the messages before it.
#[derive(Debug)]
enum Input {
    Message(Vec<u8>),
    Trigger,
}

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    changed: Notify,
    aborted: Notify,
    /// Signals a device clear to tasks that wait for the instrument.
    interrupted: Notify,
}

impl Shared {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Aborts the pending operation of a link, from another connection.
#[derive(Debug, Clone)]
pub(super) struct Aborter(Arc<Shared>);

impl Aborter {
    pub(super) fn abort(&self) {
        self.0.aborted.notify_waiters();
    }
}

/// A link with its buffers; it ends when it is dropped.
pub(super) struct Link<S: Session> {
    session: Arc<S>,
    framer: S::Framer,
    inputs: mpsc::Sender<(Input, u64)>,
    shared: Arc<Shared>,
    listener: JoinHandle<()>,
}

impl<S: Session> Link<S> {
    pub(super) fn new(session: S) -> Self {
        let framer = session.framer();
        let session = Arc::new(session);
        let shared = Arc::new(Shared::default());
        let (inputs, waiting) = mpsc::channel(WAITING);
        let listener = tokio::spawn(listen(session.clone(), shared.clone(), waiting));
        Self {
            session,
            framer,
            inputs,
            shared,
            listener,
        }
    }

    pub(super) fn aborter(&self) -> Aborter {
        Aborter(self.shared.clone())
    }

    pub(super) fn session(&self) -> &S {
        &self.session
    }

    /// Adds received bytes; with `end` a message ends after them, as after a line feed.
    pub(super) async fn write(
        &mut self,
        data: &[u8],
        end: bool,
        deadline: Instant,
    ) -> Result<(), Fault> {
        if self.session.is_silent() {
            return self.wait_out(deadline).await;
        }
        self.framer.push(data);
        if end && self.framer.is_partial() {
            self.framer.push(b"\n");
        }
        while let Some(message) = self.framer.next_message() {
            let Ok(message) = message else {
                self.session.refuse(Refusal::InputOverrun);
                continue;
            };
            if let Err(fault) = self.take_in(Input::Message(message), deadline).await {
                self.framer.clear();
                return Err(fault);
            }
        }
        Ok(())
    }

    /// A group execute trigger, executed after the messages that arrived before it. It discards no unread reply.
    pub(super) async fn trigger(&self, deadline: Instant) -> Result<(), Fault> {
        self.take_in(Input::Trigger, deadline).await
    }

    async fn take_in(&self, input: Input, deadline: Instant) -> Result<(), Fault> {
        let cleared = {
            let mut queue = self.shared.queue();
            queue.pending += 1;
            queue.cleared
        };
        let sent = tokio::select! {
            sent = timeout_at(deadline, self.inputs.send((input, cleared))) => {
                matches!(sent, Ok(Ok(()))).then_some(()).ok_or(Fault::TimedOut)
            }
            () = self.shared.aborted.notified() => Err(Fault::Aborted),
        };
        if sent.is_err() {
            self.shared.queue().pending -= 1;
        }
        sent
    }

    /// Returns the next bytes of the reply and the reason why the read ended.
    pub(super) async fn read(&self, request: ReadRequest) -> Result<(u32, Vec<u8>), Fault> {
        if self.session.is_silent() {
            self.wait_out(request.deadline).await?;
        }
        let mut waited = false;
        loop {
            let changed = self.shared.changed.notified();
            {
                let mut queue = self.shared.queue();
                if queue.lost {
                    return Err(Fault::Io);
                }
                if !queue.left().is_empty() {
                    return Ok(take(&mut queue, request));
                }
                if waited {
                    if queue.pending == 0 {
                        drop(queue);
                        self.session.refuse(Refusal::QueryUnterminated);
                    }
                    return Err(Fault::TimedOut);
                }
            }
            tokio::select! {
                ended = timeout_at(request.deadline, changed) => waited = ended.is_err(),
                () = self.shared.aborted.notified() => return Err(Fault::Aborted),
            }
        }
    }

    /// Whether an unread reply is available.
    pub(super) fn has_reply(&self) -> bool {
        !self.shared.queue().left().is_empty()
    }

    /// A device clear: discards input, output and the pending reply, and aborts the instrument's operations for this
    /// link.
    pub(super) async fn clear(&mut self) {
        self.framer.clear();
        {
            let mut queue = self.shared.queue();
            queue.cleared += 1;
            queue.empty();
        }
        self.shared.interrupted.notify_waiters();
        self.session.clear().await;
    }

    async fn wait_out(&self, deadline: Instant) -> Result<(), Fault> {
        tokio::select! {
            () = tokio::time::sleep_until(deadline) => Err(Fault::TimedOut),
            () = self.shared.aborted.notified() => Err(Fault::Aborted),
        }
    }
}

impl<S: Session> Drop for Link<S> {
    fn drop(&mut self) {
        self.listener.abort();
    }
}

/// Converts a timeout in milliseconds to a deadline.
pub(super) fn within(milliseconds: u32) -> Instant {
    Instant::now() + Duration::from_millis(u64::from(milliseconds))
}

fn take(queue: &mut Queue, request: ReadRequest) -> (u32, Vec<u8>) {
    let left = queue.left();
    let mut count = left.len().min(request.most);
    let mut reason = 0;
    if let Some(end) = request.until
        && let Some(at) = left[..count].iter().position(|byte| *byte == end)
    {
        count = at + 1;
        reason |= BY_CHARACTER;
    }
    if count == request.most {
        reason |= BY_COUNT;
    }
    if count == left.len() {
        reason |= BY_END;
    }
    let given = left[..count].to_vec();
    queue.given += count;
    (reason, given)
}

/// Executes a link's messages and triggers one after the other.
async fn listen<S: Session>(
    session: Arc<S>,
    shared: Arc<Shared>,
    mut inputs: mpsc::Receiver<(Input, u64)>,
) {
    while let Some((input, cleared)) = inputs.recv().await {
        // The notification is registered before the count is read, so that a clear in between is not missed.
        let clear = shared.interrupted.notified();
        tokio::pin!(clear);
        clear.as_mut().enable();
        let (message, interrupted) = {
            let mut queue = shared.queue();
            if queue.cleared != cleared {
                queue.pending -= 1;
                continue;
            }
            match input {
                Input::Trigger => (b"*TRG".to_vec(), false),
                Input::Message(message) => {
                    let unread = !queue.left().is_empty();
                    queue.empty();
                    (message, unread)
                }
            }
        };
        if interrupted {
            session.refuse(Refusal::QueryInterrupted);
        }
        // A message that has begun is executed to its end, so that a clear takes effect before it or after it.
        let reply = match session.begin(message).await {
            Err(fault) => Err(fault),
            Ok(received) => tokio::select! {
                biased;
                () = clear => {
                    session.clear().await;
                    Ok(Vec::new())
                }
                reply = session.finish(received) => Ok(reply),
            },
        };
        let mut queue = shared.queue();
        queue.pending -= 1;
        match reply {
            // A trigger has no reply, and does not discard an unread one.
            Ok(reply) if queue.cleared == cleared && !reply.is_empty() => {
                queue.reply = reply;
                queue.given = 0;
            }
            Ok(_) => {}
            Err(_) => queue.lost = true,
        }
        drop(queue);
        shared.changed.notify_waiters();
    }
}
