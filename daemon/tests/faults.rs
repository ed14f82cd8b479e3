//! What happens when an instrument, a wire or the disk fails.

mod stage;

use bench::{Instrument, Pace, Profile, Scene, ServeOptions, SimulatedRig, Wire};
use bus::{Fault, Options};
use logbook::SessionReader;
use stage::{SMALL, Stage, within};

#[tokio::test(flavor = "multi_thread")]
async fn an_overload_is_a_flag_and_not_a_number() {
    let stage = Stage::new(&SMALL.replace(
        "[record]",
        "current_ua = 5000.0\ncompliance_v = 50.0\nrange_v = 0.1\n[record]",
    ));
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(1)).await.unwrap();
    let frame = session.latest_frame().await.unwrap();
    let over = frame.flags.iter().filter(|flag| **flag == 1).count();
    assert!(
        over > 0,
        "neighbours of the driven pair are over 0.12 V: {:?}",
        frame.volts
    );
    assert_eq!(frame.quality.whole("overloads").unwrap(), Some(over as u64));
    for (volts, flag) in frame.volts.iter().zip(&frame.flags) {
        assert_eq!(volts.is_nan(), *flag != 0, "{volts} with flag {flag}");
    }
    match session.latest_map().await {
        Ok(map) => assert_eq!(map.more.whole("masked").unwrap(), Some(over as u64)),
        Err(refused) => {
            assert!(matches!(refused, Fault::NoFrame(_)), "{refused:?}");
            let why = session.last_error().await.unwrap();
            assert!(why.contains("missing"), "{why}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_refuses_ends_the_session_and_says_so() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start_on_a_small_disk(400).await;
    daemon.baseline(2).await;
    let session = daemon.start(Options::new()).await;
    let refused = within(session.wait()).await.unwrap_err();
    let text = refused.to_string();
    assert!(
        text.contains("source is off") && text.contains(".tactus"),
        "{text}"
    );
    assert_eq!(session.state().await.unwrap(), "faulted");
    assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
    assert_eq!(daemon.manager.last_error().await.unwrap(), text);
    let acknowledged = session.frames_durable().await.unwrap();
    let record = SessionReader::open(session.path().await.unwrap()).unwrap();
    assert!(acknowledged > 0);
    assert!(
        record.len().unwrap() >= acknowledged,
        "what was acknowledged is there"
    );
}

/// A rig on TCP that a test can break, and a configuration for it.
async fn on_tcp() -> (SimulatedRig, bench::Server, String) {
    let scene = Scene::parse("scene", "[disc-tank]\nelectrodes = 16\n").unwrap();
    let rig = SimulatedRig::new(&Profile::default().at_pace(Pace::Instant), scene).unwrap();
    let options = ServeOptions {
        port_6221: 0,
        port_34980a: 0,
        ..ServeOptions::default()
    };
    let server = bench::serve(rig.clone(), &options).await.unwrap();
    let (source, mainframe) = (&server.ready().source, &server.ready().mainframe);
    let config = format!(
        "{}\n[source]\naddress = \"tcp:{source}\"\ndeadline_ms = 2000\n[switch]\naddress = \"tcp:{mainframe}\"\n\
         [voltmeter]\naddress = \"tcp:{mainframe}\"\n",
        SMALL
            .replace("\"simulated\"", "\"instruments\"")
            .replace("profile = \"PROFILE\"\nscene = \"scene.toml\"\n", "")
    );
    (rig, server, config)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_source_that_is_lost_is_said_looked_for_and_verified_off_on_return() {
    let (rig, _server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    assert!(!daemon.manager.simulated().await.unwrap());
    let instruments = daemon.manager.instruments().await.unwrap();
    let source = daemon.instrument(&instruments[0]).await;
    assert!(source.address().await.unwrap().starts_with("tcp:"));
    assert!(source.identity().await.unwrap().contains("6221"));
    daemon.baseline(1).await;
    let session = daemon.start(Options::new()).await;
    let mut frames = session.receive_frame_done().await.unwrap();
    within(bus::next(&mut frames)).await.unwrap();

    rig.set_wire(Instrument::Source, Wire::Cut);
    let refused = within(session.wait()).await.unwrap_err();
    let text = refused.to_string();
    let first = text.split(". ").next().unwrap();
    assert!(
        first.contains("6221") && first.contains("NOT verified off"),
        "{text}"
    );
    assert!(!text.contains("''") && text.len() < 400, "{text}");
    assert!(
        rig.closed().is_empty(),
        "the relays are open although the source cannot be told"
    );
    assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
    assert!(source.state().await.unwrap().starts_with("fault"));
    let refused = daemon
        .manager
        .start_session(&Options::new())
        .await
        .unwrap_err();
    assert!(
        matches!(&refused, Fault::InstrumentFault(text) if text.contains("6221") || text.contains("source")),
        "{refused:?}"
    );

    let properties = zbus::fdo::PropertiesProxy::builder(&daemon.connection)
        .destination(bus::BUS_NAME)
        .path(bus::ROOT_PATH)
        .build()
        .await
        .unwrap();
    let mut changes = properties.receive_properties_changed().await.unwrap();
    rig.set_wire(Instrument::Source, Wire::Sound);
    while daemon.manager.state().await.unwrap() != "idle" {
        within(bus::next(&mut changes)).await.unwrap();
    }
    assert_eq!(source.state().await.unwrap(), "ready");
    let (on, _) = rig.source_output();
    assert!(!on, "off, and verified, before anybody measures again");
    let session = daemon.start(Options::new().with("count", 2_u64)).await;
    within(session.wait()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_is_killed_leaves_what_was_acknowledged_and_the_next_makes_the_rig_safe() {
    let (rig, _server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new()).await;
    let mut frames = session.receive_frame_done().await.unwrap();
    let signal = within(bus::next(&mut frames)).await.unwrap();
    let acknowledged = signal.args().unwrap().sequence;
    let path = session.path().await.unwrap();
    daemon.kill().await;
    let record = SessionReader::open(path).unwrap();
    assert!(record.len().unwrap() >= acknowledged);
    assert!(record.closed().is_none());

    let next = stage.start().await;
    assert!(!rig.source_output().0 && rig.closed().is_empty());
    let listed = next.manager.list_sessions(&Options::new()).await.unwrap();
    assert_eq!(listed[0].state, "interrupted");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_wrong_instrument_at_an_address_is_refused_by_name() {
    let (_rig, server, config) = on_tcp().await;
    let (source, mainframe) = (&server.ready().source, &server.ready().mainframe);
    let config = config.replace(
        &format!("[source]\naddress = \"tcp:{source}\""),
        &format!("[source]\naddress = \"tcp:{mainframe}\""),
    );
    let stage = Stage::new(&config);
    let output = within(tokio::task::spawn_blocking(move || stage.run(&[])))
        .await
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1));
    assert!(said.contains("34980A") && said.contains("6221"), "{said}");
}
