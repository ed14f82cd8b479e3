//! Access control: one table from every method to an action, and one check in front of every object.
//!
//! Objects are only served behind [`Guarded`], so a method cannot be forgotten: a method without a row is refused to
//! everybody. Reading (methods marked [`Action::Observe`], every property) is allowed to every connected caller;
//! setting a property would need a row of its own, and no interface has a writable one.

use std::fmt::Write;
use std::sync::Arc;

use async_trait::async_trait;
use dbus::{Fault, MANAGER_INTERFACE, SESSION_INTERFACE, SIMULATION_INTERFACE};
use zbus::message::{Flags, Header, Message};
use zbus::names::{InterfaceName, MemberName};
use zbus::object_server::{DispatchResult, Interface, ObjectServer, SignalEmitter};
use zbus::{BoxDBusError, Connection, OwnedVariant, Variant, fdo};

use super::gate::{Authorizer, Client, Gate};
use super::limit::{ACTS, LOOKS, Limit, QUESTIONS, SAFETY, WAITS};
use super::polkit;
use crate::panics::containment;
use crate::panics::containment::{Ends, Panicked, answer};

/// Groups of operations for which permission is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Action {
    /// Reading status, events and the record.
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
    /// Its polkit action; `None` if no permission is needed.
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

/// How a call is served, and what happens to it when its caller disconnects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lane {
    /// Replied at once; ends with its caller.
    Look,
    /// Like a look, with a reply of some 100 kB: a connection sends one at a time.
    Large,
    /// Waits for a frame or for the end of a session; ends with its caller.
    Wait,
    /// Changes something; runs to its end.
    Act,
    /// Makes the rig safe, with separate limits; runs to its end.
    Safe,
}

impl Lane {
    fn places(self) -> &'static Limit {
        match self {
            Self::Look | Self::Large => &LOOKS,
            Self::Wait => &WAITS,
            Self::Act => &ACTS,
            Self::Safe => &SAFETY,
        }
    }

    /// Whether a reply is cancelled when its caller disconnects.
    fn ends_with_its_caller(self) -> bool {
        matches!(self, Self::Look | Self::Large | Self::Wait)
    }
}

/// Every method, its action, and how it is served.
const METHODS: &[(&str, &str, Action, Lane)] = &[
    (
        MANAGER_INTERFACE,
        "StartSession",
        Action::Control,
        Lane::Act,
    ),
    (
        MANAGER_INTERFACE,
        "RecordBaseline",
        Action::Baseline,
        Lane::Act,
    ),
    (
        MANAGER_INTERFACE,
        "UseBaseline",
        Action::Baseline,
        Lane::Act,
    ),
    (
        MANAGER_INTERFACE,
        "ListSessions",
        Action::Observe,
        Lane::Look,
    ),
    (MANAGER_INTERFACE, "Plan", Action::Observe, Lane::Look),
    (MANAGER_INTERFACE, "PlanWith", Action::Observe, Lane::Look),
    (MANAGER_INTERFACE, "Geometry", Action::Observe, Lane::Large),
    (MANAGER_INTERFACE, "Baseline", Action::Observe, Lane::Look),
    (MANAGER_INTERFACE, "Health", Action::Observe, Lane::Look),
    (MANAGER_INTERFACE, "Status", Action::Observe, Lane::Look),
    // runs a program that only the configuration names
    (MANAGER_INTERFACE, "NotifyTest", Action::Control, Lane::Act),
    // injects current and moves every relay
    (
        MANAGER_INTERFACE,
        "TestInstruments",
        Action::Instruments,
        Lane::Act,
    ),
    // queries the instruments
    (MANAGER_INTERFACE, "Relays", Action::Instruments, Lane::Act),
    // connects to addresses that the caller names
    (
        MANAGER_INTERFACE,
        "Discover",
        Action::Instruments,
        Lane::Act,
    ),
    (
        MANAGER_INTERFACE,
        "OpenAll",
        Action::Instruments,
        Lane::Safe,
    ),
    (
        MANAGER_INTERFACE,
        "AcceptInstruments",
        Action::Instruments,
        Lane::Act,
    ),
    (
        MANAGER_INTERFACE,
        "Transcript",
        Action::Instruments,
        Lane::Act,
    ),
    (MANAGER_INTERFACE, "Reload", Action::Reload, Lane::Act),
    (SESSION_INTERFACE, "Stop", Action::Control, Lane::Safe),
    (SESSION_INTERFACE, "Suspend", Action::Control, Lane::Safe),
    (SESSION_INTERFACE, "Resume", Action::Control, Lane::Act),
    (SESSION_INTERFACE, "Step", Action::Control, Lane::Wait),
    (SESSION_INTERFACE, "Wait", Action::Observe, Lane::Wait),
    (
        SESSION_INTERFACE,
        "LatestFrame",
        Action::Observe,
        Lane::Look,
    ),
    (SESSION_INTERFACE, "LatestMap", Action::Observe, Lane::Large),
    (
        SESSION_INTERFACE,
        "LatestPressure",
        Action::Observe,
        Lane::Look,
    ),
    (SESSION_INTERFACE, "OpenStream", Action::Observe, Lane::Look),
    (
        SIMULATION_INTERFACE,
        "Press",
        Action::Instruments,
        Lane::Act,
    ),
    (
        SIMULATION_INTERFACE,
        "Release",
        Action::Instruments,
        Lane::Act,
    ),
];

/// Every writable property, and its action. `Properties.Set` is not covered by the bus's own policy.
const SETTERS: &[(&str, &str, Action)] = &[];

fn method(interface: &InterfaceName<'_>, member: &str) -> Option<(Action, Lane)> {
    METHODS
        .iter()
        .find(|(of, named, ..)| *of == interface.as_str() && *named == member)
        .map(|(_, _, action, lane)| (*action, *lane))
}

/// Whether a method does more than read.
pub(super) fn changes_something(interface: &str, member: &str) -> bool {
    METHODS.iter().any(|(of, named, action, _)| {
        *of == interface && *named == member && *action != Action::Observe
    })
}

fn setter(interface: &InterfaceName<'_>, member: &str) -> Option<Action> {
    SETTERS
        .iter()
        .find(|(of, named, _)| *of == interface.as_str() && *named == member)
        .map(|(_, _, action)| *action)
}

impl Authorizer {
    /// Checks that the sender of a message is allowed an action. Results are not cached.
    async fn admit(
        self,
        connection: &Connection,
        header: &Header<'_>,
        client: &Client,
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
        let Some(sender) = header.sender() else {
            return refused("the message does not say who sends it");
        };
        if self == Self::Session {
            return match client.caller.is_ours() {
                true => Ok(()),
                false => refused("only the daemon's own user may, on the session bus"),
            };
        }
        let _place = QUESTIONS.take(client.user)?;
        let interactive = header
            .primary()
            .flags()
            .contains(Flags::ALLOW_INTERACTIVE_AUTH);
        match polkit::ask(connection, sender, id, interactive).await {
            polkit::Answer::Granted => Ok(()),
            polkit::Answer::Refused => {
                refused(&format!("polkit does not allow you the action {id}"))
            }
            polkit::Answer::Broken(why) => refused(&format!(
                "polkit was asked for the action {id} and gave no answer ({why})"
            )),
            polkit::Answer::Absent if client.caller.is_ours() || client.caller.is_member() => {
                Ok(())
            }
            polkit::Answer::Absent => refused(
                "only root, the daemon's user and the group tactus may, where there is no polkit",
            ),
        }
    }
}

/// An object behind the access check.
pub(super) struct Guarded<I> {
    object: I,
    gate: Arc<Gate>,
}

impl<I> Guarded<I> {
    pub(super) fn new(object: I, gate: &Arc<Gate>) -> Self {
        Self {
            object,
            gate: Arc::clone(gate),
        }
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
        let got = self
            .object
            .get(property_name, server, connection, header, emitter);
        answer(Ends::Answer, got)
            .await
            .unwrap_or_else(|panicked| Some(Err(boxed(panicked.into()))))
    }

    async fn get_all(
        &self,
        server: &ObjectServer,
        connection: &Connection,
        header: Option<&Header<'_>>,
        emitter: &SignalEmitter<'_>,
    ) -> fdo::Result<std::collections::HashMap<String, OwnedVariant>> {
        let got = self.object.get_all(server, connection, header, emitter);
        answer(Ends::Answer, got)
            .await
            .unwrap_or_else(|panicked| Err(fdo::Error::Failed(panicked.to_string())))
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
        let action = setter(&I::name(), property_name);
        DispatchResult::Async(Box::pin(async move {
            admit_setter(&self.gate, connection, header, action, property_name)
                .await
                .map_err(boxed)?;
            flat(answer(Ends::Session, set).await)
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
        let action = setter(&I::name(), property_name);
        let admitted = admit_setter(&self.gate, connection, header, action, property_name).await;
        if let Err(error) = admitted {
            return Some(Err(boxed(error)));
        }
        let set = self
            .object
            .set_mut(property_name, value, server, connection, header, emitter);
        answer(Ends::Session, set)
            .await
            .unwrap_or_else(|panicked| Some(Err(boxed(panicked.into()))))
    }

    fn call<'call>(
        &'call self,
        server: &'call ObjectServer,
        connection: &'call Connection,
        msg: &'call Message,
        name: MemberName<'call>,
    ) -> DispatchResult<'call> {
        let object = &self.object;
        let answered = containment::run(|| object.call(server, connection, msg, name.clone()));
        behind::<I>(&self.gate, answered, connection, msg, name)
    }

    fn call_mut<'call>(
        &'call mut self,
        server: &'call ObjectServer,
        connection: &'call Connection,
        msg: &'call Message,
        name: MemberName<'call>,
    ) -> DispatchResult<'call> {
        let gate = Arc::clone(&self.gate);
        let object = &mut self.object;
        let answered = containment::run(|| object.call_mut(server, connection, msg, name.clone()));
        behind::<I>(&gate, answered, connection, msg, name)
    }

    fn introspect_to_writer(&self, writer: &mut dyn Write, level: usize) {
        // after a panic, the text written so far is returned
        let _ = containment::run(|| self.object.introspect_to_writer(writer, level));
    }
}

/// Serves the call once it is admitted. A panic of a reading call is contained; one of an acting call also ends the
/// session.
fn behind<'call, I: Interface>(
    gate: &Arc<Gate>,
    answered: Result<DispatchResult<'call>, Panicked>,
    connection: &'call Connection,
    msg: &'call Message,
    name: MemberName<'call>,
) -> DispatchResult<'call> {
    let answered = match answered {
        Ok(DispatchResult::Async(answered)) => answered,
        Ok(other) => return other,
        Err(panicked) => {
            return DispatchResult::Async(Box::pin(async move { Err(boxed(panicked.into())) }));
        }
    };
    let row = method(&I::name(), name.as_str());
    let gate = Arc::clone(gate);
    DispatchResult::Async(Box::pin(async move {
        let header = msg.header();
        let found = gate.client(connection, &header).await.map_err(boxed)?;
        let Some(client) = found else {
            return Ok(());
        };
        let action = row.map(|(action, _)| action);
        let admitted = gate
            .authorizer
            .admit(connection, &header, &client, action, name.as_str());
        // a call whose caller has disconnected is dropped
        let Some(admitted) = client.while_present(admitted).await else {
            return Ok(());
        };
        admitted.map_err(boxed)?;
        let lane = row.map_or(Lane::Look, |(_, lane)| lane);
        let _place = lane.places().take(client.user).map_err(boxed)?;
        let turn = match lane {
            Lane::Large => client.while_present(gate.large_answers.acquire()).await,
            _ => None,
        };
        if lane == Lane::Large && turn.is_none() {
            return Ok(());
        }
        let ends = match action {
            Some(Action::Observe) | None => Ends::Answer,
            Some(_) => Ends::Session,
        };
        let answered = answer(ends, gate.acting(client.user.calls(answered)));
        match lane.ends_with_its_caller() {
            true => client.while_present(answered).await.map_or(Ok(()), flat),
            false => flat(answered.await),
        }
    }))
}

/// Converts a caught panic to an error reply.
fn flat(answered: Result<Result<(), BoxDBusError>, Panicked>) -> Result<(), BoxDBusError> {
    answered.unwrap_or_else(|panicked| Err(boxed(panicked.into())))
}

/// Checks that the sender of a message may set a property.
async fn admit_setter(
    gate: &Gate,
    connection: &Connection,
    header: Option<&Header<'_>>,
    action: Option<Action>,
    what: &str,
) -> Result<(), Fault> {
    let left = || Fault::NotAuthorized(format!("{what}: its sender has left"));
    let header = header.ok_or_else(left)?;
    let client = gate.client(connection, header).await?.ok_or_else(left)?;
    gate.authorizer
        .admit(connection, header, &client, action, what)
        .await
}

fn boxed(error: Fault) -> BoxDBusError {
    Box::new(error)
}

#[cfg(test)]
mod panics;
#[cfg(test)]
mod tests;
