//! Access control on each of the three kinds of connection to the daemon: polkit grants, denies, does not reply, or is
//! absent; other users.

use std::collections::HashMap;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use crate::stage::broker::Broker;
use crate::stage::{Running, SMALL, Stage, within};
use dbus::{BUS_NAME, Fault, INTERFACE_XML, Manager1Proxy, Options, ROOT_PATH, Simulation1Proxy};
use tokio::sync::watch;
use tokio::task::JoinSet;
use zbus::fdo::PropertiesProxy;
use zbus::proxy::MethodFlags;
use zbus::{Connection, OwnedVariant};

/// Another user, if the tests run as root.
const NOBODY: u32 = 65_534;

/// The reply of the test's polkit authority to a request.
#[derive(Clone)]
enum PolkitReply {
    Yes,
    No,
    Nothing,
    /// Grants, once this is true.
    YesWhen(watch::Receiver<bool>),
}

/// The received requests: name of the sender, action, flags.
type Requests = Arc<watch::Sender<Vec<(String, String, u32)>>>;

struct Authority {
    says: PolkitReply,
    requested: Requests,
}

#[zbus::interface(name = "org.freedesktop.PolicyKit1.Authority")]
impl Authority {
    async fn check_authorization(
        &self,
        subject: (String, HashMap<String, OwnedVariant>),
        action: String,
        _details: HashMap<String, String>,
        flags: u32,
        _cancellation: String,
    ) -> (bool, bool, HashMap<String, String>) {
        assert_eq!(subject.0, "system-bus-name");
        let name = String::try_from(subject.1["name"].try_clone().unwrap()).unwrap();
        self.requested
            .send_modify(|requested| requested.push((name, action, flags)));
        match &self.says {
            PolkitReply::Yes => (true, false, HashMap::new()),
            PolkitReply::YesWhen(message) => {
                message.clone().wait_for(|message| *message).await.unwrap();
                (true, false, HashMap::new())
            }
            PolkitReply::No => (false, false, HashMap::new()),
            PolkitReply::Nothing => std::future::pending().await,
        }
    }
}

/// A daemon on a bus with this authority, and a client on the bus.
struct Scene {
    daemon: Running,
    client: Connection,
    manager: Manager1Proxy<'static>,
    requested: Requests,
    _authority: Option<Connection>,
    broker: Broker,
    stage: Stage,
}

impl Scene {
    async fn set(bus: &str, says: Option<PolkitReply>) -> Option<Self> {
        let stage = Stage::new(&SMALL.replace("[bus]", &format!("[bus]\n{bus} = true")));
        let broker = Broker::start(stage.path())?;
        let requested = Requests::default();
        let authority = match says {
            None => None,
            Some(says) => {
                let connection = broker.connect().await;
                let authority = Authority {
                    says,
                    requested: Arc::clone(&requested),
                };
                let path = "/org/freedesktop/PolicyKit1/Authority";
                connection
                    .object_server()
                    .at(path, authority)
                    .await
                    .unwrap();
                let name = "org.freedesktop.PolicyKit1";
                connection.request_name(name).await.unwrap();
                Some(connection)
            }
        };
        let daemon = stage.start_on_bus(&broker.address).await;
        let client = broker.connect().await;
        let manager = Manager1Proxy::new(&client).await.unwrap();
        Some(Self {
            daemon,
            client,
            manager,
            requested,
            _authority: authority,
            broker,
            stage,
        })
    }

    fn actions(&self) -> Vec<String> {
        let requested = self.requested.borrow();
        requested
            .iter()
            .map(|(_, action, _)| action.clone())
            .collect()
    }

    /// Calls a method of the manager with `busctl call` as another user; `None`, with a message, if this cannot be
    /// tested here.
    fn as_another(&self, method: &[&str]) -> Option<Output> {
        self.open_to_all();
        as_nobody(
            Command::new("busctl")
                .arg(format!("--address={}", self.broker.address))
                .args(["call", BUS_NAME, ROOT_PATH, dbus::MANAGER_INTERFACE])
                .args(method),
        )
    }

    /// Lets other users reach the sockets.
    fn open_to_all(&self) {
        for (path, mode) in [("", 0o711), ("bus", 0o777)] {
            let path = self.stage.path().join(path);
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
        }
    }
}

fn as_nobody(command: &mut Command) -> Option<Output> {
    if !rustix::process::geteuid().is_root() {
        eprintln!("not tried as another user: only root can take another user's place");
        return None;
    }
    match command.uid(NOBODY).gid(NOBODY).output() {
        Ok(output) if message(&output).contains("Permission denied") => {
            eprintln!("not tried as another user: it does not come as far as the test's folder");
            None
        }
        Ok(output) => Some(output),
        Err(error) => {
            eprintln!("not tried as another user: {error}");
            None
        }
    }
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn refused<T: std::fmt::Debug>(answer: Result<T, Fault>, why: &str) {
    assert!(
        matches!(&answer, Err(Fault::NotAuthorized(text)) if text.contains(why)),
        "{answer:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn polkit_decides_each_action_of_a_sender_but_not_queries() {
    let Some(scene) = Scene::set("system", Some(PolkitReply::Yes)).await else {
        return;
    };
    scene.manager.state().await.unwrap();
    scene.manager.list_sessions(&Options::new()).await.unwrap();
    scene.manager.plan().await.unwrap();
    assert!(scene.actions().is_empty());

    let none = Options::new();
    let baseline = Options::new().with("frames", 1_u64);
    let path = scene.manager.record_baseline(&baseline).await.unwrap();
    let session = scene.daemon.session(&path).await;
    crate::stage::ended(&session).await.unwrap();
    let step = Options::new().with("step", true);
    let path = scene.manager.start_session(&step).await.unwrap();
    let session = dbus::Session1Proxy::builder(&scene.client)
        .path(path)
        .build()
        .await
        .unwrap();
    within(session.step(1)).await.unwrap();
    crate::stage::map_of(&session, 1).await;
    within(session.stop()).await.unwrap();
    scene.manager.open_all().await.unwrap();
    scene.manager.transcript(&none).await.unwrap();
    scene.manager.reload().await.unwrap();
    let words = "baseline control control control instruments instruments reload";
    let expected: Vec<String> = words
        .split(' ')
        .map(|word| format!("org.tactus.Tactus1.{word}"))
        .collect();
    assert_eq!(scene.actions(), expected);

    // a password is requested only if the caller allows interaction
    let flags = MethodFlags::ALLOW_INTERACTIVE_AUTH;
    let inner = scene.manager.inner();
    let done: Option<String> = inner.call_with_flags("Reload", flags, &()).await.unwrap();
    assert!(done.is_some());
    let requested = scene.requested.borrow().clone();
    let own = scene.client.unique_name().unwrap().as_str();
    assert!(
        requested.iter().all(|(name, _, _)| name == own),
        "{requested:?}"
    );
    let flags: Vec<u32> = requested.iter().map(|(_, _, flags)| *flags).collect();
    assert_eq!(flags, [0, 0, 0, 0, 0, 0, 0, 1]);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_polkit_refuses_is_not_done_even_for_root() {
    let Some(scene) = Scene::set("system", Some(PolkitReply::No)).await else {
        return;
    };
    // the peer socket does not use polkit
    scene.daemon.baseline(1).await;
    let running = scene.daemon.start(Options::new().with("step", true)).await;
    let session = dbus::Session1Proxy::builder(&scene.client)
        .path(running.inner().path().to_owned())
        .build()
        .await
        .unwrap();
    let simulation = Simulation1Proxy::new(&scene.client).await.unwrap();
    let (manager, none) = (&scene.manager, Options::new());
    let why = "polkit does not allow you";
    refused(manager.start_session(&none).await, why);
    refused(manager.record_baseline(&none).await, why);
    refused(manager.use_baseline("b1").await, why);
    refused(manager.override_tracking("empty-now").await, why);
    refused(manager.test_instruments(&none).await, why);
    refused(manager.relays(&none).await, why);
    refused(manager.discover(&[], &none).await, why);
    refused(manager.open_all().await, why);
    refused(manager.accept_instruments().await, why);
    refused(manager.transcript(&none).await, why);
    refused(manager.reload().await, why);
    refused(session.stop().await, why);
    refused(session.suspend().await, why);
    refused(session.resume().await, why);
    refused(session.step(1).await, why);
    refused(simulation.press("disc", 0.0, 0.0, 0.01, 0.5).await, why);
    refused(simulation.release().await, why);
    assert_eq!(scene.actions().len(), 17);

    // reading is allowed for all users; the refused calls have changed nothing
    assert_eq!(session.state().await.unwrap(), "running");
    assert_eq!(session.frames_acquired().await.unwrap(), 0);
    within(running.stop()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn no_property_of_any_interface_can_be_set() {
    let Some(scene) = Scene::set("system", Some(PolkitReply::Yes)).await else {
        return;
    };
    let path = scene.daemon.baseline(1).await.inner().path().to_string();
    let instrument = scene.manager.instruments().await.unwrap()[0].to_string();
    let mut tried = 0;
    for (interface, xml) in INTERFACE_XML {
        let path = match interface {
            dbus::SESSION_INTERFACE => path.as_str(),
            dbus::INSTRUMENT_INTERFACE => instrument.as_str(),
            _ => ROOT_PATH,
        };
        let properties = PropertiesProxy::builder(&scene.client)
            .destination(BUS_NAME)
            .path(path.to_owned())
            .build()
            .await
            .unwrap();
        let named = xml.split("<property name=\"").skip(1);
        for name in named.filter_map(|rest| rest.split('"').next()) {
            let before = properties
                .get(interface.try_into().unwrap(), name)
                .await
                .unwrap();
            let set = properties.set(interface.try_into().unwrap(), name, &before);
            assert!(set.await.is_err(), "{interface}.{name} was set");
            tried += 1;
        }
    }
    assert!(tried > 20, "{tried} properties");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_polkit_that_never_answers_is_a_refusal() {
    let Some(scene) = Scene::set("system", Some(PolkitReply::Nothing)).await else {
        return;
    };
    refused(within(scene.manager.open_all()).await, "did not reply");
    // and no other client is delayed
    assert_eq!(scene.manager.state().await.unwrap(), "idle");
}

#[tokio::test(flavor = "multi_thread")]
async fn one_user_has_eight_questions_open_on_all_connections() {
    let (say, message) = watch::channel(false);
    let Some(scene) = Scene::set("system", Some(PolkitReply::YesWhen(message))).await else {
        return;
    };
    // the timeout of the password dialog is much longer than this test
    let ask = async |manager: Manager1Proxy<'static>| -> zbus::Result<Option<String>> {
        let flags = MethodFlags::ALLOW_INTERACTIVE_AUTH;
        let inner = manager.inner();
        inner
            .call_with_flags("Transcript", flags, &Options::new())
            .await
    };
    let refused = async |manager: &Manager1Proxy<'static>, whose: &str| {
        let error = within(ask(manager.clone())).await.unwrap_err();
        let reported = format!("{error:?}");
        let name = "org.tactus.Tactus1.Error.LimitsExceeded";
        assert!(
            reported.contains(name) && reported.contains(whose),
            "{reported}"
        );
    };
    let mut requested = scene.requested.subscribe();
    let mut queries = JoinSet::new();
    for client in 1..=2 {
        let manager = Manager1Proxy::new(&scene.broker.connect().await)
            .await
            .unwrap();
        for _ in 0..4 {
            queries.spawn(ask(manager.clone()));
        }
        within(requested.wait_for(|requested| requested.len() == client * 4))
            .await
            .unwrap();
    }
    refused(&scene.manager, "you have 8 polkit queries").await;
    assert_eq!(scene.requested.borrow().len(), 8, "polkit is not asked");
    // reading needs no authorisation
    assert_eq!(scene.manager.state().await.unwrap(), "idle");

    say.send(true).unwrap();
    while let Some(granted) = within(queries.join_next()).await {
        assert!(granted.unwrap().unwrap().is_some());
    }
    scene.manager.transcript(&Options::new()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn without_polkit_only_our_own_user_may_and_everybody_may_look() {
    let Some(scene) = Scene::set("system", None).await else {
        return;
    };
    scene.manager.open_all().await.unwrap();
    let Some(output) = scene.as_another(&["OpenAll"]) else {
        return;
    };
    let text = message(&output);
    assert!(!output.status.success(), "{output:?}");
    assert!(text.contains("the group tactus may"), "{text}");
    let looked = scene.as_another(&["Plan"]).unwrap();
    assert!(looked.status.success(), "{}", message(&looked));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_session_bus_and_the_peer_socket_are_our_own_users() {
    let Some(scene) = Scene::set("session", Some(PolkitReply::No)).await else {
        return;
    };
    scene.manager.open_all().await.unwrap();
    assert!(
        scene.actions().is_empty(),
        "polkit knows nothing of this bus"
    );
    if let Some(output) = scene.as_another(&["OpenAll"]) {
        let text = message(&output);
        assert!(text.contains("only the daemon's own user"), "{text}");
    }
    // even if the permissions of the socket let all users connect
    for (path, mode) in [("run", 0o711), ("run/peer", 0o666)] {
        let path = scene.stage.path().join(path);
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode)).unwrap();
    }
    let came = connect_as_nobody(&scene.stage.path().join("run/peer"));
    let (_, log) = scene.daemon.terminate().await;
    assert_eq!(
        log.contains("was refused at the peer socket"),
        came,
        "{log}"
    );
}

/// Whether another user's process could connect to the daemon's peer socket.
fn connect_as_nobody(socket: &Path) -> bool {
    let address = format!("--address=unix:path={}", socket.display());
    let came = as_nobody(Command::new("busctl").args([address.as_str(), "tree", BUS_NAME]));
    if let Some(output) = &came {
        assert!(!output.status.success());
    }
    came.is_some()
}
