//! The gate in front of the objects of one connection: who calls, whether the caller is still there, on which threads the
//! call is answered.
//!
//! A call that looks or waits ends when its caller leaves the bus, or the peer's connection ends, and gives its place
//! back. A call that changes something runs to its end once it has begun: dropped half-way it would leave the rig or the
//! record in between.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

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

/// Threads for each way to the daemon: one may be busy with a long answer and another goes on.
const THREADS: usize = 2;

/// The way on which a caller came, and with it who decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Authorizer {
    /// The peer socket: whoever is not root, the daemon's own user or of the group was turned away before a word.
    Peer,
    /// The session bus: root and the daemon's own user.
    Session,
    /// The system bus: polkit decides; where there is none, root, the daemon's own user and the group.
    System,
}

/// The gate of one connection.
#[derive(Debug)]
pub(crate) struct Gate {
    pub(super) authorizer: Authorizer,
    /// Where sessions run.
    acting: Handle,
    /// Who has called and has not left, by unique name.
    present: Mutex<BTreeMap<String, Present>>,
    /// Whether those who leave are heard of.
    follows: watch::Sender<bool>,
    /// Where calls wait that were read from a bus ahead of being served.
    waiting: Option<Arc<Queue>>,
    /// Whose turn it is to send a large answer: everybody's answers stand behind it.
    pub(super) large_answers: Semaphore,
}

/// Somebody who has called and has not left.
#[derive(Debug)]
struct Present {
    caller: Arc<OnceCell<Arc<Caller>>>,
    /// Dropped when they leave.
    stays: watch::Sender<()>,
}

impl Present {
    fn new(caller: OnceCell<Arc<Caller>>) -> Self {
        Self {
            caller: Arc::new(caller),
            stays: watch::Sender::new(()),
        }
    }
}

/// The caller of one call.
#[derive(Debug)]
pub(super) struct Client {
    pub(super) caller: Arc<Caller>,
    /// As its places are counted.
    pub(super) user: User,
    stays: watch::Receiver<()>,
}

impl Client {
    fn new(caller: Arc<Caller>, stays: &watch::Sender<()>) -> Self {
        Self {
            user: caller.counted(),
            caller,
            stays: stays.subscribe(),
        }
    }

    /// Awaits something, no longer than the caller is there; `None` where it left first.
    pub(super) async fn while_present<T>(&self, future: impl Future<Output = T>) -> Option<T> {
        let mut stays = self.stays.clone();
        tokio::select! {
            biased;
            done = future => Some(done),
            _ = stays.changed() => None,
        }
    }
}

impl Gate {
    /// The gate of a connection to a bus; `acting` is where sessions run, and `waiting` has the calls that were read ahead. Nobody is
    /// answered before [`Gate::follow`].
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

    fn present(&self) -> MutexGuard<'_, BTreeMap<String, Present>> {
        self.present.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Hears who leaves the bus, until the task is dropped or the bus is gone.
    ///
    /// # Errors
    /// The bus does not tell.
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
                    gate.present().remove(name);
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

    /// The connection has ended: nobody is there any more.
    pub(super) fn all_left(&self) {
        self.present().clear();
    }

    /// Who sent a message; `None` where they have left already.
    ///
    /// # Errors
    /// The message or the bus does not say who.
    pub(super) async fn client(
        &self,
        connection: &Connection,
        header: &Header<'_>,
    ) -> Result<Option<Client>, Fault> {
        if self.authorizer == Authorizer::Peer {
            let present = self.present();
            let Some(peer) = present.get("") else {
                return Ok(None);
            };
            let caller = peer.caller.get().map(Arc::clone);
            return Ok(caller.map(|caller| Client::new(caller, &peer.stays)));
        }
        let sender = header
            .sender()
            .ok_or_else(|| refusal("the message does not say who sends it"))?;
        let mut follows = self.follows.subscribe();
        if follows.wait_for(|follows| *follows).await.is_err() {
            return Ok(None);
        }
        // there before the bus is asked: who leaves after its answer is heard of and taken out
        let (cell, stays) = {
            let mut present = self.present();
            let known = present
                .entry(sender.to_string())
                .or_insert_with(|| Present::new(OnceCell::new()));
            (Arc::clone(&known.caller), known.stays.subscribe())
        };
        match cell.get_or_try_init(|| ask(connection, sender)).await {
            Ok(caller) => {
                let user = caller.counted();
                if let Some(waiting) = &self.waiting
                    && user.trusted
                    && stays.has_changed().is_ok()
                {
                    waiting.prefer(sender);
                }
                Ok(Some(Client {
                    user,
                    caller: Arc::clone(caller),
                    stays,
                }))
            }
            Err(error) => {
                self.present().remove(sender.as_str());
                tracing::debug!("the bus does not say who {sender} is: {error}");
                Err(refusal(&format!("the bus does not say who asks: {error}")))
            }
        }
    }

    /// Answers on this thread, and starts whatever the answer starts (tasks, timers, work that blocks) where sessions
    /// run.
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

/// Threads that speak with clients, apart from those on which sessions run: clients that keep them busy hold up one
/// another, and no frame.
#[derive(Debug)]
pub(super) struct Threads {
    handle: Handle,
    runtime: Option<Runtime>,
}

impl Threads {
    /// Starts them.
    ///
    /// # Errors
    /// The system gives no more threads.
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
