//! Who may do what: one table from every method to an action, and one gate in front of every object.
//!
//! Nothing is served but behind [`Guarded`], so a method cannot be forgotten: what is in no row is refused to everybody.
//! Reading (methods marked [`Action::Observe`], every property) is for whoever is let in at the door; setting a property
//! would need a row of its own, and no interface has one to set.

use std::fmt::Write;

use async_trait::async_trait;
use bus::{Fault, MANAGER_INTERFACE, SESSION_INTERFACE, SIMULATION_INTERFACE};
use zbus::message::{Flags, Header, Message};
use zbus::names::{InterfaceName, MemberName};
use zbus::object_server::{DispatchResult, Interface, ObjectServer, SignalEmitter};
use zbus::{BoxDBusError, Connection, OwnedVariant, Variant, fdo};

use super::limit::{self, CALLS, QUESTIONS};
use super::{caller, polkit};

/// What a caller wants to do, as coarse as permission is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Action {
    /// Looking, listening, reading the record.
    Observe,
    /// Starting, suspending and ending a session.
    Control,
    /// Recording a baseline, which takes the place of the current one.
    Baseline,
    /// The instruments themselves, or the simulated sheet, past any session.
    Instruments,
    /// Reading the configuration again.
    Reload,
}

impl Action {
    /// Its name for polkit; `None` where nobody is asked.
    fn id(self) -> Option<&'static str> {
        match self {
            Self::Observe => None,
            Self::Control => Some("org.tactus.Tactus1.control"),
            Self::Baseline => Some("org.tactus.Tactus1.baseline"),
            Self::Instruments => Some("org.tactus.Tactus1.instruments"),
            Self::Reload => Some("org.tactus.Tactus1.reload"),
        }
    }
}

/// Every method, and what it does.
const METHODS: &[(&str, &str, Action)] = &[
    (MANAGER_INTERFACE, "StartSession", Action::Control),
    (MANAGER_INTERFACE, "RecordBaseline", Action::Baseline),
    (MANAGER_INTERFACE, "ListSessions", Action::Observe),
    (MANAGER_INTERFACE, "Plan", Action::Observe),
    (MANAGER_INTERFACE, "PlanWith", Action::Observe),
    (MANAGER_INTERFACE, "Geometry", Action::Observe),
    (MANAGER_INTERFACE, "Baseline", Action::Observe),
    (MANAGER_INTERFACE, "Health", Action::Observe),
    // runs a program that only the configuration names
    (MANAGER_INTERFACE, "NotifyTest", Action::Control),
    // injects current and moves every relay
    (MANAGER_INTERFACE, "TestInstruments", Action::Instruments),
    // asks the instruments over their wires
    (MANAGER_INTERFACE, "Relays", Action::Instruments),
    // speaks to addresses that the caller names
    (MANAGER_INTERFACE, "Discover", Action::Instruments),
    (MANAGER_INTERFACE, "OpenAll", Action::Instruments),
    (MANAGER_INTERFACE, "AcceptInstruments", Action::Instruments),
    (MANAGER_INTERFACE, "Transcript", Action::Instruments),
    (MANAGER_INTERFACE, "Reload", Action::Reload),
    (SESSION_INTERFACE, "Stop", Action::Control),
    (SESSION_INTERFACE, "Suspend", Action::Control),
    (SESSION_INTERFACE, "Resume", Action::Control),
    (SESSION_INTERFACE, "Step", Action::Control),
    (SESSION_INTERFACE, "Wait", Action::Observe),
    (SESSION_INTERFACE, "LatestFrame", Action::Observe),
    (SESSION_INTERFACE, "LatestMap", Action::Observe),
    (SESSION_INTERFACE, "LatestPressure", Action::Observe),
    (SESSION_INTERFACE, "OpenStream", Action::Observe),
    (SIMULATION_INTERFACE, "Press", Action::Instruments),
    (SIMULATION_INTERFACE, "Release", Action::Instruments),
];

/// Every property that can be set, and what setting it does. `Properties.Set` passes the bus's own policy.
const SETTERS: &[(&str, &str, Action)] = &[];

fn action(
    table: &[(&str, &str, Action)],
    interface: &InterfaceName<'_>,
    member: &str,
) -> Option<Action> {
    table
        .iter()
        .find(|(of, named, _)| *of == interface.as_str() && *named == member)
        .map(|(_, _, action)| *action)
}

/// The way on which a caller came, and with it who decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Door {
    /// The peer socket: whoever is not root, the daemon's own user or of the group was turned away before a word.
    Peer,
    /// The session bus: root and the daemon's own user.
    Session,
    /// The system bus: polkit decides; where there is none, root, the daemon's own user and the group.
    System,
}

impl Door {
    /// Lets the sender of a message do this, or says why not. Nothing is remembered from one question to the next.
    async fn admit(
        self,
        connection: &Connection,
        header: Option<&Header<'_>>,
        action: Option<Action>,
        what: &str,
    ) -> Result<(), Fault> {
        let refused = |why: &str| {
            tracing::debug!("{what} was refused: {why}");
            Err(Fault::NotAuthorized(format!("{what}: {why}")))
        };
        let Some(action) = action else {
            return refused("nobody may; it is in no table of actions");
        };
        let Some(id) = action.id() else {
            return Ok(());
        };
        if self == Self::Peer {
            return Ok(());
        }
        let Some((header, sender)) =
            header.and_then(|header| Some((header, header.sender()?.to_owned())))
        else {
            return refused("the message does not say who sends it");
        };
        if self == Self::Session {
            return match caller::of(connection, &sender).await {
                Ok(caller) if caller.is_ours() => Ok(()),
                Ok(_) => refused("only the daemon's own user may, on the session bus"),
                Err(error) => refused(&format!("the bus does not say who asks: {error}")),
            };
        }
        let _place = QUESTIONS.take(limit::client(connection, header))?;
        let interactive = header
            .primary()
            .flags()
            .contains(Flags::ALLOW_INTERACTIVE_AUTH);
        match polkit::ask(connection, &sender, id, interactive).await {
            polkit::Answer::Granted => Ok(()),
            polkit::Answer::Refused => {
                refused(&format!("polkit does not allow you the action {id}"))
            }
            polkit::Answer::Broken(why) => refused(&format!(
                "polkit was asked for the action {id} and gave no answer ({why})"
            )),
            polkit::Answer::Absent => match caller::of(connection, &sender).await {
                Ok(caller) if caller.is_ours() || caller.is_member() => Ok(()),
                Ok(_) => refused(
                    "only root, the daemon's user and the group tactus may, where there is no polkit",
                ),
                Err(error) => refused(&format!("the bus does not say who asks: {error}")),
            },
        }
    }
}

/// An object behind the gate.
pub(super) struct Guarded<I> {
    object: I,
    door: Door,
}

impl<I> Guarded<I> {
    pub(super) fn new(object: I, door: Door) -> Self {
        Self { object, door }
    }
}

impl<I> std::ops::Deref for Guarded<I> {
    type Target = I;
    fn deref(&self) -> &I {
        &self.object
    }
}

#[async_trait]
impl<I: Interface> Interface for Guarded<I> {
    fn name() -> InterfaceName<'static> {
        I::name()
    }

    fn spawn_tasks_for_methods(&self) -> bool {
        self.object.spawn_tasks_for_methods()
    }

    async fn get(
        &self,
        property_name: &str,
        server: &ObjectServer,
        connection: &Connection,
        header: Option<&Header<'_>>,
        emitter: &SignalEmitter<'_>,
    ) -> Option<Result<OwnedVariant, BoxDBusError>> {
        self.object
            .get(property_name, server, connection, header, emitter)
            .await
    }

    async fn get_all(
        &self,
        server: &ObjectServer,
        connection: &Connection,
        header: Option<&Header<'_>>,
        emitter: &SignalEmitter<'_>,
    ) -> fdo::Result<std::collections::HashMap<String, OwnedVariant>> {
        self.object
            .get_all(server, connection, header, emitter)
            .await
    }

    fn set<'call>(
        &'call self,
        property_name: &'call str,
        value: &'call Variant<'_>,
        server: &'call ObjectServer,
        connection: &'call Connection,
        header: Option<&'call Header<'_>>,
        emitter: &'call SignalEmitter<'_>,
    ) -> DispatchResult<'call> {
        let set = self
            .object
            .set(property_name, value, server, connection, header, emitter);
        let DispatchResult::Async(set) = set else {
            return set;
        };
        let action = action(SETTERS, &I::name(), property_name);
        DispatchResult::Async(Box::pin(async move {
            self.door
                .admit(connection, header, action, property_name)
                .await
                .map_err(boxed)?;
            set.await
        }))
    }

    async fn set_mut(
        &mut self,
        property_name: &str,
        value: &Variant<'_>,
        server: &ObjectServer,
        connection: &Connection,
        header: Option<&Header<'_>>,
        emitter: &SignalEmitter<'_>,
    ) -> Option<Result<(), BoxDBusError>> {
        let action = action(SETTERS, &I::name(), property_name);
        if let Err(refusal) = self
            .door
            .admit(connection, header, action, property_name)
            .await
        {
            return Some(Err(boxed(refusal)));
        }
        self.object
            .set_mut(property_name, value, server, connection, header, emitter)
            .await
    }

    fn call<'call>(
        &'call self,
        server: &'call ObjectServer,
        connection: &'call Connection,
        msg: &'call Message,
        name: MemberName<'call>,
    ) -> DispatchResult<'call> {
        let door = self.door;
        let answered = self.object.call(server, connection, msg, name.clone());
        behind::<I>(door, answered, connection, msg, name)
    }

    fn call_mut<'call>(
        &'call mut self,
        server: &'call ObjectServer,
        connection: &'call Connection,
        msg: &'call Message,
        name: MemberName<'call>,
    ) -> DispatchResult<'call> {
        let door = self.door;
        let answered = self.object.call_mut(server, connection, msg, name.clone());
        behind::<I>(door, answered, connection, msg, name)
    }

    fn introspect_to_writer(&self, writer: &mut dyn Write, level: usize) {
        self.object.introspect_to_writer(writer, level);
    }
}

/// The call, not begun before it is admitted.
fn behind<'call, I: Interface>(
    door: Door,
    answered: DispatchResult<'call>,
    connection: &'call Connection,
    msg: &'call Message,
    name: MemberName<'call>,
) -> DispatchResult<'call> {
    let DispatchResult::Async(answered) = answered else {
        return answered;
    };
    let action = action(METHODS, &I::name(), name.as_str());
    DispatchResult::Async(Box::pin(async move {
        let header = msg.header();
        let _place = CALLS
            .take(limit::client(connection, &header))
            .map_err(boxed)?;
        door.admit(connection, Some(&header), action, name.as_str())
            .await
            .map_err(boxed)?;
        answered.await
    }))
}

fn boxed(refusal: Fault) -> BoxDBusError {
    Box::new(refusal)
}

#[cfg(test)]
mod tests;
