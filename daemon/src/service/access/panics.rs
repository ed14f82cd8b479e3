//! An object whose methods panic, while a session is running.

use std::collections::HashMap;

use dbus::{MANAGER_INTERFACE, ROOT_PATH};
use zbus::connection::Builder;

use super::super::caller::Caller;
use super::super::gate::Threads;
use super::*;
use crate::panics::containment::blocking;
use crate::panics::hook;
use crate::session::panics::{follow_panics, tests as guarded};

/// It is registered under the manager's interface name, whose methods are in the table of actions.
struct Panics;

#[async_trait]
impl Interface for Panics {
    fn name() -> InterfaceName<'static> {
        InterfaceName::from_static_str_unchecked(MANAGER_INTERFACE)
    }

    async fn get(
        &self,
        _: &str,
        _: &ObjectServer,
        _: &Connection,
        _: Option<&Header<'_>>,
        _: &SignalEmitter<'_>,
    ) -> Option<Result<OwnedVariant, BoxDBusError>> {
        panic!("one property")
    }

    async fn get_all(
        &self,
        _: &ObjectServer,
        _: &Connection,
        _: Option<&Header<'_>>,
        _: &SignalEmitter<'_>,
    ) -> fdo::Result<HashMap<String, OwnedVariant>> {
        panic!("all properties")
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
        _: &'call ObjectServer,
        _: &'call Connection,
        _: &'call Message,
        name: MemberName<'call>,
    ) -> DispatchResult<'call> {
        match name.as_str() {
            "Plan" => panic!("before the call begins"),
            "Geometry" => DispatchResult::Async(Box::pin(async {
                tokio::task::yield_now().await;
                panic!("during the call")
            })),
            "ListSessions" => DispatchResult::Async(Box::pin(async {
                let read = blocking(|| panic!("on a thread that blocks")).await;
                read.map_err(|_| boxed(Fault::Failed("not read".into())))
            })),
            "OpenAll" => DispatchResult::Async(Box::pin(async { panic!("while acting") })),
            _ => DispatchResult::NotFound,
        }
    }

    fn call_mut<'call>(
        &'call mut self,
        _: &'call ObjectServer,
        _: &'call Connection,
        _: &'call Message,
        _: MemberName<'call>,
    ) -> DispatchResult<'call> {
        DispatchResult::NotFound
    }

    fn introspect_to_writer(&self, _: &mut dyn Write, _: usize) {
        panic!("introspection")
    }
}

/// The text of a call's error reply.
async fn error<B>(client: &Connection, interface: &str, method: &str, body: &B) -> String
where
    B: serde::Serialize + zbus::DynamicType + Sync,
{
    let call = client.call_method(None::<&str>, ROOT_PATH, Some(interface), method, body);
    let answered = tokio::time::timeout(guarded::DEADLINE, call).await;
    match answered.expect("every call is answered") {
        Ok(answer) => panic!("{method} was answered: {answer}"),
        Err(error) => error.to_string(),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_while_answering_leaves_the_session_running() {
    let _alone = guarded::alone().await;
    hook::install();
    let folder = tempfile::tempdir().unwrap();
    // the session is in the middle of a frame for the whole test
    let (controller, sheet) = guarded::in_real_time(folder.path()).await;
    let panics = hook::listen();
    tokio::spawn(follow_panics(
        std::sync::Arc::clone(&controller),
        hook::listen(),
    ));
    let options = dbus::Options::new().with("frames", 1000_u64);
    let status = controller.record_baseline(&options).await.unwrap();
    guarded::current_flows(&sheet).await;

    let threads = Threads::start("clients").unwrap();
    let (ours, theirs) = tokio::net::UnixStream::pair().unwrap();
    let caller = Caller::at(&ours).unwrap();
    let gate = Gate::of_peer(caller, tokio::runtime::Handle::current());
    let (ours, theirs) = (ours.into_std().unwrap(), theirs.into_std().unwrap());
    let serving = threads.handle().spawn(
        Builder::unix_stream(ours)
            .server(zbus::Guid::generate())
            .p2p()
            .serve_at(ROOT_PATH, Guarded::new(Panics, &gate))
            .build(),
    );
    let client = Builder::unix_stream(theirs).p2p().build().await.unwrap();
    let _server = serving.await.unwrap().unwrap();

    let properties = "org.freedesktop.DBus.Properties";
    for _ in 0..3 {
        for (interface, method, message) in [
            (MANAGER_INTERFACE, "Plan", "before the call begins"),
            (MANAGER_INTERFACE, "Geometry", "during the call"),
            (MANAGER_INTERFACE, "ListSessions", "not read"),
        ] {
            let answer = error(&client, interface, method, &()).await;
            assert!(answer.contains(message), "{method}: {answer}");
            assert!(
                method == "ListSessions" || answer.contains("please report it"),
                "{answer}"
            );
        }
        let one = error(&client, properties, "Get", &(MANAGER_INTERFACE, "State")).await;
        assert!(one.contains("one property"), "{one}");
        let all = error(&client, properties, "GetAll", &(MANAGER_INTERFACE,)).await;
        assert!(all.contains("all properties"), "{all}");
        let introspect = "org.freedesktop.DBus.Introspectable";
        let registered_path =
            client.call_method(None::<&str>, ROOT_PATH, Some(introspect), "Introspect", &());
        tokio::time::timeout(guarded::DEADLINE, registered_path)
            .await
            .unwrap()
            .unwrap();
    }
    assert!(!panics.has_changed().unwrap(), "none was the daemon's own");
    assert!(status.progress().ended.is_none());
    assert_eq!(controller.source_state(), "in use");
    guarded::current_flows(&sheet).await;

    // an acting call ends the session as well, and the source is off
    let acting = error(&client, MANAGER_INTERFACE, "OpenAll", &()).await;
    assert!(acting.contains("while acting"), "{acting}");
    let ended = tokio::time::timeout(guarded::DEADLINE, status.ended()).await;
    assert!(ended.unwrap().faulted);
    assert!(!sheet.source_output().0);
}
