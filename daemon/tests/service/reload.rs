//! Changes of the configuration while the daemon is running, and the recorded transcript.

use crate::stage::{Running, SMALL, Stage, on_tcp, reported, within};
use dbus::{Fault, Options};
use rig::transcript::{parse_transcript, read_transcript};
use simulator::{
    Comparison, Instrument, Pace, Profile, ReplayTarget, Scene, SimulatedRig, Wire, replay,
};

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_configuration_changes_nothing_and_names_the_line() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let before = daemon.manager.plan().await.unwrap();
    stage.configure(&SMALL.replace("[record]", "current_ua = 9e9\n[record]"));
    let refused = daemon.manager.reload().await.unwrap_err();
    assert!(
        matches!(&refused, Fault::Configuration(text) if text.contains("config.toml:12:14:")),
        "{refused:?}"
    );
    let text = reported(&mut happened, "reload-refused").await;
    assert!(
        text.contains("stays") && text.contains("config.toml:12:14:"),
        "{text}"
    );
    stage.configure("[rig\n");
    daemon.hang_up();
    let text = reported(&mut happened, "reload-refused").await;
    assert!(text.contains("config.toml:1:"), "{text}");
    let after = daemon.manager.plan().await.unwrap();
    assert_eq!(before.current_a, after.current_a);
    daemon.baseline(1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_model_changes_nothing_and_is_named() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let method = async |daemon: &Running| daemon.manager.status().await.unwrap().method;
    let before = method(&daemon).await;
    let file = stage.path().join("model.safetensors");
    let with_model = format!("{SMALL}\n[model]\nfile = \"{}\"\n", file.display());
    // the file does not exist, then it is not a model
    for content in [None, Some("not a model")] {
        if let Some(content) = content {
            std::fs::write(&file, content).unwrap();
        }
        stage.configure(&with_model);
        let refused = daemon.manager.reload().await.unwrap_err();
        let named = |text: &str| text.contains("model.safetensors");
        assert!(
            matches!(&refused, Fault::Configuration(text) if named(text)),
            "{refused:?}"
        );
        let text = reported(&mut happened, "reload-refused").await;
        assert!(text.contains("stays") && named(&text), "{text}");
        assert_eq!(method(&daemon).await, before);
    }
    daemon.baseline(1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_valid_reload_applies_at_once_or_at_the_sessions_end() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let current = async |daemon: &Running| daemon.manager.plan().await.unwrap().current_a;
    let with =
        |current: &str| SMALL.replace("[record]", &format!("current_ua = {current}\n[record]"));
    stage.configure(&with("500.0"));
    daemon.hang_up();
    let text = reported(&mut happened, "reloaded").await;
    assert!(text.starts_with("reloaded "), "{text}");
    assert!((current(&daemon).await - 5e-4).abs() < 1e-12);
    daemon.baseline(1).await;

    let session = daemon.start(Options::new()).await;
    stage.configure(&with("250.0"));
    let text = daemon.manager.reload().await.unwrap();
    assert!(text.contains("when session"), "{text}");
    assert!(
        (current(&daemon).await - 5e-4).abs() < 1e-12,
        "the session goes on as it began"
    );
    reported(&mut happened, "reloaded").await;
    within(session.stop()).await.unwrap();
    reported(&mut happened, "reloaded").await;
    assert!((current(&daemon).await - 2.5e-4).abs() < 1e-12);
    let refused = daemon
        .manager
        .start_session(&Options::new())
        .await
        .unwrap_err();
    assert!(matches!(refused, Fault::BaselineMismatch(_)), "{refused:?}");

    // a refused configuration discards the one that waits
    daemon.baseline(1).await;
    let session = daemon.start(Options::new()).await;
    stage.configure(&with("500.0"));
    daemon.manager.reload().await.unwrap();
    stage.configure(&SMALL.replace("\"state\"", "\"elsewhere\""));
    let refused = daemon.manager.reload().await.unwrap_err();
    assert!(
        matches!(&refused, Fault::Unsupported(text) if text.contains("restart") && text.contains("is discarded")),
        "{refused:?}"
    );
    within(session.stop()).await.unwrap();
    // a second refusal has nothing to discard
    let refused = daemon.manager.reload().await.unwrap_err();
    assert!(!refused.text().contains("is discarded"), "{refused:?}");
    assert!((current(&daemon).await - 2.5e-4).abs() < 1e-12);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reload_that_loses_the_rig_is_a_fault_and_keeps_locks() {
    let (rig, _server, config) = on_tcp().await;
    let (_next_rig, _next_server, next) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    rig.set_wire(Instrument::Source, Wire::Cut);
    stage.configure(&next);
    let refused = within(daemon.manager.reload()).await.unwrap_err();
    assert!(matches!(refused, Fault::InstrumentFault(_)), "{refused:?}");
    let text = reported(&mut happened, "reload-refused").await;
    assert!(text.contains("stays"), "{text}");
    assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
    assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");
    let refused = daemon.manager.record_baseline(&Options::new()).await;
    assert!(
        matches!(refused, Err(Fault::InstrumentFault(_))),
        "{refused:?}"
    );

    // the instruments of the configuration in force are still locked, those of the refused one are not
    let second = Stage::new(&config).run(&[]);
    let message = String::from_utf8_lossy(&second.stderr);
    assert!(
        message.contains("in use by another daemon (pid"),
        "{message}"
    );
    let other = Stage::new(&next);
    other.start().await.terminate().await;

    rig.set_wire(Instrument::Source, Wire::Sound);
    reported(&mut happened, "reconnected").await;
    daemon.baseline(1).await;
    assert_eq!(daemon.manager.source_state().await.unwrap(), "off");
    let text = within(daemon.manager.reload()).await.unwrap();
    assert!(
        text.starts_with("reloaded ") && text.ends_with(".toml"),
        "{text}"
    );
    let second = Stage::new(&config);
    second.start().await.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rig_of_unknown_state_refuses_each_reload() {
    for (lost, kind) in [
        (&[Instrument::Source][..], "source-unknown"),
        (&[Instrument::Source, Instrument::Mainframe], "alarm"),
    ] {
        let (rig, _server, config) = on_tcp().await;
        let (_next_rig, _next_server, next) = on_tcp().await;
        let stage = Stage::new(&config);
        let daemon = stage.start().await;
        let mut happened = daemon.manager.receive_happened().await.unwrap();
        for instrument in lost {
            rig.set_wire(*instrument, Wire::Cut);
        }
        stage.configure(&next);
        within(daemon.manager.reload()).await.unwrap_err();
        reported(&mut happened, kind).await;
        let refused = within(daemon.manager.reload()).await.unwrap_err();
        assert!(
            matches!(&refused, Fault::InstrumentFault(text) if text.contains("cannot be switched off")),
            "{refused:?}"
        );
        assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
        assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");

        for instrument in lost {
            rig.set_wire(*instrument, Wire::Sound);
        }
        let text = within(daemon.manager.reload()).await.unwrap();
        assert!(
            text.starts_with("reloaded ") && text.ends_with(".toml"),
            "{text}"
        );
        reported(&mut happened, "source-off").await;
        assert_eq!(daemon.manager.source_state().await.unwrap(), "off");
        daemon.baseline(1).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_source_never_reached_is_unknown_and_blocks_no_reload() {
    let (_rig, server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    let impatient = config.replace("deadline_ms = 2000", "deadline_ms = 200");
    // a port without a listener, and a port whose listener does not reply
    for listens in [false, true] {
        let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = other.local_addr().unwrap().to_string();
        let _held = listens.then_some(other);
        stage.configure(&impatient.replace(&server.ready().source, &address));
        let text = within(daemon.manager.reload()).await.unwrap();
        assert!(
            text.contains("its rig cannot be reached") && text.contains(&address),
            "{text}"
        );
        assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
        assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");
        let refused = within(daemon.manager.open_all()).await;
        assert!(
            matches!(&refused, Err(Fault::InstrumentFault(text)) if text.contains(&address)),
            "{refused:?}"
        );
        assert_eq!(daemon.manager.source_state().await.unwrap(), "unknown");

        stage.configure(&config);
        let text = within(daemon.manager.reload()).await.unwrap();
        assert!(
            text.starts_with("reloaded ") && text.ends_with(".toml"),
            "{text}"
        );
        assert_eq!(daemon.manager.source_state().await.unwrap(), "off");
        daemon.baseline(1).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn open_all_with_a_mistyped_switch_blocks_no_reload() {
    let (_rig, server, config) = on_tcp().await;
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap().to_string();
    drop(other);
    stage.configure(&config.replace(&server.ready().mainframe, &address));
    let text = within(daemon.manager.reload()).await.unwrap();
    assert!(text.contains("its rig cannot be reached"), "{text}");
    let refused = within(daemon.manager.open_all()).await;
    assert!(
        matches!(&refused, Err(Fault::InstrumentFault(text)) if text.contains(&address)),
        "{refused:?}"
    );
    stage.configure(&config);
    let text = within(daemon.manager.reload()).await.unwrap();
    assert!(
        text.starts_with("reloaded ") && text.ends_with(".toml"),
        "{text}"
    );
    daemon.baseline(1).await;
}

/// The rig of the stage in its state after power-on.
fn fresh(stage: &Stage) -> ReplayTarget {
    let profile = Profile::load(stage.path().join("profile.toml").to_str().unwrap()).unwrap();
    let text = std::fs::read_to_string(stage.path().join("scene.toml")).unwrap();
    let scene = Scene::parse("scene.toml", &text).unwrap();
    ReplayTarget::Together(SimulatedRig::new(&profile.at_pace(Pace::Instant), scene).unwrap())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_transcript_replays_and_an_altered_reply_is_found() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(3).await;
    let text = daemon
        .manager
        .transcript(&Options::new().with("frames", 2_u64))
        .await
        .unwrap();
    let entries = parse_transcript("frame", &text).unwrap();
    let times: Vec<f64> = entries.iter().map(|(_, entry)| entry.t_s).collect();
    assert!(
        times.is_sorted() && entries.len() > 100,
        "{}",
        entries.len()
    );
    let played = replay("frame", &entries, &fresh(&stage), Comparison::Shapes).unwrap();
    assert!(played.replies > 50, "{played:?}");

    // changes one digit of the 6221's level in the middle of the transcript
    let altered = text.replacen("1.000000E-03;", "1.100000E-03;", 1);
    let altered = if altered == text {
        text.replacen("1.000000E-03", "1.100000E-03", 1)
    } else {
        altered
    };
    assert_ne!(altered, text);
    let line = altered
        .lines()
        .zip(text.lines())
        .position(|(one, other)| one != other)
        .unwrap()
        + 1;
    let entries = parse_transcript("frame", &altered).unwrap();
    let first = replay("frame", &entries, &fresh(&stage), Comparison::Shapes).unwrap_err();
    let first = first.to_string();
    assert!(
        first.starts_with(&format!("frame:{line}:")) && first.contains("6221"),
        "{first}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_fails_leaves_its_transcript_on_disk() {
    let scene = "[disc-tank]\nelectrodes = 16\n[[fault]]\nat_s = 1.0\nwhat = \"lost 34980a 1\"\n";
    let stage = Stage::new(SMALL);
    std::fs::write(stage.path().join("scene.toml"), scene).unwrap();
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    // the fault may occur as soon as a baseline is recorded, or later: the instruments' time advances with their
    // messages
    let path = daemon
        .manager
        .record_baseline(&Options::new().with("frames", 1000_u64))
        .await
        .unwrap();
    let session = daemon.session(&path).await;
    let text = reported(&mut happened, "transcript").await;
    let path = text.split(" is in ").nth(1).unwrap();
    let entries = read_transcript(std::path::Path::new(path)).unwrap();
    let last = format!("{:?}", entries.iter().rev().take(30).collect::<Vec<_>>());
    assert!(last.contains("no answer within"), "{last}");
    assert!(last.contains("CLE"), "switched off afterwards: {last}");
    reported(&mut happened, "resumed").await;
    within(session.stop()).await.unwrap();
}
