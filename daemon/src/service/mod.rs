//! The daemon on D-Bus: the same objects on every connection, and the announcement of events. The operations themselves
//! are in `session`.

mod access;
mod bus_socket;
mod caller;
mod gate;
pub(crate) mod limit;
mod listener;
pub(crate) mod objects;
mod peer;
mod polkit;
pub(crate) mod read_pool;

use std::sync::Arc;
use std::time::Duration;

use dbus::{EventDetails, ROOT_PATH};
use zbus::connection::Builder;
use zbus::object_server::{InterfaceRef, ObjectServer};
use zbus::{Connection, fdo::ObjectManager};

use crate::events::event::BusEvent;
use crate::instruments::identities::ROLES;
use crate::recording::session_status::SessionStatus;
use crate::service::objects::alarms1::Alarms1;
use crate::service::objects::instrument1::Instrument1;
use crate::service::objects::manager1::{Manager1, Manager1Signals};
use crate::service::objects::session1::{Session1, Session1Signals};
use crate::service::objects::simulation1::Simulation1;
use crate::session::controller::Controller;
use access::Guarded;
use gate::{Authorizer, Gate};

pub(crate) use crate::service::listener::Listener;

/// Timeout of sending an event; a slow client is disconnected, so that it does not delay others.
const SEND_TIMEOUT: Duration = Duration::from_millis(500);

/// The same for a bus, which is one connection for all its users: an event waits behind their replies, and leaving the
/// bus would lose the reply to a stop. The broker does not stop reading; a dead one is detected by this, well within
/// systemd's timeout.
const BUS_SEND_TIMEOUT: Duration = Duration::from_secs(5);

/// Registers the manager, the alarms, the instruments and the sessions on a connection before it receives anything.
fn register_objects<'a>(
    mut builder: Builder<'a>,
    controller: &Arc<Controller>,
    gate: &Arc<Gate>,
) -> Builder<'a> {
    let manager = Guarded::new(Manager1(Arc::clone(controller), Arc::clone(gate)), gate);
    let alarms = Guarded::new(Alarms1(Arc::clone(controller), Arc::clone(gate)), gate);
    builder = builder
        .serve_at(ROOT_PATH, ObjectManager)
        .serve_at(ROOT_PATH, manager)
        .serve_at(ROOT_PATH, alarms);
    if controller.runtime().simulated_rig.is_some() {
        let simulation = Guarded::new(Simulation1(Arc::clone(controller)), gate);
        builder = builder.serve_at(ROOT_PATH, simulation);
    }
    for found in controller.identities().instruments {
        let instrument = Instrument1::new(Arc::clone(controller), found.role);
        builder = builder.serve_at(instrument.path(), Guarded::new(instrument, gate));
    }
    for status in controller.sessions() {
        if let Ok(path) = dbus::session_path(&status.facts.id) {
            builder = builder.serve_at(path, Guarded::new(Session1(status), gate));
        }
    }
    builder
}

/// Registers a session on a connection, if it is not registered yet.
async fn show(
    server: &ObjectServer,
    status: &Arc<SessionStatus>,
    gate: &Arc<Gate>,
) -> zbus::Result<()> {
    if let Ok(path) = dbus::session_path(&status.facts.id) {
        let session = Guarded::new(Session1(Arc::clone(status)), gate);
        server.at(path, session).await?;
    }
    Ok(())
}

/// Announces one event on a connection; `false` if the connection is broken.
async fn announce(
    connection: &Connection,
    controller: &Arc<Controller>,
    gate: &Arc<Gate>,
    event: BusEvent,
) -> bool {
    let patience = match gate.authorizer {
        Authorizer::Peer => SEND_TIMEOUT,
        Authorizer::Session | Authorizer::System => BUS_SEND_TIMEOUT,
    };
    let server = connection.object_server();
    let sent = tokio::time::timeout(patience, async {
        match event {
            BusEvent::SessionAdded(id) => session(server, controller, &id, gate).await.map(drop),
            BusEvent::SessionRemoved(id) => match dbus::session_path(&id) {
                Ok(path) => gone(server.remove::<Guarded<Session1>, _>(path).await),
                Err(_) => Ok(()),
            },
            BusEvent::SessionChanged(id) => match session(server, controller, &id, gate).await? {
                Some(session) => session_changed(&session).await,
                None => Ok(()),
            },
            BusEvent::FrameDone(frame) => {
                match session(server, controller, &frame.session, gate).await? {
                    Some(session) => {
                        session
                            .signal_emitter()
                            .frame_done(frame.sequence, frame.wall_ns, &frame.summary)
                            .await
                    }
                    None => Ok(()),
                }
            }
            BusEvent::Daemon => daemon_changed(server).await,
            BusEvent::TestProgress { done, total, what } => {
                let manager = server.interface::<_, Guarded<Manager1>>(ROOT_PATH).await?;
                Manager1::test_progress(manager.signal_emitter(), done, total, &what).await
            }
            BusEvent::Instruments => instruments_changed(server, controller).await,
            // only a broker is checked by a ping; a peer that disconnects is detected by its socket
            BusEvent::Heartbeats if connection.is_bus() => ping(connection).await,
            BusEvent::Heartbeats => Ok(()),
            BusEvent::ObjectsChanged => register_again(server, controller, gate).await,
            BusEvent::Happened(event) => {
                let manager = server.interface::<_, Guarded<Manager1>>(ROOT_PATH).await?;
                let details = EventDetails {
                    session: event.session.clone(),
                };
                let wall_ns = survey::nanoseconds(event.at);
                manager
                    .signal_emitter()
                    .happened(wall_ns, event.kind.as_str(), &event.text, details)
                    .await
            }
        }
    });
    match sent.await {
        Ok(Ok(())) => true,
        Ok(Err(error)) => {
            tracing::debug!("a connection failed: {error}");
            false
        }
        Err(_) => {
            tracing::warn!(
                "a subscriber on the bus does not read its messages; its connection is closed"
            );
            false
        }
    }
}

async fn session_changed(session: &InterfaceRef<Guarded<Session1>>) -> zbus::Result<()> {
    let emitter = session.signal_emitter();
    let object = session.get().await;
    object.state_changed(emitter).await?;
    object.last_error_changed(emitter).await?;
    object.end_reason_changed(emitter).await
}

async fn daemon_changed(server: &ObjectServer) -> zbus::Result<()> {
    let manager = server.interface::<_, Guarded<Manager1>>(ROOT_PATH).await?;
    let emitter = manager.signal_emitter();
    let object = manager.get().await;
    object.state_changed(emitter).await?;
    object.active_session_changed(emitter).await?;
    object.baseline_id_changed(emitter).await?;
    object.last_error_changed(emitter).await?;
    object.source_state_changed(emitter).await?;
    object.recovery_changed(emitter).await
}

async fn instruments_changed(
    server: &ObjectServer,
    controller: &Arc<Controller>,
) -> zbus::Result<()> {
    for found in controller.identities().instruments {
        let path = Instrument1::new(Arc::clone(controller), found.role).path();
        let instrument = server.interface::<_, Guarded<Instrument1>>(path).await?;
        let emitter = instrument.signal_emitter();
        let object = instrument.get().await;
        object.state_changed(emitter).await?;
        object.identity_changed(emitter).await?;
    }
    Ok(())
}

async fn ping(connection: &Connection) -> zbus::Result<()> {
    let broker = Some("org.freedesktop.DBus");
    let peer = Some("org.freedesktop.DBus.Peer");
    let path = "/org/freedesktop/DBus";
    connection
        .call_method(broker, path, peer, "Ping", &())
        .await
        .map(drop)
}

/// Registers instrument objects after a reload, and the simulation object if the rig is simulated.
async fn register_again(
    server: &ObjectServer,
    controller: &Arc<Controller>,
    gate: &Arc<Gate>,
) -> zbus::Result<()> {
    let identities = controller.identities().instruments;
    for role in ROLES {
        let instrument = Instrument1::new(Arc::clone(controller), role);
        let path = instrument.path();
        if identities.iter().any(|found| found.role == role) {
            server.at(path, Guarded::new(instrument, gate)).await?;
        } else {
            gone(server.remove::<Guarded<Instrument1>, _>(path).await)?;
        }
    }
    if controller.runtime().simulated_rig.is_some() {
        let simulation = Guarded::new(Simulation1(Arc::clone(controller)), gate);
        server.at(ROOT_PATH, simulation).await?;
    } else {
        gone(server.remove::<Guarded<Simulation1>, _>(ROOT_PATH).await)?;
    }
    let manager = server.interface::<_, Guarded<Manager1>>(ROOT_PATH).await?;
    let emitter = manager.signal_emitter();
    let object = manager.get().await;
    object.instruments_changed(emitter).await?;
    object.simulated_changed(emitter).await?;
    object.source_changed(emitter).await?;
    object.method_changed(emitter).await
}

/// Ignores the error of removing a missing object.
fn gone<T>(removed: zbus::Result<T>) -> zbus::Result<()> {
    match removed {
        Ok(_) | Err(zbus::Error::InterfaceNotFound) => Ok(()),
        Err(error) => Err(error),
    }
}

/// A session's object, registered if needed; `None` for a session that is no longer kept on the bus.
async fn session(
    server: &ObjectServer,
    controller: &Controller,
    id: &str,
    gate: &Arc<Gate>,
) -> zbus::Result<Option<InterfaceRef<Guarded<Session1>>>> {
    let mut sessions = controller.sessions().into_iter();
    let Some(status) = sessions.find(|status| status.facts.id == id) else {
        return Ok(None);
    };
    let Ok(path) = dbus::session_path(id) else {
        return Ok(None);
    };
    show(server, &status, gate).await?;
    server
        .interface::<_, Guarded<Session1>>(path)
        .await
        .map(Some)
}
