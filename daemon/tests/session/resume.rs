//! A session that the daemon did not end is resumed by the next one.

use crate::stage::{Running, SMALL, Stage, within};
use dbus::{Options, Session1Proxy};
use logbook::{Event, RESUMED, SessionReader};
use simulator::{Pace, Profile, Scene, SimulatedRig};

fn resuming() -> String {
    SMALL.replace("resume = false", "resume = true")
}

/// Waits until this number of frames is on disk.
async fn durable(session: &Session1Proxy<'_>, frames: u64) {
    let mut done = session.receive_frame_done().await.unwrap();
    while session.frames_durable().await.unwrap() < frames {
        within(dbus::next(&mut done)).await.unwrap();
    }
}

async fn active(daemon: &Running) -> Session1Proxy<'static> {
    let path = daemon.manager.active_session().await.unwrap();
    daemon.session(&path).await
}

/// The kinds of a session's events, without missed frames of a busy machine.
fn kinds(reader: &SessionReader) -> Vec<String> {
    reported(reader)
        .into_iter()
        .map(|event| event.kind)
        .collect()
}

fn reported(reader: &SessionReader) -> Vec<Event> {
    let mut events = reader.events().unwrap();
    events.retain(|event| event.kind != "frames-missed");
    events
}

#[tokio::test(flavor = "multi_thread")]
async fn a_killed_session_resumes_with_its_id_schedule_and_a_gap() {
    let stage = Stage::new(&resuming());
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    let options = Options::new()
        .with("every_s", 0.2)
        .with("count", 60_u64)
        .with("operator", "Ada")
        .with("nplc", 1.0);
    // a baseline with the same settings
    let alike = Options::new().with("frames", 2_u64).with("nplc", 1.0);
    let path = daemon.manager.record_baseline(&alike).await.unwrap();
    within(daemon.session(&path).await.wait()).await.unwrap();
    let session = daemon.start(options).await;
    let (id, file) = (session.id().await.unwrap(), session.path().await.unwrap());
    durable(&session, 5).await;
    daemon.kill().await;
    let kept = SessionReader::open(&file).unwrap().last_sequence().unwrap();

    let daemon = stage.start().await;
    let session = active(&daemon).await;
    assert_eq!(session.id().await.unwrap(), id);
    assert!(session.frames_durable().await.unwrap() >= kept);
    crate::stage::ended(&session).await.unwrap();
    let reader = SessionReader::open(&file).unwrap();
    let sequences = reader.frames().map(|record| record.unwrap().frame.sequence);
    assert!(sequences.eq(1..=60), "{} frames", reader.len().unwrap());
    assert!(reader.closed().is_some());
    assert_eq!(reader.header().about.operator, "Ada");
    assert_eq!(reader.frame(60).unwrap().frame.settings.nplc, 1.0);
    assert_eq!(kinds(&reader), [RESUMED, "quantities", "plausible"]);
    // the daemon was killed before the first state was stored
    let without = &reported(&reader)[1].text;
    assert!(
        without.contains("dose") && without.contains("begin again"),
        "{without}"
    );
    let reported = &reported(&reader)[0].text;
    assert!(
        reported.contains("killed") && reported.contains(&format!("was {kept} at")),
        "{reported}"
    );
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stopped_daemons_session_resumes_a_stopped_session_does_not() {
    let stage = Stage::new(&resuming());
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("every_s", 0.02)).await;
    let file = session.path().await.unwrap();
    durable(&session, 2).await;
    assert!(daemon.terminate().await.0.success());
    assert!(SessionReader::open(&file).unwrap().closed().is_none());

    let daemon = stage.start().await;
    let session = active(&daemon).await;
    session.stop().await.unwrap();
    assert!(daemon.terminate().await.0.success());
    let reader = SessionReader::open(&file).unwrap();
    assert!(reader.closed().is_some());
    assert_eq!(kinds(&reader)[..2], ["shut-down", RESUMED]);
    let reported = &reported(&reader)[1].text;
    assert!(reported.contains("stopped and started again"), "{reported}");

    let daemon = stage.start().await;
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_stopped_while_suspended_records_no_fault() {
    for resumes in [false, true] {
        let (rig, server, config) = crate::stage::on_tcp().await;
        let stage = Stage::new(&config.replace("resume = false", &format!("resume = {resumes}")));
        let daemon = stage.start().await;
        daemon.baseline(1).await;
        let mut happened = daemon.manager.receive_happened().await.unwrap();
        let session = daemon.start(Options::new()).await;
        let (id, file) = (session.id().await.unwrap(), session.path().await.unwrap());
        durable(&session, 1).await;
        let ports = crate::stage::ports(&server);
        server.stop().await;
        crate::stage::reported(&mut happened, "suspended").await;
        assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");
        // the source is not verified off
        assert_eq!(daemon.terminate().await.0.code(), Some(1));
        let reader = SessionReader::open(&file).unwrap();
        let events = reported(&reader);
        let faults = events.iter().filter(|event| event.kind == "fault");
        assert_eq!(faults.count(), 0, "{events:#?}");
        if !resumes {
            let reason = &reader.closed().unwrap().reason;
            assert!(reason.contains("SIGTERM"), "{reason}");
            continue;
        }
        assert!(reader.closed().is_none());
        let last = events.last().unwrap();
        assert!(
            last.kind == "shut-down" && last.text.contains("SIGTERM"),
            "{last:?}"
        );
        let _server = crate::stage::serve(&rig, ports).await;
        let daemon = stage.start().await;
        let session = active(&daemon).await;
        assert_eq!(session.id().await.unwrap(), id);
        session.stop().await.unwrap();
        daemon.terminate().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_go_on_is_closed_with_the_reason() {
    let stage = Stage::new(&resuming());
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    let once = session.path().await.unwrap();
    within(session.step(1)).await.unwrap();
    daemon.kill().await;

    // one resumption per hour is allowed, which the next start uses
    stage.configure(&resuming().replace("resume = true", "resume = true\nresume_per_hour = 1"));
    let daemon = stage.start().await;
    let session = active(&daemon).await;
    within(session.step(1)).await.unwrap();
    daemon.kill().await;
    let daemon = stage.start().await;
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    let reader = SessionReader::open(&once).unwrap();
    let reason = &reader.closed().unwrap().reason;
    assert!(reason.contains("1 times within an hour"), "{reason}");
    assert_eq!(reader.len().unwrap(), 2);

    // an interrupted session whose frames have another pattern than those of the next daemon
    let session = daemon.start(Options::new().with("step", true)).await;
    let whole = session.path().await.unwrap();
    daemon.kill().await;
    stage.configure(&resuming().replace("[record]", "half = true\n[record]"));
    let daemon = stage.start().await;
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    let reader = SessionReader::open(&whole).unwrap();
    let reason = &reader.closed().unwrap().reason;
    assert!(reason.contains("another protocol"), "{reason}");
    daemon.terminate().await;
}

/// If a user configures a new address for an instrument, a session with that instrument is resumed.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_resumes_with_instruments_at_new_addresses() {
    let (rig, server, config) = crate::stage::on_tcp().await;
    let config = config.replace("resume = false", "resume = true");
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    let (id, file) = (session.id().await.unwrap(), session.path().await.unwrap());
    within(session.step(2)).await.unwrap();

    // another daemon, with a separate record
    let other = Stage::new(&config);
    let refused = other.run(&[]);
    let message = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(1), "{message}");
    assert!(
        message.contains("in use by another daemon (pid"),
        "{message}"
    );
    within(session.step(1)).await.unwrap();

    assert!(daemon.terminate().await.0.success());
    drop(server);
    let (_server, moved) = crate::stage::on_tcp_with(&rig).await;
    stage.configure(&moved.replace("resume = false", "resume = true"));
    let daemon = stage.start().await;
    let session = active(&daemon).await;
    assert_eq!(session.id().await.unwrap(), id);
    assert_eq!(within(session.step(1)).await.unwrap(), 4);
    session.stop().await.unwrap();
    let reader = SessionReader::open(&file).unwrap();
    assert_eq!(kinds(&reader), ["shut-down", RESUMED, "plausible"]);
    daemon.terminate().await;
}

/// If the daemon is started by hand, nothing switches the rig off between a kill and the next start: relays are found
/// closed, and the interrupted session explains why.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_killed_in_a_frame_goes_on_by_hand_too() {
    let profile = Profile::default().at_pace(Pace::Real);
    let scene = Scene::parse("scene", "[disc-tank]\nelectrodes = 16\n").unwrap();
    let rig = SimulatedRig::new(&profile, scene).unwrap();
    let (_server, config) = crate::stage::on_tcp_with(&rig).await;
    let stage = Stage::new(&config.replace("resume = false", "resume = true"));
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new()).await;
    let id = session.id().await.unwrap();
    durable(&session, 1).await;
    within(async {
        while rig.closed().is_empty() || !rig.source_output().0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    daemon.kill().await;
    assert!(!rig.closed().is_empty(), "what the killed daemon left");

    let daemon = stage.start().await;
    let session = active(&daemon).await;
    assert_eq!(session.id().await.unwrap(), id);
    durable(&session, session.frames_durable().await.unwrap() + 1).await;
    let health = daemon.manager.health().await.unwrap();
    let instruments = health.instruments.unwrap();
    assert!(
        instruments
            .iter()
            .all(|reported| reported.ends_with(": ready")),
        "{instruments:?}"
    );
    within(session.stop()).await.unwrap();
    assert!(!rig.source_output().0 && rig.closed().is_empty());
    let events = logbook::read_daemon_log(stage.path().join("state")).unwrap();
    assert!(
        events
            .iter()
            .any(|event| event.kind == "opened" && event.text.contains("was interrupted")),
        "{events:?}"
    );
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_kill_left_of_new_files_is_removed_at_the_start() {
    let stage = Stage::new(&resuming());
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(1)).await.unwrap();
    let (id, file) = (session.id().await.unwrap(), session.path().await.unwrap());
    daemon.kill().await;
    let stub = stage.path().join(format!("state/{id}_p2.tactus"));
    std::fs::write(&stub, "").unwrap();
    let daemon = stage.start_with_its_usual_words().await;
    assert!(!stub.exists());
    let session = active(&daemon).await;
    assert_eq!(session.path().await.unwrap(), file);
    session.stop().await.unwrap();
    let listed = daemon.manager.list_sessions(&Options::new()).await.unwrap();
    assert_eq!(listed.len(), 2);
    daemon.terminate().await;
}
