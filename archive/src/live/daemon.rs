//! Queries the daemon over its bus: periodically, and immediately after an event.

use std::pin::pin;
use std::time::Duration;

use dbus::{Address, Alarms1Proxy, Fault, HappenedStream, Manager1Proxy, Session1Proxy};
use tokio::time::{Instant, sleep, sleep_until, timeout};
use zbus::Connection;

use super::latest::Latest;
use super::topics::{Reported, Topics};

/// Timeout of a reply of the daemon.
const PATIENCE: Duration = Duration::from_secs(5);
/// Wait before a reconnection.
const RETRY: Duration = Duration::from_secs(5);
/// Minimum time between two updates caused by events.
const AT_MOST: Duration = Duration::from_secs(1);

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Keeps the messages up to date, for ever.
pub(super) async fn observe(
    address: &Address,
    every: Duration,
    mut topics: Topics,
    latest: &Latest,
) {
    loop {
        let why = match connected(address, every, &mut topics, latest).await {
            Ok(()) => format!("the daemon at {address} has ended"),
            Err(fault) => survey::error_chain(&*fault),
        };
        latest.replace(topics.without_daemon(&why));
        sleep(RETRY).await;
    }
}

/// Serves one connection until it ends.
async fn connected(
    address: &Address,
    every: Duration,
    topics: &mut Topics,
    latest: &Latest,
) -> Result<(), Failure> {
    let late = |_| {
        format!(
            "the daemon at {address} did not reply within {} s",
            PATIENCE.as_secs()
        )
    };
    let (connection, _) = timeout(PATIENCE, dbus::connect(Some(address)))
        .await
        .map_err(late)??;
    let manager: Manager1Proxy<'_> = dbus::proxy(&connection, dbus::ROOT_PATH).await?;
    let alarms = Alarms1Proxy::new(&connection).await?;
    let mut events = manager.receive_happened().await?;
    loop {
        let began = Instant::now();
        let asked = timeout(PATIENCE, ask(address, &connection, &manager, &alarms));
        let mut asked = pin!(asked);
        let mut due = began + every;
        // events are read while the reply is pending, because an unread event would delay it
        let reported = loop {
            tokio::select! {
                reported = &mut asked => break reported.map_err(late)??,
                event = dbus::next(&mut events) => match event {
                    None => return Ok(()),
                    Some(_) => due = began + AT_MOST,
                },
            }
        };
        latest.replace(topics.messages(reported));
        if !wait(&mut events, began, due).await {
            return Ok(());
        }
    }
}

/// Waits until `due`, or shortly after an event; returns whether the connection still exists.
async fn wait(events: &mut HappenedStream, began: Instant, mut due: Instant) -> bool {
    loop {
        tokio::select! {
            () = sleep_until(due) => return true,
            event = dbus::next(events) => match event {
                None => return false,
                Some(_) => due = due.min(began + AT_MOST),
            },
        }
    }
}

async fn ask(
    address: &Address,
    connection: &Connection,
    manager: &Manager1Proxy<'_>,
    alarms: &Alarms1Proxy<'_>,
) -> Result<Reported, Failure> {
    let status = manager.status().await?;
    let session = status
        .session
        .as_ref()
        .and_then(|session| session.id.clone());
    let quantities = match session {
        // the session may have ended since, have no map yet, or be a baseline
        Some(id) => {
            let session: Session1Proxy<'_> =
                dbus::proxy(connection, dbus::session_path(&id)?).await?;
            Fault::available(session.quantities().await)?.map(|found| (id, found))
        }
        None => None,
    };
    Ok(Reported {
        daemon: address.to_string(),
        status,
        alarms: alarms.list().await?,
        quantities,
    })
}
