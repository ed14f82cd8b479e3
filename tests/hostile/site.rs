//! The target of the attacks: a daemon in a separate process, on a peer socket and a system bus, with instruments in
//! real time.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use dbus::{Address, Manager1Proxy, Options, Session1Proxy};
use tactus_tests::{DEADLINE, DaemonProcess, Spoken, Stage};
use tokio::sync::{Mutex, MutexGuard};
use zbus::Connection;
use zbus::proxy::CacheProperties;

use crate::system_bus::SystemBus;

/// One attack at a time, because each measures times.
static ONE_AT_A_TIME: Mutex<()> = Mutex::const_new(());

/// Timeout for one end of a session on a busy machine.
pub const SOON: Duration = Duration::from_secs(30);

/// Limit for the shortest of several ends of a session. One takes less than a second on an idle machine, under any
/// flood; the limit is ten times that. The tests print the times.
pub const STOPS_WITHIN: Duration = Duration::from_secs(10);

/// Period of the frames. Each takes a fraction of it, so that one is missed only if the daemon stops responding.
const EVERY_S: f64 = 4.0;

const CONFIG: &str = r#"
[rig]
kind = "simulated"
profile = "STAGE/profile.toml"
scene = "STAGE/scene.toml"
[geometry]
preset = "disc-tank"
[geometry.disc-tank]
electrodes = 8
[survey]
electrodes = 8
nplc = 0.02
[model]
method = "one-step"
noise_uv = 2.0
[record]
directory = "STAGE/state"
warn_below_mb = 0
reserve_mb = 0
[bus]
peer = true
peer_path = "STAGE/peer"
system = true
"#;
const PROFILE: &str = "time = \"real\"\n[slots]\n1 = \"34924A\"\n";
const SCENE: &str = "seed = 1\n[disc-tank]\nelectrodes = 8\n[effects.voltmeter-noise]\nuv = 2.0\n";

/// The environment of a daemon: a folder accessible to other users, and a system bus.
pub struct Site {
    pub bus: SystemBus,
    pub stage: Stage,
    _alone: MutexGuard<'static, ()>,
}

impl Site {
    /// `None`, with the reason printed, if this machine cannot provide it.
    pub async fn prepare() -> Option<Self> {
        if !may_try() {
            return None;
        }
        let alone = ONE_AT_A_TIME.lock().await;
        let stage = Stage::with_program(CONFIG, env!("CARGO_BIN_EXE_programs")).unwrap();
        std::fs::write(stage.path().join("profile.toml"), PROFILE).unwrap();
        std::fs::write(stage.path().join("scene.toml"), SCENE).unwrap();
        let passable = std::os::unix::fs::PermissionsExt::from_mode(0o711);
        std::fs::set_permissions(stage.path(), passable).unwrap();
        let bus = SystemBus::start(stage.path()).await;
        Some(Self {
            bus,
            stage,
            _alone: alone,
        })
    }

    /// Starts the daemon and connects to it as root.
    pub async fn start(&self) -> Daemon<'_> {
        let address = self.bus.address();
        let daemon = tokio::task::block_in_place(|| {
            self.stage.start_daemon_with(|command| {
                command.env("DBUS_SYSTEM_BUS_ADDRESS", address);
            })
        })
        .unwrap_or_else(|error| panic!("{error}"));
        let connection = self.come_to_peer().await;
        let manager = Manager1Proxy::builder(&connection)
            .cache_properties(CacheProperties::No)
            .build()
            .await
            .unwrap();
        Daemon {
            site: self,
            daemon,
            connection,
            manager,
        }
    }

    /// Connects as root to the peer socket.
    pub async fn come_to_peer(&self) -> Connection {
        let address = Address::Unix(self.stage.peer_path());
        dbus::connect(Some(&address)).await.unwrap().0
    }

    /// Runs `tactus` as root, on `system` or `peer`.
    pub fn tactus(&self, way: &str, args: &[&str]) -> Spoken {
        let spoken = tokio::task::block_in_place(|| {
            self.stage.tactus_with(args, |command| {
                command.env("DBUS_SYSTEM_BUS_ADDRESS", self.bus.address());
                if way == "system" {
                    command.env("TACTUS_BUS", "system");
                }
            })
        });
        spoken.unwrap_or_else(|error| panic!("{error}"))
    }

    /// Checks the whole record with `tactus sessions verify`.
    pub fn verify(&self) {
        let verified = self.tactus("peer", &["sessions", "verify", "--all"]);
        assert_eq!(verified.code, Some(0), "{verified:?}");
    }
}

/// Whether this machine permits acting as other users; otherwise the reason is printed.
fn may_try() -> bool {
    if std::env::var_os("TACTUS_RIG").is_some() {
        let why = "TACTUS_RIG names a real rig, and this needs the simulated one";
        needs::lacking("SIMULATED", why);
    } else if !rustix::process::geteuid().is_root() {
        needs::lacking("ROOT", "only root can act as other users");
    } else {
        return ["dbus-daemon", "unshare"]
            .into_iter()
            .all(|name| needs::program("DBUS", name));
    }
    false
}

/// A running daemon, and root's connection to its peer socket.
pub struct Daemon<'a> {
    pub site: &'a Site,
    pub daemon: DaemonProcess,
    pub connection: Connection,
    pub manager: Manager1Proxy<'static>,
}

/// Resources of a process.
#[derive(Debug, Clone, Copy)]
pub struct Size {
    pub descriptors: usize,
    pub threads: usize,
}

impl Daemon<'_> {
    /// Records a baseline and waits for its end.
    pub async fn baseline(&self) {
        let options = Options::new().with("frames", 1_u64);
        let path = self.manager.record_baseline(&options).await.unwrap();
        within(self.session(path).await.wait()).await.unwrap();
    }

    /// The session with this object path.
    pub async fn session(&self, path: zbus::OwnedObjectPath) -> Session1Proxy<'static> {
        Session1Proxy::builder(&self.connection)
            .path(path)
            .cache_properties(CacheProperties::No)
            .build()
            .await
            .unwrap()
    }

    /// Starts a session with a schedule that leaves much time between frames, and waits for its first frame.
    pub async fn measure(&self) -> Session1Proxy<'static> {
        let options = Options::new().with("every_s", EVERY_S);
        let path = self.manager.start_session(&options).await.unwrap();
        let session = self.session(path).await;
        frames(&session, 1).await;
        session
    }

    /// Present resources of its process.
    pub fn size(&self) -> Size {
        let process = PathBuf::from(format!("/proc/{}", self.daemon.id()));
        let count = |what: &str| std::fs::read_dir(process.join(what)).unwrap().count();
        Size {
            descriptors: count("fd"),
            threads: count("task"),
        }
    }

    /// Waits until the process uses about as much as before, allowing for temporary connections.
    pub async fn shrinks_to(&self, before: Size) {
        let begun = Instant::now();
        loop {
            let now = self.size();
            if now.descriptors <= before.descriptors + 8 && now.threads <= before.threads + 8 {
                return;
            }
            assert!(begun.elapsed() < DEADLINE, "{before:?} before, {now:?} now");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Runs `tactus stop` as root, on `system` or `peer`: the session must end soon, with the source verified off.
    /// Returns the time, including the start of the command's process.
    pub async fn stop_by_command(&self, way: &str, session: &Session1Proxy<'_>) -> Duration {
        let begun = Instant::now();
        let stopped = self.site.tactus(way, &["stop", "--json"]);
        let took = begun.elapsed();
        assert_eq!(
            stopped.code,
            Some(0),
            "after {took:?}: {stopped:?}\n{}",
            self.daemon.log()
        );
        assert_eq!(self.manager.source_state().await.unwrap(), "off");
        assert_eq!(session.state().await.unwrap(), "ended");
        assert!(took < SOON, "`tactus stop` took {took:?}");
        took
    }

    /// No due frame is missing, and every number exists once.
    pub async fn assert_nothing_missed(&self, session: &Session1Proxy<'_>) -> u64 {
        assert_eq!(session.frames_dropped().await.unwrap(), 0);
        assert_eq!(session.frames_failed().await.unwrap(), 0);
        let path = session.path().await.unwrap();
        let verified = logbook::verify(&path, |_| ()).unwrap();
        // a short gap is allowed: the whole machine may have stalled for some seconds
        let mut findings = verified.findings.iter();
        assert!(
            findings.all(|finding| finding.kind == "gap"),
            "{:?}",
            verified.findings
        );
        let explained = |gap: &logbook::Gap| gap.explained.is_some() || gap.seconds < 10.0;
        assert!(verified.gaps.iter().all(explained), "{:?}", verified.gaps);
        let reader = logbook::SessionReader::open(&path).unwrap();
        let sequences: Vec<u64> = reader
            .frames()
            .map(|record| record.unwrap().frame.sequence)
            .collect();
        let count = sequences.len() as u64;
        assert!(sequences.iter().copied().eq(1..=count), "{sequences:?}");
        count
    }

    /// The same process is running, and none of its threads has panicked.
    pub fn assert_unharmed(&mut self) {
        let log = self.daemon.log();
        assert!(
            self.daemon.is_running(),
            "the daemon ended; it said:\n{log}"
        );
        assert!(!log.contains("panicked"), "{log}");
    }
}

/// Whether a session in this state is running, or will continue when its condition is met.
pub fn is_alive(state: &str) -> bool {
    matches!(state, "running" | "suspended")
}

/// Waits until this number of frames is on disk.
pub async fn frames(session: &Session1Proxy<'_>, count: u64) {
    let begun = Instant::now();
    while session.frames_durable().await.unwrap() < count {
        let state = session.state().await.unwrap();
        assert!(
            begun.elapsed() < DEADLINE && is_alive(&state),
            "the session is {state}: {}",
            session.last_error().await.unwrap()
        );
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Awaits with the common timeout.
pub async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(DEADLINE, future)
        .await
        .expect("nothing takes that long")
}
