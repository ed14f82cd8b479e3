//! How a running daemon is: well, and then not, and why.

mod stage;

use bus::Options;
use stage::{Measuring, SMALL, Stage, told, within};

/// The daemon's own answer.
async fn health(daemon: &stage::Running) -> Options {
    within(daemon.manager.health()).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_says_that_it_is_well_and_what_it_has() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let before = health(&daemon).await;
    assert_eq!(before.flag("well").unwrap(), Some(true), "{before:?}");
    assert!(!before.0.contains_key("session") && !before.0.contains_key("last_frame_ns"));
    assert!(before.whole("disk_free_bytes").unwrap().unwrap() > 0);

    daemon.baseline(2).await;
    within(daemon.manager.relays(&Options::new()))
        .await
        .unwrap();
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(3)).await.unwrap();
    let now = health(&daemon).await;
    assert_eq!(now.flag("well").unwrap(), Some(true), "{now:?}");
    assert_eq!(now.whole("frames_durable").unwrap(), Some(3));
    assert_eq!(now.whole("backlog").unwrap(), Some(0));
    assert_eq!(now.whole("total_durable").unwrap(), Some(5));
    assert_eq!(now.whole("last_frame_sequence").unwrap(), Some(3));
    assert!(now.number("baseline_age_s").unwrap().unwrap() >= 0.0);
    assert!(now.number("relay_used").unwrap().unwrap() > 0.0, "{now:?}");
    // nobody awaits a frame that is taken on request
    assert_eq!(now.number("quiet_s").unwrap(), None);
    assert_eq!(
        now.texts("instruments").unwrap().unwrap(),
        ["source: ready", "switch+voltmeter: ready"]
    );
    within(session.stop()).await.unwrap();
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_rig_and_its_failed_frame_are_trouble_until_it_is_back() {
    let Measuring {
        rig,
        server,
        stage: _stage,
        daemon,
        session,
        mut happened,
        ..
    } = Measuring::begin().await;
    let port = |address: &str| address.rsplit_once(':').unwrap().1.parse().unwrap();
    let ports = (
        port(&server.ready().source),
        port(&server.ready().mainframe),
    );
    server.stop().await;
    told(&mut happened, "suspended").await;
    let lost = health(&daemon).await;
    assert_eq!(lost.flag("well").unwrap(), Some(false));
    let troubles = lost.texts("troubles").unwrap().unwrap();
    assert!(
        troubles.iter().any(|text| text.starts_with("instrument: ")),
        "{troubles:?}"
    );
    assert_eq!(lost.whole("total_failed").unwrap(), Some(1));
    let why = lost.text("last_gap").unwrap().unwrap();
    assert!(why.contains("failed: "), "{why}");
    let instruments = lost.texts("instruments").unwrap().unwrap();
    assert!(
        instruments[0].starts_with("source: fault: "),
        "{instruments:?}"
    );

    let _server = stage::serve(&rig, ports).await;
    told(&mut happened, "resumed").await;
    let back = health(&daemon).await;
    let troubles = back.texts("troubles").unwrap().unwrap();
    assert!(
        !troubles.iter().any(|text| text.starts_with("instrument")),
        "{troubles:?}"
    );
    assert_eq!(
        back.texts("instruments").unwrap().unwrap(),
        ["source: ready", "switch+voltmeter: ready"]
    );
    within(session.stop()).await.unwrap();
}
