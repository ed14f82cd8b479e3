//! Faults of an instrument, a connection or the disk during a session.

use crate::stage::{
    Measuring, SMALL, Stage, assert_off_before_anything_else, on_tcp, on_tcp_with, reported, within,
};
use dbus::{Fault, Options};
use logbook::SessionReader;
use simulator::{Instrument, Pace, Profile, Scene, SimulatedRig, TranscriptLine, Wire};

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
    assert_eq!(frame.quality.overloads, Some(over as u64));
    for (volts, flag) in frame.volts.iter().zip(&frame.flags) {
        assert_eq!(volts.is_nan(), *flag != 0, "{volts} with flag {flag}");
    }
    match session.latest_map().await {
        Ok(map) => assert_eq!(map.more.masked, Some(over as u64)),
        Err(refused) => {
            assert!(matches!(refused, Fault::NoFrame(_)), "{refused:?}");
            let why = session.last_error().await.unwrap();
            assert!(why.contains("missing"), "{why}");
        }
    }
}

/// Files on this disk cannot grow beyond 0.6 MB. SQLite reports an I/O error, after which the state of the file is
/// unknown.
#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_cannot_be_written_is_followed_by_the_next_part() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start_on_a_small_disk(600).await;
    daemon.baseline(2).await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new()).await;
    let first = session.path().await.unwrap();
    let alarm = reported(&mut happened, "alarm").await;
    // the daemon would disconnect this client as unresponsive if the signals were not read
    drop(happened);
    assert!(
        alarm.contains(&format!("writing to {first} has stopped")),
        "{alarm}"
    );
    let mut frames = session.receive_frame_done().await.unwrap();
    within(dbus::next(&mut frames)).await.unwrap();
    drop(frames);
    let second = session.path().await.unwrap();
    assert!(second != first && second.contains("_p"), "{second}");
    session.stop().await.unwrap();
    let acknowledged = session.frames_durable().await.unwrap();
    // if frames of a part are repeated in the next part, those in the next part are valid
    let mut sequences = std::collections::BTreeSet::new();
    for entry in std::fs::read_dir(stage.path().join("state")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|end| end == "tactus") {
            let part = SessionReader::open(&path).unwrap();
            if part.header().kind == logbook::SessionKind::Measurement {
                sequences.extend(part.frames().map(|record| record.unwrap().frame.sequence));
            }
        }
    }
    assert!(
        sequences.into_iter().eq(1..=acknowledged),
        "{acknowledged} acknowledged"
    );
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lost_source_is_verified_off_before_the_session_goes_on() {
    let Measuring {
        rig,
        daemon,
        session,
        mut happened,
        mut frames,
        server: _server,
        stage: _stage,
    } = Measuring::begin().await;
    assert!(!daemon.manager.simulated().await.unwrap());
    let instruments = daemon.manager.instruments().await.unwrap();
    let source = daemon.instrument(&instruments[0]).await;
    assert!(source.address().await.unwrap().starts_with("tcp:"));
    assert!(source.identity().await.unwrap().contains("6221"));

    rig.keep_transcript();
    rig.set_wire(Instrument::Source, Wire::Cut);
    let mut kinds: Vec<String> = Vec::new();
    loop {
        let signal = within(dbus::next(&mut happened)).await.unwrap();
        let reported = signal.args().unwrap();
        let again = kinds.last().is_some_and(|last| last == reported.kind);
        // the number of attempts before this test has restored the connection depends on the machine
        if !(again && reported.kind == "reconnecting") {
            kinds.push(reported.kind.to_string());
        }
        match reported.kind {
            "frame-failed" => {
                let first = reported.text.split(". ").next().unwrap();
                assert!(
                    first.contains("6221") && first.contains("NOT verified off"),
                    "{first}"
                );
                assert!(
                    !reported.text.contains("''") && reported.text.len() < 400,
                    "{}",
                    reported.text
                );
                assert!(
                    rig.closed().is_empty(),
                    "open although the state of the source is unknown"
                );
            }
            "source-unknown" => {
                assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");
            }
            "reconnecting" if again => {
                assert_eq!(daemon.manager.state().await.unwrap(), "suspended");
                assert!(source.state().await.unwrap().starts_with("fault"));
                let recovery = daemon.manager.recovery().await.unwrap();
                assert!(recovery.tries >= Some(2), "{recovery:?}");
                rig.set_wire(Instrument::Source, Wire::Sound);
            }
            "resumed" => break,
            _ => {}
        }
    }
    assert_off_before_anything_else(&rig.transcript());
    assert_eq!(
        kinds,
        [
            "frame-failed",
            "source-unknown",
            "transcript",
            "suspended",
            "reconnecting",
            "source-off",
            "reconnected",
            "settings-verified",
            "resumed"
        ]
    );
    assert_eq!(daemon.manager.source_state().await.unwrap(), "in use");
    let recovery = daemon.manager.recovery().await.unwrap();
    assert_eq!(recovery, dbus::Recovery::default());
    let acquired = session.frames_acquired().await.unwrap();
    while session.frames_acquired().await.unwrap() < acquired + 2 {
        within(dbus::next(&mut frames)).await.unwrap();
    }
    within(session.stop()).await.unwrap();
    let record = SessionReader::open(session.path().await.unwrap()).unwrap();
    let events: Vec<String> = record
        .events()
        .unwrap()
        .into_iter()
        .map(|event| event.kind)
        .collect();
    let mut steps = events.clone();
    steps.dedup();
    assert_eq!(steps, kinds, "every step is an event of the record");
    assert_eq!(
        record.len().unwrap(),
        session.frames_acquired().await.unwrap()
    );
    assert_eq!(source.state().await.unwrap(), "ready");
}

/// Cuts both links between two frames, so that both fail in the next one, and calls `react` with kind and text of each
/// event until the session has resumed; the frame must be taken. Returns the kinds of the events.
async fn both_links_lost(react: impl Fn(&SimulatedRig, &str, &str)) -> Vec<String> {
    let (rig, _server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(1)).await.unwrap();
    rig.set_wire(Instrument::Source, Wire::Cut);
    rig.set_wire(Instrument::Mainframe, Wire::Cut);
    let stepped = session.clone();
    let step = tokio::spawn(async move { stepped.step(1).await });
    let mut kinds = Vec::new();
    while kinds.last().is_none_or(|kind| kind != "resumed") {
        let signal = within(dbus::next(&mut happened)).await.unwrap();
        let reported = signal.args().unwrap();
        react(&rig, reported.kind, reported.text);
        kinds.push(reported.kind.to_string());
    }
    assert_eq!(
        within(step).await.unwrap().unwrap(),
        2,
        "the frame is taken after all"
    );
    kinds
}

/// Asserts that these steps were reported, in this order.
fn assert_in_order<const N: usize>(kinds: &[String], steps: [&str; N]) {
    let steps = steps.map(|wanted| kinds.iter().position(|kind| kind == wanted));
    assert!(
        steps.iter().all(Option::is_some) && steps.is_sorted(),
        "{kinds:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn both_links_lost_is_an_alarm_and_the_first_back_is_made_safe() {
    let kinds = both_links_lost(|rig, kind, text| match kind {
        "alarm" => assert!(text.contains("may be live"), "{text}"),
        // the switch returns first: its relays are opened while the source is still missing
        "reconnecting" => rig.set_wire(Instrument::Mainframe, Wire::Sound),
        "relays-open" => {
            assert!(rig.closed().is_empty());
            rig.set_wire(Instrument::Source, Wire::Sound);
        }
        _ => {}
    })
    .await;
    assert_in_order(&kinds, ["alarm", "relays-open", "source-off", "resumed"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn relays_of_a_rig_that_returns_at_once_are_reported_open() {
    let kinds = both_links_lost(|rig, kind, _| {
        // before the first attempt to reconnect, which therefore succeeds, unless the machine is very busy
        if kind == "alarm" {
            rig.set_wire(Instrument::Source, Wire::Sound);
            rig.set_wire(Instrument::Mainframe, Wire::Sound);
        }
    })
    .await;
    for safe in ["source-off", "relays-open"] {
        assert_in_order(&kinds, ["alarm", safe, "reconnected"]);
    }
    // a first attempt that fails may find the switch alone
    if !kinds.iter().any(|kind| kind == "reconnecting") {
        assert_in_order(&kinds, ["source-off", "relays-open"]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_ends_a_session_that_waits_for_its_rig() {
    let Measuring {
        rig,
        session,
        mut happened,
        // kept alive until the end of the test
        daemon: _daemon,
        server: _server,
        stage: _stage,
        ..
    } = Measuring::begin().await;
    rig.set_wire(Instrument::Mainframe, Wire::Cut);
    while within(dbus::next(&mut happened))
        .await
        .unwrap()
        .args()
        .unwrap()
        .kind
        != "reconnecting"
    {}
    within(session.stop()).await.unwrap();
    assert!(!rig.source_output().0);
    assert_eq!(session.end_reason().await.unwrap(), "stopped on request");
}

#[tokio::test(flavor = "multi_thread")]
async fn relays_found_closed_at_the_start_wait_for_a_person() {
    let (rig, _server, config) = on_tcp().await;
    rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1040)");
    rig.receive(Instrument::Source, "OUTP ON;:SOUR:CURR 1e-3");
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    assert!(!rig.source_output().0, "off before anything else");
    assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
    let why = daemon.manager.last_error().await.unwrap();
    assert!(
        why.contains("1040") && why.contains("electrodes 5 and 6") && why.contains("open-all"),
        "{why}"
    );
    let refused = daemon
        .manager
        .record_baseline(&Options::new())
        .await
        .unwrap_err();
    assert!(
        matches!(&refused, Fault::InstrumentFault(text) if text.contains("1040")),
        "{refused:?}"
    );
    assert!(!rig.closed().is_empty(), "nobody has opened it");
    let done = daemon.manager.open_all().await.unwrap();
    assert!(done.contains("1040") && rig.closed().is_empty(), "{done}");
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    daemon.baseline(1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_goes_away_ends_nothing() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let address = dbus::Address::Unix(stage.path().join("run/peer"));
    let (client, _) = dbus::connect(Some(&address)).await.unwrap();
    let manager = dbus::Manager1Proxy::new(&client).await.unwrap();
    let path = manager.start_session(&Options::new()).await.unwrap();
    client.close().await.unwrap();
    drop(manager);
    let session = daemon.session(&path).await;
    let mut frames = session.receive_frame_done().await.unwrap();
    for _ in 0..3 {
        within(dbus::next(&mut frames)).await.unwrap();
    }
    assert_eq!(session.state().await.unwrap(), "running");
    within(session.stop()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn sigterm_during_a_scan_switches_off_at_once_and_verifies() {
    let profile = Profile::default().at_pace(Pace::Real);
    let scene = Scene::parse("scene", "[disc-tank]\nelectrodes = 16\n").unwrap();
    let rig = SimulatedRig::new(&profile, scene).unwrap();
    let (_server, config) = on_tcp_with(&rig).await;
    // a scan of sixteen readings takes six seconds
    let stage = Stage::new(&config.replace("[survey]\n", "[survey]\nnplc = 20\n"));
    let daemon = stage.start().await;
    let frames = Options::new().with("frames", 100_u64);
    daemon.manager.record_baseline(&frames).await.unwrap();
    within(async {
        while !rig.source_output().0 || rig.source_output().1.0 == 0.0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    rig.keep_transcript();
    let requested = std::time::Instant::now();
    let ended = tokio::spawn(daemon.terminate());
    within(async {
        while rig.source_output().0 {
            tokio::task::yield_now().await;
        }
    })
    .await;
    let off = requested.elapsed();
    println!("source off {off:?} after SIGTERM");
    // a scan takes six seconds; 1 s is promised
    assert!(off < std::time::Duration::from_secs(10), "{off:?}");
    let (status, log) = within(ended).await.unwrap();
    assert!(status.success(), "{log}");
    assert!(!rig.source_output().0 && rig.closed().is_empty(), "{log}");
    let message = rig.transcript();
    let is_off = |message: &&TranscriptLine| {
        message.instrument == Instrument::Source && message.received.contains("CLE")
    };
    let off = message
        .iter()
        .find(is_off)
        .unwrap_or_else(|| panic!("{message:#?}"));
    let states = off.answered.as_deref().unwrap_or_default();
    assert!(
        off.received.contains("OUTP?"),
        "asked in the same message: {off:?}"
    );
    assert!(states.starts_with("0.000000E+00;0"), "{off:?}");
    let opened = message
        .iter()
        .rev()
        .find(|message| message.instrument == Instrument::Mainframe);
    let opened = opened.unwrap_or_else(|| panic!("{message:#?}"));
    assert!(
        opened.received.contains("OPEN (") && opened.received.contains("CLOS? ("),
        "{opened:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_kill_frames_are_kept_and_the_rig_is_made_safe() {
    let Measuring {
        rig,
        daemon,
        session,
        stage,
        server: _server,
        mut frames,
        ..
    } = Measuring::begin().await;
    let signal = within(dbus::next(&mut frames)).await.unwrap();
    let acknowledged = signal.args().unwrap().sequence;
    let path = session.path().await.unwrap();
    daemon.kill().await;
    let record = SessionReader::open(path).unwrap();
    assert!(record.len().unwrap() >= acknowledged);
    assert!(record.closed().is_none());

    // what systemd runs before it starts the daemon again (ExecStopPost, ExecStartPre)
    let stage = std::sync::Arc::new(stage);
    let before = std::sync::Arc::clone(&stage);
    let safe_off = tokio::task::spawn_blocking(move || before.run(&["--safe-off"]))
        .await
        .unwrap();
    assert!(safe_off.status.success(), "{safe_off:?}");
    assert!(!rig.source_output().0 && rig.closed().is_empty());
    let next = stage.start().await;
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
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        message.contains("34980A") && message.contains("6221"),
        "{message}"
    );
}
