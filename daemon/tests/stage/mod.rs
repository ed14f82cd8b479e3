//! A daemon in a temporary folder, reached through its peer socket.

// each test file uses only a part of this
#![allow(dead_code)]

pub mod broker;

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use dbus::{Address, Instrument1Proxy, Manager1Proxy, Options, Session1Proxy, Simulation1Proxy};
use logbook::Verified;
use simulator::{Instrument, Pace, Profile, Scene, ServeOptions, SimulatedRig, TranscriptLine};
use tokio::io::{AsyncBufReadExt, BufReader};
use zbus::{Connection, OwnedObjectPath};

/// The common timeout of all waits.
pub const DEADLINE: Duration = Duration::from_secs(120);

/// A configuration with a small tank, on a simulated rig.
pub const SMALL: &str = r#"
[rig]
kind = "simulated"
profile = "PROFILE"
scene = "scene.toml"
[geometry]
preset = "disc-tank"
[geometry.disc-tank]
electrodes = 16
[survey]
electrodes = 16
[record]
directory = "state"
warn_below_mb = 0
reserve_mb = 0
resume = false
[bus]
peer_path = "run/peer"
"#;

const SCENE: &str = "[disc-tank]\nelectrodes = 16\n[effects.voltmeter-noise]\nuv = 2.0\n";

/// A temporary folder with a configuration.
pub struct Stage {
    pub folder: tempfile::TempDir,
}

impl Stage {
    pub fn new(config: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let profile = "time = \"instant\"\n[slots]\n1 = \"34924A\"\n";
        std::fs::write(folder.path().join("profile.toml"), profile).unwrap();
        std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
        let stage = Self { folder };
        stage.configure(config);
        stage
    }

    pub fn configure(&self, config: &str) {
        std::fs::write(self.config(), config.replace("PROFILE", "profile.toml")).unwrap();
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    pub fn config(&self) -> PathBuf {
        self.path().join("config.toml")
    }

    /// Runs `tactusd` with the configuration and these arguments to its end.
    pub fn run(&self, args: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_tactusd"))
            .arg("--config")
            .arg(self.config())
            .args(args)
            .env_remove("NOTIFY_SOCKET")
            .output()
            .unwrap()
    }

    /// Starts the daemon and connects to it when it reports that it is ready.
    pub async fn start(&self) -> Running {
        self.start_by(tokio::process::Command::new(env!("CARGO_BIN_EXE_tactusd")))
            .await
    }

    /// Starts the daemon with a file size limit in kilobytes.
    pub async fn start_on_a_small_disk(&self, kilobytes: u32) -> Running {
        let mut shell = tokio::process::Command::new("sh");
        // the limit is in 512-byte blocks; the daemon handles the signal of an exceeded limit
        let blocks = kilobytes * 2;
        shell
            .arg("-c")
            .arg(format!("ulimit -f {blocks}; exec \"$0\" \"$@\""))
            .arg(env!("CARGO_BIN_EXE_tactusd"));
        self.start_by(shell).await
    }

    /// Starts the daemon with a bus at this address, which serves as session bus and system bus.
    pub async fn start_on_bus(&self, address: &str) -> Running {
        let mut command = tokio::process::Command::new(env!("CARGO_BIN_EXE_tactusd"));
        command.env("DBUS_SESSION_BUS_ADDRESS", address);
        command.env("DBUS_SYSTEM_BUS_ADDRESS", address);
        self.start_by(command).await
    }

    /// Starts the daemon as systemd does with a watchdog timeout. The socket receives the notifications.
    pub async fn start_watched(&self, patience: Duration) -> (Running, tokio::net::UnixDatagram) {
        let path = self.path().join("notify");
        let socket = tokio::net::UnixDatagram::bind(&path).unwrap();
        // start_by removes the variable; env sets it again
        let mut command = tokio::process::Command::new("env");
        command
            .arg(format!("NOTIFY_SOCKET={}", path.display()))
            .arg(format!("WATCHDOG_USEC={}", patience.as_micros()))
            .arg(env!("CARGO_BIN_EXE_tactusd"));
        (self.start_by(command).await, socket)
    }

    /// Starts the daemon with its usual log level.
    pub async fn start_with_its_usual_words(&self) -> Running {
        let mut command = tokio::process::Command::new(env!("CARGO_BIN_EXE_tactusd"));
        command.env("RUST_LOG", "warn,daemon=info");
        self.start_by(command).await
    }

    /// Starts the daemon by a command that ends with its name: the configuration is appended.
    pub async fn start_by(&self, mut command: tokio::process::Command) -> Running {
        let set = command
            .as_std()
            .get_envs()
            .any(|(name, _)| name == "RUST_LOG");
        if !set {
            command.env("RUST_LOG", "daemon=debug,warn");
        }
        let mut child = command
            .arg("--config")
            .arg(self.config())
            .env_remove("NOTIFY_SOCKET")
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let mut message = String::new();
        let ready = async {
            while let Ok(Some(line)) = lines.next_line().await {
                if line.contains("ready on") {
                    return true;
                }
                message.push_str(&line);
                message.push('\n');
            }
            false
        };
        let ready = tokio::time::timeout(DEADLINE, ready).await.unwrap_or(false);
        assert!(ready, "tactusd did not become ready; it said:\n{message}");
        let log = tokio::spawn(async move {
            let mut log = String::new();
            while let Ok(Some(line)) = lines.next_line().await {
                log.push_str(&line);
                log.push('\n');
            }
            log
        });
        let address = Address::Unix(self.path().join("run/peer"));
        let (connection, _) = dbus::connect(Some(&address)).await.unwrap();
        let manager = Manager1Proxy::new(&connection).await.unwrap();
        Running {
            child,
            log,
            connection,
            manager,
        }
    }
}

/// A running daemon, and a connection to it.
pub struct Running {
    child: tokio::process::Child,
    log: tokio::task::JoinHandle<String>,
    pub connection: Connection,
    pub manager: Manager1Proxy<'static>,
}

impl Running {
    pub async fn session(&self, path: &OwnedObjectPath) -> Session1Proxy<'static> {
        Session1Proxy::builder(&self.connection)
            .path(path.clone())
            .build()
            .await
            .unwrap()
    }

    pub async fn instrument(&self, path: &OwnedObjectPath) -> Instrument1Proxy<'static> {
        Instrument1Proxy::builder(&self.connection)
            .path(path.clone())
            .build()
            .await
            .unwrap()
    }

    pub async fn simulation(&self) -> Simulation1Proxy<'static> {
        Simulation1Proxy::new(&self.connection).await.unwrap()
    }

    /// Records a baseline of this number of frames and waits for its end.
    pub async fn baseline(&self, frames: u64) -> Session1Proxy<'static> {
        let options = Options::new().with("frames", frames);
        let path = self.manager.record_baseline(&options).await.unwrap();
        let session = self.session(&path).await;
        ended(&session).await.unwrap();
        session
    }

    /// Starts a session and returns it.
    pub async fn start(&self, options: Options) -> Session1Proxy<'static> {
        let path = self.manager.start_session(&options).await.unwrap();
        self.session(&path).await
    }

    /// The process id.
    pub fn id(&self) -> u32 {
        self.child.id().unwrap()
    }

    /// Kills the daemon with SIGKILL.
    pub async fn kill(mut self) {
        within(self.child.kill()).await.unwrap();
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: rustix::process::Signal) {
        let pid = rustix::process::Pid::from_raw(self.id() as i32).unwrap();
        rustix::process::kill_process(pid, signal).unwrap();
    }

    /// Sends SIGHUP: the daemon reloads its configuration.
    pub fn hang_up(&self) {
        self.signal(rustix::process::Signal::HUP);
    }

    /// Sends SIGTERM, and returns exit status and output.
    pub async fn terminate(mut self) -> (std::process::ExitStatus, String) {
        self.signal(rustix::process::Signal::TERM);
        let status = within(self.child.wait()).await.unwrap();
        (status, within(self.log).await.unwrap())
    }
}

/// Awaits a future for at most [`DEADLINE`].
pub async fn within<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(DEADLINE, future)
        .await
        .expect("nothing takes that long")
}

/// The map of a frame. On a busy machine it can come after the frame.
pub async fn map_of(session: &Session1Proxy<'_>, sequence: u64) -> dbus::LatestMap {
    within(async {
        loop {
            match session.latest_map().await {
                Ok(map) if map.sequence == sequence => return map,
                Ok(_) | Err(dbus::Fault::NoFrame(_)) => tokio::task::yield_now().await,
                Err(refused) => panic!("{refused:?}"),
            }
        }
    })
    .await
}

/// Waits for the end of a session. The common timeout applies from frame to frame, because a busy machine is slow.
pub async fn ended(session: &Session1Proxy<'_>) -> Result<String, dbus::Fault> {
    let mut frames = session.frames_durable().await.unwrap();
    loop {
        if let Ok(ended) = tokio::time::timeout(DEADLINE, session.wait()).await {
            return ended;
        }
        let now = session.frames_durable().await.unwrap();
        assert!(now > frames, "no frame after {frames} in {DEADLINE:?}");
        frames = now;
    }
}

/// A rig on TCP, in which a test can cause faults, and a configuration for it.
pub async fn on_tcp() -> (SimulatedRig, simulator::Server, String) {
    let rig = instant(&Profile::default());
    let (server, config) = on_tcp_with(&rig).await;
    (rig, server, config)
}

/// The same for an existing rig.
pub async fn on_tcp_with(rig: &SimulatedRig) -> (simulator::Server, String) {
    let server = serve(rig, (0, 0)).await;
    let config = config_for(&server.ready().source, &server.ready().mainframe);
    (server, config)
}

/// The configuration for a rig at these addresses.
pub fn config_for(source: &str, mainframe: &str) -> String {
    format!(
        "{}\n[source]\naddress = \"tcp:{source}\"\ndeadline_ms = 2000\n[switch]\naddress = \"tcp:{mainframe}\"\n\
         [voltmeter]\naddress = \"tcp:{mainframe}\"\n",
        SMALL
            .replace("\"simulated\"", "\"instruments\"")
            .replace("profile = \"PROFILE\"\nscene = \"scene.toml\"\n", "")
    )
}

/// The rig of a profile on a small tank, in instant time.
pub fn instant(profile: &Profile) -> SimulatedRig {
    let scene = Scene::parse("scene", "[disc-tank]\nelectrodes = 16\n").unwrap();
    SimulatedRig::new(&profile.clone().at_pace(Pace::Instant), scene).unwrap()
}

/// Asserts that a returned source was switched off and verified before any other instrument received a message.
pub fn assert_off_before_anything_else(message: &[TranscriptLine]) {
    let place = |from: usize, what: &dyn Fn(&TranscriptLine) -> bool| {
        let found = message[from..].iter().position(what);
        from + found.unwrap_or_else(|| panic!("it is not in {message:#?}"))
    };
    let of_source = |message: &TranscriptLine, word: &str| {
        message.instrument == Instrument::Source && message.received.contains(word)
    };
    let back = place(0, &|message| of_source(message, "*IDN?"));
    let off = place(back, &|message| of_source(message, "CLE"));
    let requested = place(off, &|message| of_source(message, "OUTP?"));
    let other = place(back, &|message| message.instrument != Instrument::Source);
    assert!(
        requested < other,
        "{off}, {requested}, {other}: {message:#?}"
    );
}

/// Asserts that a record is complete, and contains the reasons for missing frames. (There is no reason if a busy
/// machine stopped between two frames.)
pub fn assert_whole(path: &str) -> Verified {
    let verified = logbook::verify(path, |_| ()).unwrap();
    let beside_gaps = verified
        .findings
        .iter()
        .find(|finding| finding.kind != "gap");
    assert!(beside_gaps.is_none(), "{beside_gaps:?}");
    for gap in &verified.gaps {
        assert!(
            gap.explained.is_some() || gap.seconds < DEADLINE.as_secs_f64(),
            "{gap:?}"
        );
    }
    verified
}

/// The ports of a server.
pub fn ports(server: &simulator::Server) -> (u16, u16) {
    let port = |address: &str| address.rsplit(':').next().unwrap().parse().unwrap();
    (
        port(&server.ready().source),
        port(&server.ready().mainframe),
    )
}

/// Serves a rig on these ports: the source's and the mainframe's.
pub async fn serve(rig: &SimulatedRig, ports: (u16, u16)) -> simulator::Server {
    let options = ServeOptions {
        port_6221: ports.0,
        port_34980a: ports.1,
        ..ServeOptions::default()
    };
    simulator::serve(rig.clone(), &options).await.unwrap()
}

/// A session that has its first frame, on a rig on TCP.
pub struct Measuring {
    pub rig: SimulatedRig,
    pub server: simulator::Server,
    pub stage: Stage,
    pub daemon: Running,
    pub session: Session1Proxy<'static>,
    pub happened: dbus::HappenedStream,
    pub frames: dbus::FrameDoneStream,
}

impl Measuring {
    pub async fn begin() -> Self {
        let (rig, server, config) = on_tcp().await;
        let stage = Stage::new(&config);
        let daemon = stage.start().await;
        daemon.baseline(1).await;
        let happened = daemon.manager.receive_happened().await.unwrap();
        let session = daemon.start(Options::new()).await;
        let mut frames = session.receive_frame_done().await.unwrap();
        within(dbus::next(&mut frames)).await.unwrap();
        Self {
            rig,
            server,
            stage,
            daemon,
            session,
            happened,
            frames,
        }
    }
}

/// Waits for an event of this kind, and returns its text.
pub async fn reported(happened: &mut dbus::HappenedStream, kind: &str) -> String {
    loop {
        let signal = within(dbus::next(happened)).await.unwrap();
        let reported = signal.args().unwrap();
        if reported.kind == kind {
            return reported.text.to_string();
        }
    }
}
