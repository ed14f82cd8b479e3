//! Many concurrent calls by several users, until stopped.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use dbus::BUS_NAME;
use tokio::task::JoinSet;
use zbus::Connection;
use zbus::message::Flags;

use crate::calls::Call;
use crate::site::within;
use crate::system_bus::SystemBus;
use crate::users::User;

/// Concurrency of a flood.
#[derive(Debug, Clone, Copy)]
pub struct Width {
    /// Connections of each user.
    pub connections: usize,
    /// Concurrent calls on each of them.
    pub at_once: usize,
}

/// A call without a reply in this time is abandoned: the next one follows on the same connection.
const PATIENCE: Duration = Duration::from_millis(500);

/// A running flood.
pub struct Flood {
    over: Arc<AtomicBool>,
    workers: JoinSet<()>,
    answers: Answers,
    /// Index of the next call, and number of calls.
    turn: Arc<AtomicUsize>,
    calls: usize,
}

/// Number of replies of each kind.
pub type Counts = BTreeMap<String, usize>;
type Answers = Arc<Mutex<Counts>>;

impl Flood {
    /// Starts sending these calls in turn, repeatedly, by each of the users.
    pub async fn begin(bus: &SystemBus, users: &[User], width: Width, calls: Vec<Call>) -> Self {
        let mut flood = Self {
            over: Arc::default(),
            workers: JoinSet::new(),
            answers: Arc::default(),
            turn: Arc::default(),
            calls: calls.len(),
        };
        let calls = Arc::new(calls);
        for user in users {
            for _ in 0..width.connections {
                let connection = user.come_to_bus(bus.socket()).await.unwrap();
                for _ in 0..width.at_once {
                    flood.workers.spawn(work(
                        connection.clone(),
                        Arc::clone(&calls),
                        Arc::clone(&flood.turn),
                        Arc::clone(&flood.over),
                        Arc::clone(&flood.answers),
                    ));
                }
            }
        }
        flood
    }

    /// Starts sending one call at the maximum rate, `width.at_once` at a time, without requesting replies.
    pub async fn begin_unanswered(
        bus: &SystemBus,
        users: &[User],
        width: Width,
        call: &Call,
    ) -> Self {
        let mut flood = Self {
            over: Arc::default(),
            workers: JoinSet::new(),
            answers: Arc::default(),
            turn: Arc::default(),
            calls: 0,
        };
        for user in users {
            for _ in 0..width.connections {
                let connection = user.come_to_bus(bus.socket()).await.unwrap();
                let message = zbus::Message::method_call(call.path.clone(), call.member.clone())
                    .destination(BUS_NAME)
                    .interface(call.interface.clone())
                    .with_flags(Flags::NO_REPLY_EXPECTED)
                    .build(&())
                    .unwrap();
                let messages = vec![message; width.at_once];
                let (over, answers) = (Arc::clone(&flood.over), Arc::clone(&flood.answers));
                flood.workers.spawn(async move {
                    while !over.load(Ordering::Relaxed) {
                        let kind = match connection.send_all(&messages).await {
                            Ok(()) => "sent".to_owned(),
                            Err(error) => kind(&error),
                        };
                        *answers.lock().unwrap().entry(kind).or_default() += messages.len();
                    }
                });
            }
        }
        flood
    }

    /// Waits until every call has been sent once.
    pub async fn has_gone_round(&self) {
        let round = async {
            while self.turn.load(Ordering::Relaxed) < self.calls {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        within(round).await;
    }

    /// Number of replies so far, of any kind.
    pub fn answered(&self) -> usize {
        self.answers.lock().unwrap().values().sum()
    }

    /// Stops it, closes its connections, and returns the counts of replies.
    pub async fn end(mut self) -> Counts {
        self.over.store(true, Ordering::Relaxed);
        while let Some(worker) = self.workers.join_next().await {
            worker.unwrap();
        }
        std::mem::take(&mut self.answers.lock().unwrap())
    }
}

async fn work(
    connection: Connection,
    calls: Arc<Vec<Call>>,
    turn: Arc<AtomicUsize>,
    over: Arc<AtomicBool>,
    answers: Answers,
) {
    while !over.load(Ordering::Relaxed) {
        let call = &calls[turn.fetch_add(1, Ordering::Relaxed) % calls.len()];
        let kind = match tokio::time::timeout(PATIENCE, send(&connection, call)).await {
            Ok(Ok(())) => "answered".to_owned(),
            Ok(Err(error)) => kind(&error),
            Err(_) => "not answered in time".to_owned(),
        };
        *answers.lock().unwrap().entry(kind).or_default() += 1;
    }
}

async fn send(connection: &Connection, call: &Call) -> zbus::Result<()> {
    let (path, interface, member) = (
        call.path.as_str(),
        call.interface.as_str(),
        call.member.as_str(),
    );
    let sent = match &call.body {
        Some(body) => {
            connection
                .call_method(Some(BUS_NAME), path, Some(interface), member, body)
                .await
        }
        None => {
            connection
                .call_method(Some(BUS_NAME), path, Some(interface), member, &())
                .await
        }
    };
    sent.map(|_| ())
}

/// The name of an error, without its text.
fn kind(error: &zbus::Error) -> String {
    use zbus::DBusError;
    match error {
        zbus::Error::MethodError(name, _, _) => name.to_string(),
        zbus::Error::FDO(error) => error.name().to_string(),
        other => other.to_string(),
    }
}
