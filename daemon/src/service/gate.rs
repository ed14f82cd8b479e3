//! The gate of one connection: identifies callers, detects when they disconnect, and selects the threads that serve a
//! call.
//!
//! A call that reads or waits is cancelled when its caller leaves the bus, or the peer's connection ends, and frees its
//! place in the limits. A call that changes something runs to its end once started: cancelled half-way, it could leave
//! the rig or the record inconsistent.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use dbus::Fault;
use tokio::runtime::{Builder, Handle, Runtime};
use tokio::sync::{OnceCell, Semaphore, watch};
use tokio::task::JoinSet;
use zbus::message::{Header, Type};
use zbus::names::UniqueName;
use zbus::{Connection, MatchRule, MessageStream};

use super::bus_socket::Queue;
use super::caller::{self, Caller};
use super::limit::User;

use crate::locked::locked;

/// Threads for each connection type: one may be busy with a long reply while the other continues.
const THREADS: usize = 2;

/// Type of a connection, which determines how access is decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Authorizer {
    /// The peer socket: other users than root, the daemon's own user and the group are rejected on connecting.
    Peer,
    /// The session bus: root and the daemon's own user.
    Session,
    /// The system bus: polkit decides; without polkit, root, the daemon's own user and the group have access.
    System,
}

/// The gate of one connection.
#[derive(Debug)]
pub(crate) struct Gate {
    pub(super) authorizer: Authorizer,
    /// Runtime of the sessions.
    acting: Handle,
    /// Connected callers, by unique name.
    present: Mutex<BTreeMap<String, Present>>,
    /// Whether disconnects are being followed.
    follows: watch::Sender<bool>,
    /// Queue of calls read ahead from a bus.
    waiting: Option<Arc<Queue>>,
    /// Serialises large replies, which would delay the replies to all callers.
    pub(super) large_answers: Semaphore,
}

/// A connected caller.
#[derive(Debug)]
struct Present {
    caller: Arc<OnceCell<Arc<Caller>>>,
    /// Dropped when the caller disconnects.
    presence: watch::Sender<()>,
}

impl Present {
    fn new(caller: OnceCell<Arc<Caller>>) -> Self {
        Self {
            caller: Arc::new(caller),
            presence: watch::Sender::new(()),
        }
    }
}

/// The caller of one call.
#[derive(Debug)]
pub(super) struct Client {
    pub(super) caller: Arc<Caller>,
    /// The user for limits.
    pub(super) user: User,
    presence: watch::Receiver<()>,
}

impl Client {
    fn new(caller: Arc<Caller>, presence: &watch::Sender<()>) -> Self {
        Self {
            user: caller.counted(),
            caller,
            presence: presence.subscribe(),
        }
    }

    /// Awaits a future as long as the caller is connected; `None` if it disconnected first.
    pub(super) async fn while_present<T>(&self, future: impl Future<Output = T>) -> Option<T> {
        let mut presence = self.presence.clone();
        tokio::select! {
            biased;
            done = future => Some(done),
            _ = presence.changed() => None,
        }
    }
}

impl Gate {
    /// The gate of a connection to a bus; `acting` is the runtime of the sessions, and `waiting` the queue of calls
    /// read ahead. No call is served before [`Gate::follow`].
    pub(super) fn of_bus(
        authorizer: Authorizer,
        acting: Handle,
        waiting: Option<Arc<Queue>>,
    ) -> Arc<Self> {
        Arc::new(Self {
            authorizer,
            acting,
            present: Mutex::default(),
            follows: watch::Sender::new(false),
            waiting,
            large_answers: Semaphore::new(1),
        })
    }

    /// The gate of a connection to the peer socket, until [`Gate::all_left`].
    pub(super) fn of_peer(caller: Caller, acting: Handle) -> Arc<Self> {
        let peer = Present::new(OnceCell::new_with(Some(Arc::new(caller))));
        Arc::new(Self {
            authorizer: Authorizer::Peer,
            acting,
            present: Mutex::new(BTreeMap::from([(String::new(), peer)])),
            follows: watch::Sender::new(true),
            waiting: None,
            large_answers: Semaphore::new(1),
        })
    }

    /// Follows callers that leave the bus, until the task is dropped or the connection to the bus ends.
    ///
    /// # Errors
    /// The bus refuses the subscription.
    pub(super) async fn follow(
        self: &Arc<Self>,
        connection: &Connection,
    ) -> zbus::Result<JoinSet<()>> {
        let rule = MatchRule::builder()
            .msg_type(Type::Signal)
            .sender("org.freedesktop.DBus")
            .interface("org.freedesktop.DBus")
            .member("NameOwnerChanged")
            .build()?;
        let mut changes = MessageStream::for_match_rule(rule, connection, None).await?;
        let gate = Arc::downgrade(self);
        let mut task = JoinSet::new();
        task.spawn(async move {
            while let Some(Ok(change)) = dbus::next(&mut changes).await {
                let Some(gate) = gate.upgrade() else { return };
                let body = change.body();
                if let Ok((name, _, owner)) = body.deserialize::<(&str, &str, &str)>()
                    && owner.is_empty()
                {
                    locked(&gate.present).remove(name);
                    if let Some(waiting) = &gate.waiting {
                        waiting.forget(name);
                    }
                }
            }
            if let Some(gate) = gate.upgrade() {
                gate.all_left();
            }
        });
        self.follows.send_replace(true);
        Ok(task)
    }

    /// Removes all callers, because the connection has ended.
    pub(super) fn all_left(&self) {
        locked(&self.present).clear();
    }

    /// Description of the sender of a message, for the record.
    ///
    /// # Errors
    /// As [`Gate::client`].
    pub(super) async fn caller_words(
        &self,
        connection: &Connection,
        header: &Header<'_>,
    ) -> Result<String, Fault> {
        Ok(match self.client(connection, header).await? {
            Some(client) => format!("user {}", client.caller.user()),
            None => "a caller that has disconnected".to_owned(),
        })
    }

    /// The sender of a message; `None` if it has already disconnected.
    ///
    /// # Errors
    /// The message or the bus does not identify the sender.
    pub(super) async fn client(
        &self,
        connection: &Connection,
        header: &Header<'_>,
    ) -> Result<Option<Client>, Fault> {
        if self.authorizer == Authorizer::Peer {
            let present = locked(&self.present);
            let Some(peer) = present.get("") else {
                return Ok(None);
            };
            let caller = peer.caller.get().map(Arc::clone);
            return Ok(caller.map(|caller| Client::new(caller, &peer.presence)));
        }
        let sender = header
            .sender()
            .ok_or_else(|| refusal("the message has no sender"))?;
        let mut follows = self.follows.subscribe();
        if follows.wait_for(|follows| *follows).await.is_err() {
            return Ok(None);
        }
        // registered before the bus is queried, so that a later disconnect is noticed
        let (cell, presence) = {
            let mut present = locked(&self.present);
            let known = present
                .entry(sender.to_string())
                .or_insert_with(|| Present::new(OnceCell::new()));
            (Arc::clone(&known.caller), known.presence.subscribe())
        };
        match cell.get_or_try_init(|| ask(connection, sender)).await {
            Ok(caller) => {
                let user = caller.counted();
                if let Some(waiting) = &self.waiting
                    && user.trusted
                    && presence.has_changed().is_ok()
                {
                    waiting.prefer(sender);
                }
                Ok(Some(Client {
                    user,
                    caller: Arc::clone(caller),
                    presence,
                }))
            }
            Err(error) => {
                locked(&self.present).remove(sender.as_str());
                tracing::debug!("the bus did not identify {sender}: {error}");
                Err(refusal(&format!(
                    "the bus did not identify the caller: {error}"
                )))
            }
        }
    }

    /// Runs the reply on this thread, and everything that it starts (tasks, timers, blocking work) on the runtime of
    /// the sessions.
    pub(super) async fn acting<T>(&self, answered: impl Future<Output = T>) -> T {
        let mut answered = std::pin::pin!(answered);
        std::future::poll_fn(|context| {
            let _entered = self.acting.enter();
            answered.as_mut().poll(context)
        })
        .await
    }
}

fn refusal(why: &str) -> Fault {
    Fault::NotAuthorized(why.to_owned())
}

async fn ask(connection: &Connection, sender: &UniqueName<'_>) -> zbus::Result<Arc<Caller>> {
    caller::of(connection, sender).await.map(Arc::new)
}

/// Threads that serve clients, separate from those of the sessions: busy clients delay each other, but no frame.
#[derive(Debug)]
pub(super) struct Threads {
    handle: Handle,
    runtime: Option<Runtime>,
}

impl Threads {
    /// Starts the threads.
    ///
    /// # Errors
    /// No thread can be started.
    pub(super) fn start(name: &str) -> std::io::Result<Self> {
        let runtime = Builder::new_multi_thread()
            .thread_name(name)
            .worker_threads(THREADS)
            .max_blocking_threads(THREADS)
            .on_thread_start(crate::panics::containment::mark_thread)
            .enable_all()
            .build()?;
        Ok(Self {
            handle: runtime.handle().clone(),
            runtime: Some(runtime),
        })
    }

    pub(super) fn handle(&self) -> &Handle {
        &self.handle
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}
