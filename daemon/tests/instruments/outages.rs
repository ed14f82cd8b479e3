//! Faults that the simulators do not have: a network link taken down below TCP, a change of the wall clock, a stopped
//! daemon.
//!
//! A machine may lack the requirements of the first two (network namespaces for an unprivileged user, libfaketime).
//! Their tests then report that and pass, unless TACTUS_REQUIRE_NETNS=1 or TACTUS_REQUIRE_FAKETIME=1.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::stage::{
    Running, SMALL, Stage, assert_off_before_anything_else, assert_whole, config_for, instant,
    on_tcp, reported, within,
};
use dbus::{FrameDoneStream, Options, Session1Proxy};
use logbook::{FrameRecord, SessionReader};
use rustix::process::Signal;
use simulator::{Profile, ServeOptions, Server, SimulatedRig};

/// Time from the start of one frame to the start of the next, s.
const EVERY_S: f64 = 0.2;

/// Waits until this number of further frames is on disk.
async fn frames_go_on(session: &Session1Proxy<'_>, frames: &mut FrameDoneStream, more: u64) {
    let before = within(session.frames_durable()).await.unwrap();
    while within(session.frames_durable()).await.unwrap() < before + more {
        within(dbus::next(frames)).await.unwrap();
    }
}

fn records(path: &str) -> Vec<FrameRecord> {
    let reader = SessionReader::open(path).unwrap();
    reader.frames().map(|record| record.unwrap()).collect()
}

fn no_sequence_is_missing(records: &[FrameRecord]) {
    let sequences = records.iter().map(|record| record.frame.sequence);
    assert!(sequences.eq(1..=records.len() as u64));
}

const INSIDE: &str = "TACTUS_TEST_INSIDE";
const OWN_NETWORK: [&str; 3] = ["--user", "--map-root-user", "--net"];

/// Whether this process has its own network namespace. If not, runs the test again in one; this run must then return.
fn has_own_network(test: &str) -> bool {
    if std::env::var_os(INSIDE).is_some() {
        return true;
    }
    let needed = "nsenter --version && ip link add here type veth peer name there && exec unshare --net true";
    let tried = Command::new("unshare")
        .args(OWN_NETWORK)
        .args(["sh", "-c", needed])
        .output();
    let error = match tried {
        Ok(output) if output.status.success() => None,
        Ok(output) => Some(String::from_utf8_lossy(&output.stderr).into_owned()),
        Err(fault) => Some(format!("unshare: {fault}")),
    };
    if let Some(error) = error {
        let why = format!("no network namespace with a link of its own: {error}");
        needs::lacking("NETNS", &why);
        return false;
    }
    let output = Command::new("unshare")
        .args(OWN_NETWORK)
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", test, "--nocapture"])
        .env(INSIDE, "1")
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stdout);
    let noted = String::from_utf8_lossy(&output.stderr);
    println!("{message}{noted}");
    assert!(output.status.success() && message.contains("1 passed"));
    false
}

fn ip(words: &str) {
    let output = Command::new("ip").args(words.split(' ')).output().unwrap();
    assert!(output.status.success(), "ip {words}: {output:?}");
}

/// An instrument's cable: a link between this network namespace and the daemon's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cable {
    Source = 1,
    Mainframe = 2,
}

impl Cable {
    const ALL: [Self; 2] = [Self::Source, Self::Mainframe];

    fn connect_cable(self) {
        let number = self as u8;
        ip(&format!(
            "link add rig{number} type veth peer name daemon{number}"
        ));
        ip(&format!("addr add 10.77.{number}.2/24 dev rig{number}"));
        self.plug();
    }

    /// Takes the link down: packets in flight are lost, and neither side is notified by the end of a connection or a
    /// refusal.
    fn unplug(self) {
        ip(&format!("link set rig{} down", self as u8));
    }

    fn plug(self) {
        ip(&format!("link set rig{} up", self as u8));
    }

    /// The address under which the daemon reaches this listener.
    fn place(self, listening: &str) -> String {
        let port = listening.rsplit(':').next().unwrap();
        format!("10.77.{}.2:{port}", self as u8)
    }
}

/// Script that moves the far ends of the cables from the network of process $RIG to its own network, and executes its
/// arguments.
const AT_THE_FAR_END: &str = r#"
set -e
for number in 1 2; do
    nsenter --net="/proc/$RIG/ns/net" ip link set "daemon$number" netns $$
    ip addr add "10.77.$number.1/24" dev "daemon$number"
    ip link set "daemon$number" up
done
exec "$0" "$@"
"#;

/// Instruments in this network namespace, a daemon in another, and the cables between them.
struct Cabled {
    rig: SimulatedRig,
    _server: Server,
    _stage: Stage,
    daemon: Running,
}

impl Cabled {
    async fn begin() -> Self {
        for cable in Cable::ALL {
            cable.connect_cable();
        }
        let rig = instant(&Profile::default());
        let options = ServeOptions {
            bind: "0.0.0.0".to_owned(),
            port_6221: 0,
            port_34980a: 0,
            ..ServeOptions::default()
        };
        let server = simulator::serve(rig.clone(), &options).await.unwrap();
        let stage = Stage::new(&config_for(
            &Cable::Source.place(&server.ready().source),
            &Cable::Mainframe.place(&server.ready().mainframe),
        ));
        let mut command = tokio::process::Command::new("unshare");
        command
            .args(["--net", "sh", "-c", AT_THE_FAR_END])
            .arg(env!("CARGO_BIN_EXE_tactusd"))
            .env("RIG", std::process::id().to_string());
        let daemon = stage.start_by(command).await;
        daemon.baseline(1).await;
        Self {
            rig,
            _server: server,
            _stage: stage,
            daemon,
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_goes_on_after_a_pulled_cable_is_back() {
    if !has_own_network("outages::a_session_goes_on_after_a_pulled_cable_is_back") {
        return;
    }
    let Cabled {
        rig,
        _server,
        _stage,
        daemon,
    } = Cabled::begin().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new()).await;
    let mut frames = session.receive_frame_done().await.unwrap();

    let cuts: [&[Cable]; 3] = [&[Cable::Source], &[Cable::Mainframe], &Cable::ALL];
    for cut in cuts {
        frames_go_on(&session, &mut frames, 2).await;
        rig.keep_transcript();
        for cable in cut {
            cable.unplug();
        }
        let mut kinds = Vec::new();
        let mut back = false;
        loop {
            let signal = within(dbus::next(&mut happened)).await.unwrap();
            let reported = signal.args().unwrap();
            println!("{cut:?}: {}: {}", reported.kind, reported.text);
            kinds.push(reported.kind.to_string());
            match reported.kind {
                "source-unknown" if !back => {
                    let state = daemon.manager.source_state().await.unwrap();
                    assert_eq!(state, "unknown");
                    assert!(rig.closed().is_empty(), "{:?}", rig.closed());
                }
                "alarm" => assert!(reported.text.contains("may be live"), "{}", reported.text),
                "reconnecting" if !back => {
                    assert_eq!(session.state().await.unwrap(), "suspended");
                    back = true;
                    for cable in cut {
                        cable.plug();
                    }
                }
                "resumed" if back => break,
                _ => {}
            }
        }
        let unknown = match cut {
            [Cable::Source] => Some("source-unknown"),
            [Cable::Mainframe] => None,
            _ => Some("alarm"),
        };
        let steps = ["frame-failed", "suspended", "settings-verified"];
        for step in steps.into_iter().chain(unknown) {
            assert!(kinds.iter().any(|kind| kind == step), "{step}: {kinds:?}");
        }
        assert_off_before_anything_else(&rig.transcript());
    }
    frames_go_on(&session, &mut frames, 2).await;
    within(session.stop()).await.unwrap();
    assert!(!rig.source_output().0);
    let path = session.path().await.unwrap();
    no_sequence_is_missing(&records(&path));
    let verified = assert_whole(&path);
    let explained = verified.gaps.iter().filter(|gap| gap.explained.is_some());
    assert!(explained.count() >= cuts.len(), "{:?}", verified.gaps);
    daemon.terminate().await;
}

/// Whether a process still has a TCP connection to the source, other than one being opened.
fn lingers(process: u32) -> bool {
    // 10.77.1.2 in the notation of /proc, and the state of a connection that is being opened
    const SOURCE: &str = "02014D0A:";
    const SYN_SENT: &str = "02";
    let connections = std::fs::read_to_string(format!("/proc/{process}/net/tcp")).unwrap();
    connections.lines().any(|line| {
        let mut fields = line.split_whitespace().skip(2);
        let (peer, state) = (fields.next(), fields.next());
        peer.is_some_and(|peer| peer.starts_with(SOURCE)) && state != Some(SYN_SENT)
    })
}

/// The source is disconnected behind a network switch: the daemon's link stays up, and its TCP connection times out
/// without a notification. The 6221 has one connection slot, which stays occupied by the lost client.
#[tokio::test(flavor = "multi_thread")]
async fn a_source_that_keeps_its_place_for_a_lost_client_is_had_back() {
    if !has_own_network("outages::a_source_that_keeps_its_place_for_a_lost_client_is_had_back") {
        return;
    }
    let Cabled {
        rig,
        _server,
        _stage,
        daemon,
    } = Cabled::begin().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(2)).await.unwrap();
    rig.keep_transcript();
    // Between two frames: replies of the source are lost, and the source has nothing to retransmit.
    ip("addr del 10.77.1.2/24 dev rig1");
    let requested = session.step(1);
    let had_back = async {
        let mut back = false;
        loop {
            let signal = within(dbus::next(&mut happened)).await.unwrap();
            let reported = signal.args().unwrap();
            println!("{}: {}", reported.kind, reported.text);
            match reported.kind {
                "reconnecting" if !back && !lingers(daemon.id()) => {
                    back = true;
                    ip("addr add 10.77.1.2/24 dev rig1");
                }
                "resumed" if back => break,
                _ => {}
            }
        }
    };
    let (_, ()) = tokio::join!(requested, had_back);
    assert_off_before_anything_else(&rig.transcript());
    within(session.step(2)).await.unwrap();
    within(session.stop()).await.unwrap();
    assert!(!rig.source_output().0);
    let path = session.path().await.unwrap();
    no_sequence_is_missing(&records(&path));
    assert_whole(&path);
    daemon.terminate().await;
}

/// The library that changes a process's clocks.
fn faketime() -> Option<PathBuf> {
    let folders = std::fs::read_dir("/usr/lib").ok()?;
    folders
        .filter_map(Result::ok)
        .map(|folder| folder.path().join("faketime/libfaketimeMT.so.1"))
        .find(|library| library.exists())
}

/// Sets the offset of the wall clock, s, in one step.
fn set_clock(file: &Path, off_s: i64) {
    let next = file.with_extension("next");
    std::fs::write(&next, format!("{off_s:+}\n")).unwrap();
    std::fs::rename(&next, file).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn wall_clock_step_moves_no_frame_and_is_reported() {
    const HOUR_S: i64 = 3600;
    let Some(library) = faketime() else {
        return needs::lacking("FAKETIME", "libfaketime is not installed");
    };
    let stage = Stage::new(SMALL);
    let clock = stage.path().join("clock");
    set_clock(&clock, 0);
    let mut command = tokio::process::Command::new(env!("CARGO_BIN_EXE_tactusd"));
    command
        .env("LD_PRELOAD", library)
        .env("FAKETIME_TIMESTAMP_FILE", &clock)
        .env("FAKETIME_NO_CACHE", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1")
        .env("NO_FAKE_STAT", "1");
    let daemon = stage.start_by(command).await;
    daemon.baseline(1).await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("every_s", EVERY_S)).await;
    let mut frames = session.receive_frame_done().await.unwrap();
    frames_go_on(&session, &mut frames, 5).await;
    // an hour ahead, then two hours back
    // on a busy machine the two clocks may be read at different times: the steps are rounded, and such a difference of a
    // second is reported too
    let ahead: fn(&str) -> bool = |text| text.contains("by +36") || text.contains("by +35");
    let back: fn(&str) -> bool = |text| text.contains("by -72") || text.contains("by -71");
    for (off_s, is_step) in [(HOUR_S, ahead), (-HOUR_S, back)] {
        set_clock(&clock, off_s);
        while !is_step(&reported(&mut happened, "clock-moved").await) {}
        frames_go_on(&session, &mut frames, 5).await;
    }
    let missed = session.frames_dropped().await.unwrap();
    within(session.stop()).await.unwrap();

    let path = session.path().await.unwrap();
    let records = records(&path);
    no_sequence_is_missing(&records);
    assert_whole(&path);
    // the frames followed the schedule by the monotonic clock, and the wall clock was set twice; all other deviations
    // are below a minute
    let (first, last) = (&records[0].frame, &records[records.len() - 1].frame);
    let places = records.len() as u64 - 1 + missed;
    let lasted = (last.monotonic - first.monotonic).as_secs_f64();
    assert!(
        (lasted - places as f64 * EVERY_S).abs() < 60.0,
        "{places} places in {lasted} s"
    );
    let apart = |record: &FrameRecord| {
        let frame = &record.frame;
        (frame.wall - first.wall).as_seconds_f64()
            - (frame.monotonic - first.monotonic).as_secs_f64()
    };
    for off_s in [0, HOUR_S, -HOUR_S] {
        let alike = |record: &&FrameRecord| (apart(record) - off_s as f64).abs() < 60.0;
        let of_this_time = records.iter().filter(alike).count();
        assert!(of_this_time >= 5, "{of_this_time} frames at {off_s:+} s");
    }
    let events = SessionReader::open(&path).unwrap().events().unwrap();
    let moved = events.iter().filter(|event| event.kind == "clock-moved");
    let count = |is_step: fn(&str) -> bool| {
        let steps = moved.clone().filter(|event| is_step(&event.text));
        steps.count()
    };
    assert_eq!((count(ahead), count(back)), (1, 1), "{events:?}");
    daemon.terminate().await;
}

/// Whether all threads of a process are stopped.
fn is_stopped(id: u32) -> bool {
    std::fs::read_dir(format!("/proc/{id}/task"))
        .unwrap()
        .all(|thread| {
            let state = std::fs::read_to_string(thread.unwrap().path().join("stat")).unwrap();
            state.rsplit(") ").next().unwrap().starts_with('T')
        })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_was_paused_goes_on_and_reports_what_it_missed() {
    let (rig, _server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("every_s", EVERY_S)).await;
    let mut frames = session.receive_frame_done().await.unwrap();
    frames_go_on(&session, &mut frames, 3).await;
    let path = session.path().await.unwrap();
    let (acknowledged, id) = (session.frames_durable().await.unwrap(), daemon.id());

    // in the middle of a frame
    within(async {
        while !rig.source_output().0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    daemon.signal(Signal::STOP);
    within(async {
        while !is_stopped(id) {
            tokio::task::yield_now().await;
        }
    })
    .await;
    // the record of the stopped daemon is readable
    assert!(SessionReader::open(&path).unwrap().len().unwrap() >= acknowledged);
    // waits for the time that another session needs for this number of frames with the same schedule
    const MEANWHILE: u64 = 15;
    let other = Stage::new(SMALL);
    let measuring = other.start().await;
    measuring.baseline(1).await;
    let options = Options::new()
        .with("every_s", EVERY_S)
        .with("count", MEANWHILE);
    within(measuring.start(options).await.wait()).await.unwrap();
    measuring.terminate().await;
    assert!(is_stopped(id));
    daemon.signal(Signal::CONT);

    frames_go_on(&session, &mut frames, 3).await;
    within(session.stop()).await.unwrap();
    assert!(!rig.source_output().0);
    no_sequence_is_missing(&records(&path));
    let verified = assert_whole(&path);
    let stood_s = (MEANWHILE - 1) as f64 * EVERY_S;
    let gap = verified.gaps.iter().find(|gap| gap.seconds >= stood_s);
    let gap = gap.unwrap_or_else(|| panic!("{:?}", verified.gaps));
    assert!(gap.explained.is_some(), "{gap:?}");
    let events = SessionReader::open(&path).unwrap().events().unwrap();
    let missed: u64 = events
        .iter()
        .filter(|event| event.kind == "frames-missed")
        .map(|event| -> u64 { event.text.split(' ').next().unwrap().parse().unwrap() })
        .sum();
    assert_eq!(missed, session.frames_dropped().await.unwrap());
    assert!(missed >= MEANWHILE - 2, "{events:?}");
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "{log}");
}
