//! A session that has ended is never resumed, even if its disk is full or its file is locked or deleted.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::mounts::{has_own_mounts, mount};
use crate::stage::{Running, SMALL, Stage, instant, ports, reported, serve, within};
use dbus::{Fault, Options, Session1Proxy};
use logbook::{SessionKind, SessionReader};
use rustix::fs::FlockOperation;
use simulator::Profile;

pub fn resuming() -> String {
    SMALL.replace("resume = false", "resume = true")
}

/// The time that the daemon waits for a lock before it begins the next part.
const LOCK_TIMEOUT: Duration = Duration::from_secs(30);

/// Waits until this number of frames is on disk.
pub async fn durable(session: &Session1Proxy<'_>, frames: u64) {
    let mut done = session.receive_frame_done().await.unwrap();
    while session.frames_durable().await.unwrap() < frames {
        within(dbus::next(&mut done)).await.unwrap();
    }
}

/// The parts of measurements in a folder.
fn measurements(folder: &Path) -> Vec<SessionReader> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|end| end == "tactus"))
        .collect();
    paths.sort();
    paths
        .into_iter()
        .filter_map(|path| SessionReader::open(path).ok())
        .filter(|part| part.header().kind == SessionKind::Measurement)
        .collect()
}

/// The frames of all measurements of a folder.
pub fn recorded(folder: &Path) -> BTreeSet<u64> {
    measurements(folder)
        .iter()
        .flat_map(|part| {
            let frames: Vec<u64> = part
                .frames()
                .map(|record| record.unwrap().frame.sequence)
                .collect();
            frames
        })
        .collect()
}

/// Starts the next daemon and asserts that nothing is resumed.
pub async fn assert_stays_ended(stage: &Stage) -> Running {
    let daemon = stage.start().await;
    let state = daemon.manager.state().await.unwrap();
    assert_eq!(state, "idle", "a session that was stopped goes on");
    assert!(
        logbook::interrupted(stage.path().join("state"))
            .unwrap()
            .is_empty()
    );
    daemon
}

/// Mounts a separate disk for the record, so small that a session fills it.
fn small_disk(stage: &Stage) -> PathBuf {
    let state = stage.path().join("state");
    std::fs::create_dir(&state).unwrap();
    mount(&["-t", "tmpfs", "-o", "size=3m", "none"], &state);
    state
}

fn more_space(state: &Path) {
    mount(&["-o", "remount,size=30m"], state);
}

/// Fills the free space of a disk; returns the file.
fn fill(state: &Path) -> PathBuf {
    use std::io::Write;
    let path = state.join("ballast");
    let mut file = std::fs::File::create(&path).unwrap();
    while file.write_all(&[0; 4096]).is_ok() {}
    path
}

/// Starts a session and fills the disk of its record.
async fn paused_on_a_full_disk(daemon: &Running, state: &Path) -> Session1Proxy<'static> {
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("every_s", 0.001)).await;
    durable(&session, 3).await;
    fill(state);
    reported(&mut happened, "disk-full").await;
    session
}

/// A daemon whose session is paused on a full disk: stage, the record's disk, daemon, session.
async fn full_disk() -> (Stage, PathBuf, Running, Session1Proxy<'static>) {
    let stage = Stage::new(&resuming());
    let state = small_disk(&stage);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = paused_on_a_full_disk(&daemon, &state).await;
    (stage, state, daemon, session)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_on_a_full_disk_is_honoured_by_the_next_daemon() {
    if !has_own_mounts("endings::a_stop_on_a_full_disk_is_honoured_by_the_next_daemon") {
        return;
    }
    let (stage, state, daemon, session) = full_disk().await;
    let stopped = within(session.stop()).await;
    daemon.kill().await;
    std::fs::remove_file(state.join("ballast")).unwrap();
    more_space(&state);
    let daemon = assert_stays_ended(&stage).await;
    let parts = measurements(&state);
    let reason = &parts.last().unwrap().closed().unwrap().reason;
    assert!(
        reason.contains("stopped on request"),
        "{reason} {stopped:?}"
    );
    daemon.terminate().await;
}

/// If the end mark cannot be stored on the record's disk, it is stored in the runtime directory; if that fails too, it
/// is reported.
#[tokio::test(flavor = "multi_thread")]
async fn unrecordable_end_is_reported() {
    if !has_own_mounts("endings::unrecordable_end_is_reported") {
        return;
    }
    for runtime_too in [false, true] {
        let stage = Stage::new(&resuming());
        let state = small_disk(&stage);
        let daemon = stage.start().await;
        daemon.baseline(1).await;
        block_marks(&state);
        if runtime_too {
            block_marks(&stage.path().join("run"));
        }
        let mut happened = daemon.manager.receive_happened().await.unwrap();
        let session = paused_on_a_full_disk(&daemon, &state).await;
        // the end can be stored neither in the locked file nor in a next part on the full disk
        let held = lock(&session.path().await.unwrap(), false);
        let stopped = within(session.stop()).await;
        let Err(Fault::Failed(text)) = stopped else {
            panic!("{stopped:?}");
        };
        drop(held);
        if runtime_too {
            assert!(text.contains("could not be stored anywhere"), "{text}");
            let alarm = reported(&mut happened, "alarm").await;
            assert!(alarm.contains("with current"), "{alarm}");
            daemon.kill().await;
            continue;
        }
        assert!(text.contains("only until this machine restarts"), "{text}");
        daemon.kill().await;
        std::fs::remove_file(state.join("ballast")).unwrap();
        more_space(&state);
        assert_stays_ended(&stage).await.terminate().await;
    }
}

/// Creates directories in place of the marks of ended sessions.
fn block_marks(folder: &Path) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with("ended-sessions") {
            std::fs::remove_file(&path).unwrap();
            std::fs::create_dir(&path).unwrap();
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn daemon_restarted_on_a_full_disk_resumes_with_space() {
    if !has_own_mounts("endings::daemon_restarted_on_a_full_disk_resumes_with_space") {
        return;
    }
    let (stage, state, daemon, session) = full_disk().await;
    let (id, kept) = (
        session.id().await.unwrap(),
        session.frames_durable().await.unwrap(),
    );
    daemon.kill().await;
    fill(&state);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    std::fs::remove_file(state.join("ballast")).unwrap();
    more_space(&state);
    while daemon.manager.active_session().await.unwrap().as_str() == "/" {
        within(dbus::next(&mut happened)).await.unwrap();
    }
    let session = active(&daemon).await;
    assert_eq!(session.id().await.unwrap(), id);
    durable(&session, kept + 3).await;
    within(session.stop()).await.unwrap();
    let frames = session.frames_durable().await.unwrap();
    assert!(recorded(&state).into_iter().eq(1..=frames));
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn session_waiting_for_disk_space_can_be_stopped() {
    if !has_own_mounts("endings::session_waiting_for_disk_space_can_be_stopped") {
        return;
    }
    let (stage, state, daemon, session) = full_disk().await;
    let id = session.id().await.unwrap();
    daemon.kill().await;
    fill(&state);
    let daemon = stage.start().await;
    let session = active(&daemon).await;
    assert_eq!(session.id().await.unwrap(), id);
    if let Err(fault) = within(session.stop()).await {
        // the session file could not be closed, but the end mark is durable
        assert!(fault.text().contains("its end is stored in"), "{fault:?}");
    }
    assert_eq!(daemon.manager.active_session().await.unwrap().as_str(), "/");
    daemon.kill().await;
    std::fs::remove_file(state.join("ballast")).unwrap();
    more_space(&state);
    assert_stays_ended(&stage).await.terminate().await;
}

/// Locks a session's file as another program does, until the returned value is dropped.
fn lock(path: &str, of_index: bool) -> Box<dyn std::any::Any> {
    if of_index {
        // every process with read access to the journal's index can take this lock; waits for the end of a write
        let index = std::fs::File::open(format!("{path}-shm")).unwrap();
        let shared = FlockOperation::LockShared;
        rustix::fs::fcntl_lock(&index, shared).unwrap();
        return Box::new(index);
    }
    // as a database browser does that has begun a write
    let other = rusqlite::Connection::open(path).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    Box::new(other)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_locked_record_pauses_the_session_and_loses_no_frame() {
    let stage = Stage::new(&resuming());
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("every_s", 0.02)).await;
    let first = session.path().await.unwrap();
    let mut held_for = Duration::ZERO;
    for of_index in [false, true] {
        durable(&session, session.frames_durable().await.unwrap() + 2).await;
        let path = session.path().await.unwrap();
        let begun = Instant::now();
        let held = lock(&path, of_index);
        let text = reported(&mut happened, "record-locked").await;
        assert!(
            text.contains("another program") && text.contains(&path),
            "{text}"
        );
        within(async {
            while session.state().await.unwrap() != "suspended" {
                tokio::task::yield_now().await;
            }
        })
        .await;
        assert_eq!(session.last_error().await.unwrap(), text);
        drop(held);
        held_for = held_for.max(begun.elapsed());
        reported(&mut happened, "record-unlocked").await;
    }
    durable(&session, session.frames_durable().await.unwrap() + 2).await;
    within(session.stop()).await.unwrap();
    let frames = session.frames_durable().await.unwrap();
    // after a longer lock, for example on a busy machine, the next part begins
    let same = session.path().await.unwrap() == first;
    assert!(same || held_for > LOCK_TIMEOUT, "{held_for:?}");
    assert!(
        recorded(&stage.path().join("state"))
            .into_iter()
            .eq(1..=frames)
    );
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_stopped_while_its_file_is_locked_stays_ended() {
    let stage = Stage::new(&resuming());
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("every_s", 0.02)).await;
    durable(&session, 2).await;
    let held = lock(&session.path().await.unwrap(), false);
    reported(&mut happened, "record-locked").await;
    within(session.stop()).await.unwrap();
    let frames = session.frames_durable().await.unwrap();
    daemon.kill().await;
    drop(held);
    let daemon = assert_stays_ended(&stage).await;
    assert!(
        recorded(&stage.path().join("state"))
            .into_iter()
            .eq(1..=frames)
    );
    daemon.terminate().await;
}

/// The active session of a daemon: running, or waiting to be resumed.
async fn active(daemon: &Running) -> Session1Proxy<'static> {
    let path = daemon.manager.active_session().await.unwrap();
    daemon.session(&path).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_waits_for_its_rig_can_be_stopped() {
    let (_rig, server, config) = crate::stage::on_tcp().await;
    let stage = Stage::new(&config.replace("resume = false", "resume = true"));
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    let id = session.id().await.unwrap();
    within(session.step(1)).await.unwrap();
    daemon.kill().await;
    let ports = ports(&server);
    server.stop().await;

    // another source is connected now, and no user has accepted it
    let mut profile = Profile::default();
    profile.source.serial = "7654321".to_owned();
    let _other = serve(&instant(&profile), ports).await;
    let daemon = stage.start().await;
    let session = active(&daemon).await;
    assert_eq!(session.id().await.unwrap(), id);
    assert_eq!(session.state().await.unwrap(), "suspended");
    // a daemon that ends while the session is suspended leaves the session to the next daemon
    daemon.terminate().await;
    let state = stage.path().join("state");
    assert_eq!(logbook::interrupted(&state).unwrap().len(), 1);

    let daemon = stage.start().await;
    let session = active(&daemon).await;
    within(session.stop()).await.unwrap();
    assert_eq!(daemon.manager.active_session().await.unwrap().as_str(), "/");
    assert!(logbook::interrupted(&state).unwrap().is_empty());
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_is_deleted_or_replaced_loses_no_frame() {
    let stage = Stage::new(&resuming());
    let state = stage.path().join("state");
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    type Attack = fn(&str);
    let attacks: [(&str, Attack); 4] = [
        ("all files deleted", |path| {
            for end in ["", "-wal", "-shm"] {
                std::fs::remove_file(format!("{path}{end}")).unwrap();
            }
        }),
        ("the file moved", |path| {
            std::fs::rename(path, format!("{path}.away")).unwrap();
        }),
        ("the file replaced", |path| {
            std::fs::write(format!("{path}.new"), "another file").unwrap();
            std::fs::rename(format!("{path}.new"), path).unwrap();
        }),
        ("the journal deleted", |path| {
            std::fs::remove_file(format!("{path}-wal")).unwrap();
        }),
    ];
    for (attack, act) in attacks {
        let mut happened = daemon.manager.receive_happened().await.unwrap();
        let session = daemon.start(Options::new().with("step", true)).await;
        within(session.step(3)).await.unwrap();
        let path = session.path().await.unwrap();
        act(&path);
        // reported within a second, without a further frame
        let alarm = reported(&mut happened, "alarm").await;
        println!("{attack}: {alarm}");
        assert!(
            alarm.contains(&path) && alarm.contains("its frames are in"),
            "{alarm}"
        );
        within(session.step(2)).await.unwrap();
        assert_ne!(session.path().await.unwrap(), path, "{attack}");
        within(session.stop()).await.unwrap();
        assert_eq!(session.frames_durable().await.unwrap(), 5);
        let id = session.id().await.unwrap();
        let parts: Vec<SessionReader> = measurements(&state)
            .into_iter()
            .filter(|part| part.header().session() == id)
            .collect();
        let kept: BTreeSet<u64> = parts
            .iter()
            .flat_map(|part| {
                part.frames()
                    .map(|record| record.unwrap().frame.sequence)
                    .collect::<Vec<_>>()
            })
            .collect();
        assert!(kept.into_iter().eq(1..=5), "{attack}");
    }
    daemon.terminate().await;
    // and the session is not resumed
    assert_stays_ended(&stage).await.terminate().await;
}

/// The daemon is started with a umask that makes files readable by all users.
#[tokio::test(flavor = "multi_thread")]
async fn what_is_recorded_is_not_for_strangers_to_read() {
    use std::os::unix::fs::PermissionsExt;
    let stage = Stage::new(SMALL);
    let mut shell = tokio::process::Command::new("sh");
    shell
        .args(["-c", "umask 022; exec \"$0\" \"$@\""])
        .arg(env!("CARGO_BIN_EXE_tactusd"));
    let daemon = stage.start_by(shell).await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(1)).await.unwrap();
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o7777;
    let state = stage.path().join("state");
    assert_eq!(mode(&state), 0o750);
    let mut seen = 0;
    for entry in std::fs::read_dir(&state).unwrap() {
        let path = entry.unwrap().path();
        assert_eq!(mode(&path), 0o640, "{}", path.display());
        seen += 1;
    }
    assert!(seen >= 5, "{seen} files");
    daemon.terminate().await;
}
