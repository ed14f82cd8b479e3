//! Offers the daemon on the ways that the configuration names.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use bus::BUS_NAME;
use tokio::task::JoinSet;
use zbus::Connection;
use zbus::connection::Builder;
use zbus::fdo::{RequestNameFlags, RequestNameReply};

use super::access::Door;
use super::peer;
use crate::config::BusSection;
use crate::keeper::Keeper;
use crate::pulse::Part;

/// A bus that went away is looked for again after so long, and then ever less often up to the second value.
const LOOK_AGAIN: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(5));

/// A bus that takes longer is frozen.
const TO_CONNECT: Duration = Duration::from_secs(5);

/// The ways on which the daemon is offered, until dropped.
#[derive(Debug)]
pub(crate) struct Offer {
    _tasks: JoinSet<()>,
    /// For a person.
    pub ways: Vec<String>,
}

/// Why it cannot be offered.
#[derive(Debug, thiserror::Error)]
pub(crate) enum OfferError {
    #[error("the peer socket {} cannot be opened: {cause}", .path.display())]
    Peer {
        path: PathBuf,
        cause: std::io::Error,
    },
    #[error("the {which} bus was asked for and is not there: {cause}")]
    NoBus {
        which: &'static str,
        cause: zbus::Error,
    },
    #[error("{BUS_NAME} on the {which} bus is owned already; is another tactusd running?")]
    Owned { which: &'static str },
}

impl Offer {
    /// Opens every way that is configured; one that cannot be opened is an error.
    pub(crate) async fn open(
        section: &BusSection,
        keeper: &Arc<Keeper>,
    ) -> Result<Self, OfferError> {
        let mut tasks = JoinSet::new();
        let mut ways = Vec::new();
        if section.peer
            && let Some(path) = &section.peer_path
        {
            let listener = peer::bind(path).map_err(|cause| OfferError::Peer {
                path: path.clone(),
                cause,
            })?;
            tasks.spawn(peer::serve(listener, Arc::clone(keeper)));
            ways.push(format!("unix:{}", path.display()));
        }
        for (door, wanted) in [
            (Door::Session, section.session),
            (Door::System, section.system),
        ] {
            if wanted {
                let connection = connect(door, keeper).await?;
                tasks.spawn(stay(door, connection, Arc::clone(keeper)));
                ways.push(word(door).to_owned());
            }
        }
        Ok(Self {
            _tasks: tasks,
            ways,
        })
    }
}

fn word(door: Door) -> &'static str {
    match door {
        Door::Peer => "peer",
        Door::Session => "session",
        Door::System => "system",
    }
}

/// Connects, puts everything there, and only then asks for the name.
async fn connect(door: Door, keeper: &Arc<Keeper>) -> Result<Connection, OfferError> {
    let which = word(door);
    let no_bus = |cause| OfferError::NoBus { which, cause };
    let builder = match door {
        Door::System => Builder::system(),
        _ => Builder::session(),
    };
    let connection = super::furnish(builder, keeper, door)
        .build()
        .await
        .map_err(no_bus)?;
    // neither replaceable nor replacing: a second daemon must not steal the name
    let flags = RequestNameFlags::DO_NOT_QUEUE;
    match connection.request_name_with_flags(BUS_NAME, flags).await {
        Ok(RequestNameReply::PrimaryOwner | RequestNameReply::AlreadyOwner) => Ok(connection),
        Ok(RequestNameReply::Exists | RequestNameReply::InQueue) | Err(zbus::Error::NameTaken) => {
            Err(OfferError::Owned { which })
        }
        Err(cause) => Err(no_bus(cause)),
    }
}

/// Carries news to one bus, and comes back when the bus does.
async fn stay(door: Door, mut connection: Connection, keeper: Arc<Keeper>) {
    let which = word(door);
    let mut news = keeper.herald.listen();
    let part = match which {
        "system" => Part::SystemBus,
        _ => Part::SessionBus,
    };
    loop {
        loop {
            tokio::select! {
                () = connection.closed() => break,
                notice = news.recv() => {
                    let Some(notice) = notice else { return };
                    if !super::say(&connection, &keeper, door, notice).await {
                        break;
                    }
                    keeper.pulse.rest(part);
                }
            }
        }
        let _ = tokio::time::timeout(super::TO_SAY, connection.close()).await;
        tracing::warn!("the {which} bus is gone; acquisition goes on");
        let mut pause = LOOK_AGAIN.0;
        connection = loop {
            tokio::time::sleep(pause).await;
            keeper.pulse.rest(part);
            pause = (pause * 2).min(LOOK_AGAIN.1);
            news = keeper.herald.listen();
            // a bus that is there and frozen does not answer at all
            match tokio::time::timeout(TO_CONNECT, connect(door, &keeper)).await {
                Ok(Ok(connection)) => break connection,
                Ok(Err(error)) => tracing::debug!("{error}"),
                Err(_) => tracing::debug!("the {which} bus does not answer"),
            }
        };
        tracing::info!("the {which} bus is back");
    }
}
