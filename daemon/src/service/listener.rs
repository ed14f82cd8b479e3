//! Serves the daemon on all configured connections.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::events::kind::EventKind;
use dbus::BUS_NAME;
use tokio::runtime::Handle;
use tokio::task::JoinSet;
use zbus::Connection;
use zbus::connection::Builder;
use zbus::fdo::{RequestNameFlags, RequestNameReply};

use crate::monitoring::heartbeat::Part;
use crate::panics::containment::{PanicScope, answer};
use crate::service::access;
use crate::service::bus_socket::{BusSocket, Queue};
use crate::service::gate::{Authorizer, Gate, Threads};
use crate::service::peer;
use crate::session::controller::Controller;
use config::BusSection;

/// First and longest time between attempts to reconnect to a bus.
const RECONNECT_INTERVALS: (Duration, Duration) =
    (Duration::from_millis(200), Duration::from_secs(5));

/// Timeout of connecting to a bus.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// The served connections, closed when dropped.
#[derive(Debug)]
pub(crate) struct Listener {
    tasks: JoinSet<()>,
    _threads: [Threads; 2],
    /// Description for people.
    pub descriptions: Vec<String>,
}

/// Why a connection cannot be served.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ListenerError {
    #[error("the peer socket {} cannot be opened: {cause}", .path.display())]
    Peer {
        path: PathBuf,
        cause: std::io::Error,
    },
    #[error("the threads that serve clients cannot be started: {0}")]
    Threads(std::io::Error),
    #[error("the {which} bus is configured, but not available: {cause}")]
    NoBus {
        which: &'static str,
        cause: zbus::Error,
    },
    #[error("{BUS_NAME} on the {which} bus is owned already; is another tactusd running?")]
    Owned { which: &'static str },
}

impl Listener {
    /// Opens every configured connection; fails if one cannot be opened.
    pub(crate) async fn open(
        section: &BusSection,
        controller: &Arc<Controller>,
    ) -> Result<Self, ListenerError> {
        let mut tasks = JoinSet::new();
        let mut descriptions = Vec::new();
        // sessions run on this runtime; clients are served on separate threads, one set for the peer socket and one for
        // the buses
        let acting = Handle::current();
        let threads = [
            Threads::start("peer").map_err(ListenerError::Threads)?,
            Threads::start("bus").map_err(ListenerError::Threads)?,
        ];
        let [peers, buses] = [threads[0].handle(), threads[1].handle()];
        if section.peer
            && let Some(path) = &section.peer_path
        {
            let _entered = peers.enter();
            let listener = peer::bind(path).map_err(|cause| ListenerError::Peer {
                path: path.clone(),
                cause,
            })?;
            let served = peer::serve(listener, Arc::clone(controller), acting.clone());
            tasks.spawn_on(served, peers);
            descriptions.push(format!("unix:{}", path.display()));
        }
        for (authorizer, wanted) in [
            (Authorizer::Session, section.session),
            (Authorizer::System, section.system),
        ] {
            if wanted {
                let (held, home) = (Arc::clone(controller), acting.clone());
                let connected = buses.spawn(async move { connect(authorizer, &held, &home).await });
                let no_bus = |_| ListenerError::Threads(std::io::ErrorKind::Interrupted.into());
                let connection = connected.await.map_err(no_bus)??;
                let serving = serve_bus(
                    authorizer,
                    connection,
                    Arc::clone(controller),
                    acting.clone(),
                );
                tasks.spawn_on(serving, buses);
                descriptions.push(word(authorizer).to_owned());
            }
        }
        Ok(Self {
            tasks,
            _threads: threads,
            descriptions,
        })
    }

    /// Closes all connections; nothing is left when this returns.
    pub(crate) async fn close(mut self) {
        self.tasks.shutdown().await;
    }
}

fn word(authorizer: Authorizer) -> &'static str {
    match authorizer {
        Authorizer::Peer => "peer",
        Authorizer::Session => "session",
        Authorizer::System => "system",
    }
}

/// A connection to a bus, its gate, and the task that follows disconnects.
struct Connected {
    connection: Connection,
    gate: Arc<Gate>,
    _follows: JoinSet<()>,
}

/// Connects, registers all objects, and only then requests the name.
async fn connect(
    authorizer: Authorizer,
    controller: &Arc<Controller>,
    acting: &Handle,
) -> Result<Connected, ListenerError> {
    let which = word(authorizer);
    let no_bus = |cause| ListenerError::NoBus { which, cause };
    let (builder, waiting) = match authorizer {
        Authorizer::System => system_bus(controller).await.map_err(no_bus)?,
        _ => (Builder::session(), None),
    };
    let gate = Gate::of_bus(authorizer, acting.clone(), waiting);
    let connection = crate::service::register_objects(builder, controller, &gate)
        .build()
        .await
        .map_err(no_bus)?;
    let connected = Connected {
        _follows: gate.follow(&connection).await.map_err(no_bus)?,
        connection,
        gate,
    };
    let connection = &connected.connection;
    // neither replaceable nor replacing: a second daemon must not take over the name
    let flags = RequestNameFlags::DO_NOT_QUEUE;
    match connection.request_name_with_flags(BUS_NAME, flags).await {
        Ok(RequestNameReply::PrimaryOwner | RequestNameReply::AlreadyOwner) => Ok(connected),
        Ok(RequestNameReply::Exists | RequestNameReply::InQueue) | Err(zbus::Error::NameTaken) => {
            Err(ListenerError::Owned { which })
        }
        Err(cause) => Err(no_bus(cause)),
    }
}

/// The system bus, on which any user may send calls: reads them ahead.
async fn system_bus(
    controller: &Arc<Controller>,
) -> zbus::Result<(Builder<'static>, Option<Arc<Queue>>)> {
    let address = zbus::Address::system()?;
    let queue = Arc::new(Queue::new(access::changes_something));
    let events = controller.events.clone();
    let report = move |lost: u64, sender: &str| {
        let text = format!(
            "{lost} calls without a requested reply were discarded, the last from {sender}: too many are waiting"
        );
        events.journal(EventKind::CallsLost, &text);
    };
    let socket = BusSocket::connect(&address, Arc::clone(&queue), Box::new(report)).await?;
    Ok(match socket {
        Some(socket) => (Builder::socket(socket), Some(queue)),
        None => (Builder::address(address), None),
    })
}

/// Announces events on one bus, and reconnects when the bus is restarted.
async fn serve_bus(
    authorizer: Authorizer,
    mut connected: Connected,
    controller: Arc<Controller>,
    acting: Handle,
) {
    let which = word(authorizer);
    let mut events = controller.events.subscribe();
    let part = match which {
        "system" => Part::SystemBus,
        _ => Part::SessionBus,
    };
    loop {
        let Connected {
            connection, gate, ..
        } = &connected;
        loop {
            tokio::select! {
                () = connection.closed() => break,
                event = events.recv() => {
                    let Some(event) = event else { return };
                    let sent = crate::service::announce(connection, &controller, gate, event);
                    if !matches!(answer(PanicScope::Reply, sent).await, Ok(true)) {
                        break;
                    }
                    controller.heartbeats.set_idle(part);
                }
            }
        }
        let _ =
            tokio::time::timeout(crate::service::SEND_TIMEOUT, connection.clone().close()).await;
        gate.all_left();
        tracing::warn!("the connection to the {which} bus is lost; acquisition continues");
        let mut pause = RECONNECT_INTERVALS.0;
        connected = loop {
            tokio::time::sleep(pause).await;
            controller.heartbeats.set_idle(part);
            pause = (pause * 2).min(RECONNECT_INTERVALS.1);
            events = controller.events.subscribe();
            // a frozen bus does not reply at all
            let again =
                tokio::time::timeout(CONNECT_TIMEOUT, connect(authorizer, &controller, &acting));
            let again = match answer(PanicScope::Reply, again).await {
                Ok(again) => again,
                // the panic has been logged
                Err(_) => continue,
            };
            match again {
                Ok(Ok(connected)) => break connected,
                Ok(Err(error)) => tracing::debug!("{error}"),
                Err(_) => tracing::debug!("the {which} bus does not reply"),
            }
        };
        tracing::info!("the {which} bus is back");
    }
}
