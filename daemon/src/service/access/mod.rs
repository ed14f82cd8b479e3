//! Access control: one table from every method to an action, and one check in front of every object.
//!
//! Objects are only served behind [`Guarded`], so a method cannot be forgotten: a method without a row is refused for
//! all callers. Reading (methods marked [`Action::Observe`], every property) is allowed to every connected caller;
//! no property can be set.

mod table;

use std::fmt::Write;
use std::sync::Arc;

use async_trait::async_trait;
use dbus::Fault;
use zbus::message::{Flags, Header, Message};
use zbus::names::{InterfaceName, MemberName};
use zbus::object_server::{DispatchResult, Interface, ObjectServer, SignalEmitter};
use zbus::{BoxDBusError, Connection, OwnedVariant, Variant, fdo};

use super::gate::{Authorizer, Client, Gate};
use super::limit::POLKIT_QUERIES;
use super::polkit;
use crate::panics::containment;
use crate::panics::containment::{PanicScope, Panicked, answer};
pub(super) use table::changes_something;
use table::{Action, CallClass, method};

impl Authorizer {
    /// Checks that the sender of a message may perform an action. Results are not cached.
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
            return refused("no user has permission: the table of actions does not contain it");
        };
        let Some(id) = action.id() else {
            return Ok(());
        };
        if self == Self::Peer {
            return Ok(());
        }
        let Some(sender) = header.sender() else {
            return refused("the message has no sender");
        };
        if self == Self::Session {
            return match client.caller.is_ours() {
                true => Ok(()),
                false => refused("on the session bus only the daemon's own user may do this"),
            };
        }
        let _permit = POLKIT_QUERIES.take(client.user)?;
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
                "polkit was queried for the action {id} and did not reply ({why})"
            )),
            polkit::Answer::Absent if client.caller.is_ours() || client.caller.is_member() => {
                Ok(())
            }
            polkit::Answer::Absent => refused(
                "without polkit only root, the daemon's user and the group tactus may do this",
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
        answer(PanicScope::Reply, got)
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
        answer(PanicScope::Reply, got)
            .await
            .unwrap_or_else(|panicked| Err(fdo::Error::Failed(panicked.to_string())))
    }

    // No interface has a writable property. The default of zbus would wait for the write lock of the object, which
    // `Session1.Wait` holds for reading.
    fn set<'call>(
        &'call self,
        property: &'call str,
        _: &'call Variant<'_>,
        _: &'call ObjectServer,
        _: &'call Connection,
        _: Option<&'call Header<'_>>,
        _: &'call SignalEmitter<'_>,
    ) -> DispatchResult<'call> {
        let refused = fdo::Error::PropertyReadOnly(format!("property '{property}' cannot be set"));
        DispatchResult::Async(Box::pin(std::future::ready(Err(refused.into()))))
    }

    async fn set_mut(
        &mut self,
        _: &str,
        _: &Variant<'_>,
        _: &ObjectServer,
        _: &Connection,
        _: Option<&Header<'_>>,
        _: &SignalEmitter<'_>,
    ) -> Option<Result<(), BoxDBusError>> {
        None
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
        serve_admitted::<I>(&self.gate, answered, connection, msg, name)
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
        serve_admitted::<I>(&gate, answered, connection, msg, name)
    }

    fn introspect_to_writer(&self, writer: &mut dyn Write, level: usize) {
        // after a panic, the text written so far is returned
        let _ = containment::run(|| self.object.introspect_to_writer(writer, level));
    }
}

/// Serves the call once it is admitted. A panic of a reading call is contained; one of an acting call also ends the
/// session.
fn serve_admitted<'call, I: Interface>(
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
        let class = row.map_or(CallClass::Query, |(_, class)| class);
        let _permit = class.limit().take(client.user).map_err(boxed)?;
        let turn = match class {
            CallClass::LargeQuery => client.while_present(gate.large_answers.acquire()).await,
            _ => None,
        };
        if class == CallClass::LargeQuery && turn.is_none() {
            return Ok(());
        }
        let scope = match action {
            Some(Action::Observe) | None => PanicScope::Reply,
            Some(_) => PanicScope::Session,
        };
        let answered = answer(scope, gate.acting(client.user.calls(answered)));
        match class.ends_with_its_caller() {
            true => client
                .while_present(answered)
                .await
                .map_or(Ok(()), flatten_panic),
            false => flatten_panic(answered.await),
        }
    }))
}

/// Converts a caught panic to an error reply.
fn flatten_panic(answered: Result<Result<(), BoxDBusError>, Panicked>) -> Result<(), BoxDBusError> {
    answered.unwrap_or_else(|panicked| Err(boxed(panicked.into())))
}

fn boxed(error: Fault) -> BoxDBusError {
    Box::new(error)
}

#[cfg(test)]
mod panics;
#[cfg(test)]
mod tests;
