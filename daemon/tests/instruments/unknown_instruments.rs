//! An instrument or module other than the expected one must be accepted by a user, even if it was exchanged while no
//! daemon was running.

use crate::stage::{Measuring, Stage, instant, on_tcp, ports, reported, serve, within};
use dbus::{Fault, Options};
use simulator::{Instrument, Profile, SimulatedRig, Wire};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpListener;
use tokio::sync::mpsc::{UnboundedSender, unbounded_channel};

/// A rig with another source, and with another module if requested.
fn other(module: bool) -> SimulatedRig {
    let mut profile = Profile::default();
    profile.source.serial = "7654321".to_owned();
    if module {
        profile.slots[4] = Some("34931A".parse().unwrap());
    }
    let rig = instant(&profile);
    rig.keep_transcript();
    rig
}

/// Asserts that an unknown instrument received an identity query and no other message.
fn assert_untouched(rig: &SimulatedRig) {
    let message = rig.transcript().into_iter();
    let reported: Vec<String> = message
        .filter(|message| {
            message.instrument == Instrument::Source && message.received.contains("OUTP")
        })
        .map(|message| message.received)
        .collect();
    assert!(reported.is_empty(), "{reported:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn another_serial_number_waits_for_a_person() {
    let Measuring {
        rig,
        server,
        stage: _stage,
        daemon,
        session,
        mut happened,
        ..
    } = Measuring::begin().await;
    let ports = ports(&server);
    server.stop().await;
    let stranger = other(false);
    let _other = serve(&stranger, ports).await;
    let text = reported(&mut happened, "others-found").await;
    assert!(text.contains("7654321"), "{text}");
    assert_eq!(session.state().await.unwrap(), "suspended");
    assert_untouched(&stranger);
    while daemon.manager.recovery().await.unwrap().person != Some(true) {
        within(dbus::next(&mut happened)).await.unwrap();
    }
    let agreed = daemon.manager.accept_instruments().await.unwrap();
    assert!(agreed.contains("7654321"), "{agreed}");
    reported(&mut happened, "resumed").await;
    let instruments = daemon.manager.instruments().await.unwrap();
    let source = daemon.instrument(&instruments[0]).await;
    assert!(source.identity().await.unwrap().contains("7654321"));
    let refused = daemon.manager.accept_instruments().await.unwrap_err();
    assert!(matches!(refused, Fault::Unsupported(_)), "{refused:?}");
    drop(rig);
}

#[tokio::test(flavor = "multi_thread")]
async fn another_source_without_its_mainframe_is_not_reported_off() {
    let Measuring {
        rig,
        server,
        stage: _stage,
        daemon,
        mut happened,
        ..
    } = Measuring::begin().await;
    rig.set_wire(Instrument::Source, Wire::Cut);
    reported(&mut happened, "source-unknown").await;
    let ports = ports(&server);
    server.stop().await;
    let stranger = other(false);
    stranger.set_wire(Instrument::Mainframe, Wire::Cut);
    let _other = serve(&stranger, ports).await;
    loop {
        let signal = within(dbus::next(&mut happened)).await.unwrap();
        let reported = signal.args().unwrap();
        assert_ne!(reported.kind, "source-off", "{}", reported.text);
        if reported.kind == "reconnecting" && reported.text.contains("7654321") {
            break;
        }
    }
    assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");
    assert_untouched(&stranger);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_new_rig_reached_after_its_reload_needs_no_acceptance() {
    let (_rig, server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let (source, _) = ports(&server);
    let mainframe = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = mainframe.local_addr().unwrap();
    drop(mainframe);
    stage.configure(&config.replace(&server.ready().mainframe, &address.to_string()));
    let text = within(daemon.manager.reload()).await.unwrap();
    assert!(text.contains("its rig cannot be reached"), "{text}");
    server.stop().await;
    // another source at the address of the source before
    let _other = serve(&other(false), (source, address.port())).await;
    reported(&mut happened, "reconnected").await;
    daemon.baseline(1).await;
    daemon.terminate().await;
    let file = stage.path().join("state/known-instruments.json");
    assert!(std::fs::read_to_string(&file).unwrap().contains("7654321"));
}

/// Serves a source whose connection breaks when it is switched off, and reports each time.
async fn serve_broken(listener: TcpListener, broken: UnboundedSender<()>) {
    loop {
        let (stream, _) = listener.accept().await.unwrap();
        let (reader, mut writer) = stream.into_split();
        let mut lines = BufReader::new(reader).lines();
        while let Ok(Some(line)) = lines.next_line().await {
            let reply = match line.as_str() {
                "*IDN?" => "KEITHLEY INSTRUMENTS INC.,MODEL 6221,7654321,D04\n",
                line if line.contains("OUTP") => {
                    let _ = broken.send(());
                    break;
                }
                _ => "0,\"No error\"\n",
            };
            if writer.write_all(reply.as_bytes()).await.is_err() {
                break;
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_source_that_a_retry_leaves_unverified_is_unknown() {
    let (_rig, server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    let (source, _) = ports(&server);
    let mainframe = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = mainframe.local_addr().unwrap().to_string();
    drop(mainframe);
    stage.configure(&config.replace(&server.ready().mainframe, &address));
    let text = within(daemon.manager.reload()).await.unwrap();
    assert!(text.contains("its rig cannot be reached"), "{text}");
    assert_eq!(daemon.manager.source_state().await.unwrap(), "off");
    server.stop().await;
    // another source at the address of the source before
    let listener = TcpListener::bind(("127.0.0.1", source)).await.unwrap();
    let (broken, mut breaks) = unbounded_channel();
    tokio::spawn(serve_broken(listener, broken));
    // the second attempt begins after the first
    for _ in 0..2 {
        within(breaks.recv()).await.unwrap();
    }
    assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");
    stage.configure(&config);
    let refused = within(daemon.manager.reload()).await.unwrap_err();
    assert!(
        matches!(&refused, Fault::InstrumentFault(text) if text.contains("cannot be switched off")),
        "{refused:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_exchanged_while_no_daemon_ran_waits_for_a_person() {
    let (_rig, server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    daemon.terminate().await;
    let ports = ports(&server);
    server.stop().await;
    let stranger = other(true);
    let _other = serve(&stranger, ports).await;

    let daemon = stage.start().await;
    assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
    let why = daemon.manager.last_error().await.unwrap();
    for reported in [
        "7654321",
        "slot 5: empty is expected",
        "34931A",
        "tactus instruments accept",
    ] {
        assert!(why.contains(reported), "no {reported} in {why}");
    }
    assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");
    let refused = daemon.manager.record_baseline(&Options::new()).await;
    assert!(
        matches!(&refused, Err(Fault::InstrumentFault(text)) if text.contains("7654321")),
        "{refused:?}"
    );
    assert_untouched(&stranger);
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    while daemon.manager.accept_instruments().await.is_err() {
        within(dbus::next(&mut happened)).await.unwrap();
    }
    reported(&mut happened, "reconnected").await;
    daemon.baseline(1).await;
    assert_eq!(daemon.manager.source_state().await.unwrap(), "off");
    daemon.terminate().await;

    // the accepted instrument is expected by the next daemon
    let daemon = stage.start().await;
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    daemon.terminate().await;
    let file = stage.path().join("state/known-instruments.json");
    assert!(std::fs::read_to_string(&file).unwrap().contains("7654321"));
    std::fs::write(&file, "{").unwrap();
    let refused = within(tokio::task::spawn_blocking(move || stage.run(&[])))
        .await
        .unwrap();
    let message = String::from_utf8_lossy(&refused.stderr);
    assert!(
        refused.status.code() == Some(1) && message.contains("known-instruments.json is damaged"),
        "{message}"
    );
}
