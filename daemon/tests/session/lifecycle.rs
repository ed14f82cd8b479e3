//! Sessions on the simulated rig, from the bus to the record.

use std::io::{BufRead, Write};
use std::process::{Command, Stdio};

use crate::stage::{SMALL, Stage, within};
use dbus::{Fault, Options};
use logbook::SessionReader;

#[tokio::test(flavor = "multi_thread")]
async fn press_is_found_measured_recorded_and_reported() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    assert!(daemon.manager.simulated().await.unwrap());
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    let baseline = daemon.baseline(3).await;
    let baseline_id = baseline.id().await.unwrap();
    assert_eq!(daemon.manager.baseline_id().await.unwrap(), baseline_id);
    let report = daemon.manager.baseline().await.unwrap();
    assert_eq!((report.frames, report.volts.len()), (3, 208));

    let press = daemon.simulation().await;
    press.press("disc", 0.06, 0.02, 0.03, 0.5).await.unwrap();
    let session = daemon.start(Options::new().with("step", true)).await;
    assert_eq!(daemon.manager.state().await.unwrap(), "acquiring");
    assert_eq!(within(session.step(2)).await.unwrap(), 2);
    assert_eq!(session.frames_durable().await.unwrap(), 2);
    let map = crate::stage::map_of(&session, 2).await;
    let geometry = daemon.manager.geometry().await.unwrap();
    assert_eq!(map.mesh_hash, geometry.mesh_hash);
    assert_eq!(map.values.len(), geometry.corners().unwrap().len());
    assert!(geometry.loops().is_some() && geometry.electrode_centres().len() == 16);
    let (x, y) = map.more.found_x_m.zip(map.more.found_y_m).unwrap();
    let miss = (x - 0.06).hypot(y - 0.02);
    assert!(miss < 0.01, "found {miss} m away");
    let frame = session.latest_frame().await.unwrap();
    assert!(frame.simulated && frame.flags.iter().all(|flag| *flag == 0));
    assert_eq!(frame.quality.overloads, Some(0));

    press.release().await.unwrap();
    assert_eq!(within(session.step(1)).await.unwrap(), 3);
    let empty = crate::stage::map_of(&session, 3).await;
    let largest = |map: &dbus::LatestMap| map.more.largest_loss.unwrap_or(0.0);
    assert!(
        largest(&empty) < 0.1 * largest(&map),
        "nothing is pressed any more"
    );
    within(session.stop()).await.unwrap();
    assert_eq!(session.state().await.unwrap(), "ended");

    let record = SessionReader::open(session.path().await.unwrap()).unwrap();
    assert_eq!(record.len().unwrap(), 3);
    assert!(record.header().simulated);
    assert_eq!(record.header().instruments.len(), 2);
    assert_eq!(record.baseline().unwrap().unwrap().id, baseline_id);
    assert_eq!(record.closed().unwrap().reason, "stopped on request");
    let kept = record.frame(2).unwrap();
    let volts: Vec<f64> = kept
        .frame
        .readings
        .iter()
        .map(|r| r.volts().unwrap().0)
        .collect();
    assert_eq!(volts, frame.volts);
    assert!(kept.map.is_some());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_is_refused_by_name() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let manager = &daemon.manager;
    let refused = manager.start_session(&Options::new()).await.unwrap_err();
    assert!(
        matches!(&refused, Fault::NoBaseline(text) if text.matches("record").count() == 2 && text.contains("`tactus baseline record`")),
        "{refused:?}"
    );
    daemon.baseline(1).await;
    for (options, says) in [
        (Options::new().with("evry_s", 1.0), "'evry_s'"),
        (
            Options::new().with("every_s", "fast"),
            "'every_s' must be a number",
        ),
        (
            Options::new().with("every_s", -1.0),
            "'every_s': -1 is not from 0",
        ),
        (
            Options::new().with("count", 0_u64),
            "'count': 0 is not from 1",
        ),
        (Options::new().with("speed", 2.0), "for recordings"),
        (
            Options::new().with("model", "relative.safetensors"),
            "absolute path",
        ),
    ] {
        let refused = manager.start_session(&options).await.unwrap_err();
        assert!(
            matches!(&refused, Fault::InvalidOption(text) if text.contains(says)),
            "{refused:?}"
        );
    }
    let missing = Options::new().with("model", "/nowhere.safetensors");
    let refused = manager.start_session(&missing).await.unwrap_err();
    assert!(
        matches!(&refused, Fault::ModelFile(text) if text.contains("/nowhere")),
        "{refused:?}"
    );
    let refused = manager
        .start_session(&Options::new().with("baseline", "nobody"))
        .await
        .unwrap_err();
    assert!(
        matches!(&refused, Fault::NoSession(text) if text.contains("nobody") && text.contains("`tactus baseline list`")),
        "{refused:?}"
    );
    assert_eq!(manager.state().await.unwrap(), "idle");

    let session = daemon.start(Options::new().with("step", true)).await;
    let refused = manager.record_baseline(&Options::new()).await.unwrap_err();
    assert!(matches!(refused, Fault::SessionActive(_)), "{refused:?}");
    let refused = session.latest_map().await.unwrap_err();
    assert!(matches!(refused, Fault::NoFrame(_)), "{refused:?}");
    within(session.stop()).await.unwrap();
    let refused = session.step(1).await.unwrap_err();
    assert!(matches!(refused, Fault::NoSession(_)), "{refused:?}");
    let press = daemon.simulation().await;
    for (shape, x, says) in [("square", 0.0, "'square'"), ("disc", 5.0, "covers no part")] {
        let refused = press.press(shape, x, 0.0, 0.02, 0.5).await.unwrap_err();
        assert!(refused.to_string().contains(says), "{refused}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_schedule_ends_by_itself_and_summaries_reach_the_last_frame() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    let path = daemon
        .manager
        .start_session(&Options::new().with("count", 40_u64).with("step", true))
        .await
        .unwrap();
    let session = daemon.session(&path).await;
    let mut summaries = session.receive_frame_done().await.unwrap();
    let mut reported = Vec::new();
    // the first frame waits until a client has subscribed
    let begun = std::time::Instant::now();
    assert_eq!(within(session.step(40)).await.unwrap(), 40);
    loop {
        let signal = within(dbus::next(&mut summaries)).await.unwrap();
        let arguments = signal.args().unwrap();
        reported.push(arguments.sequence);
        if arguments.sequence == 40 {
            break;
        }
    }
    let most = 2 + begun.elapsed().as_millis() as usize / 200 + 1;
    assert!(
        reported.len() <= most,
        "{} summaries, at most {most}",
        reported.len()
    );
    assert!(reported.is_sorted());
    let reason = crate::stage::ended(&session).await.unwrap();
    assert!(reason.contains("number of frames"), "{reason}");
    assert_eq!(session.frames_durable().await.unwrap(), 40);
    let listed = daemon.manager.list_sessions(&Options::new()).await.unwrap();
    assert_eq!((listed[0].frames, listed[0].state.as_str()), (40, "closed"));
    assert_eq!(listed[1].kind, "baseline");
    // the list is read page by page
    let first = Options::new().with("count", 1_u64);
    let page = daemon.manager.list_sessions(&first).await.unwrap();
    assert_eq!((page.len(), &page[0].id), (1, &listed[0].id));
    let rest = Options::new().with("before", page[0].id.as_str());
    let page = daemon.manager.list_sessions(&rest).await.unwrap();
    assert_eq!((page.len(), &page[0].id), (1, &listed[1].id));
    let gone = Options::new().with("before", "gone");
    let refused = daemon.manager.list_sessions(&gone).await;
    assert!(
        matches!(refused, Err(dbus::Fault::NoSession(_))),
        "{refused:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn twenty_lines_of_python_read_the_stream() {
    if Command::new("python3").arg("--version").output().is_err() {
        needs::lacking("PYTHON", "there is no python3 here");
        return;
    }
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    let stream = session.open_stream(&Options::new()).await.unwrap();
    let descriptor: std::os::fd::OwnedFd = stream.into();
    let reader = Command::new("python3")
        .arg(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../dbus/stream_reader.py"
        ))
        .stdin(Stdio::from(descriptor))
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    within(session.step(3)).await.unwrap();
    let last = session.latest_frame().await.unwrap();
    within(session.stop()).await.unwrap();
    let output = within(tokio::task::spawn_blocking(|| reader.wait_with_output()))
        .await
        .unwrap()
        .unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let records: Vec<serde_json::Value> = text
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let kinds: Vec<&str> = records
        .iter()
        .map(|record| record["kind"].as_str().unwrap())
        .collect();
    assert_eq!(
        kinds,
        ["frame", "map", "frame", "map", "frame", "map", "end"]
    );
    let volts: Vec<f64> = serde_json::from_value(records[4]["volts"].clone()).unwrap();
    assert_eq!(volts, last.volts);
    assert_eq!(records[6]["reason"], "stopped on request");
    assert_eq!(records[6]["simulated"], true);
}

#[tokio::test(flavor = "multi_thread")]
async fn suspension_is_between_frames_and_sigterm_closes_the_record() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    let session = daemon.start(Options::new()).await;
    let properties = zbus::fdo::PropertiesProxy::builder(&daemon.connection)
        .destination(dbus::BUS_NAME)
        .path(session.inner().path().to_owned())
        .build()
        .await
        .unwrap();
    let mut states = properties.receive_properties_changed().await.unwrap();
    session.suspend().await.unwrap();
    while session.state().await.unwrap() != "suspended" {
        within(dbus::next(&mut states)).await.unwrap();
    }
    assert_eq!(daemon.manager.state().await.unwrap(), "suspended");
    session.resume().await.unwrap();
    while session.state().await.unwrap() != "running" {
        within(dbus::next(&mut states)).await.unwrap();
    }
    let path = session.path().await.unwrap();
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "{log}");
    let record = SessionReader::open(path).unwrap();
    assert!(record.closed().unwrap().reason.contains("SIGTERM"));
    assert!(
        !stage.path().join("run/peer").exists(),
        "the socket is gone"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn the_record_has_one_daemon_and_the_next_finds_the_baseline() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let baseline = daemon.baseline(2).await.id().await.unwrap();
    let other = stage.path().join("other.toml");
    let config = std::fs::read_to_string(stage.config()).unwrap();
    std::fs::write(&other, config.replace("run/peer", "run/other")).unwrap();
    let second = Command::new(env!("CARGO_BIN_EXE_tactusd"))
        .arg("--config")
        .arg(&other)
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&second.stderr).into_owned();
    assert_eq!(second.status.code(), Some(1));
    assert!(message.contains("already runs on"), "{message}");
    assert!(daemon.terminate().await.0.success());

    let next = stage.start().await;
    assert_eq!(next.manager.baseline_id().await.unwrap(), baseline);
    assert!(next.terminate().await.0.success());
    stage.configure(&SMALL.replace(
        "electrodes = 16\n[record]",
        "electrodes = 16\ncurrent_ua = 500.0\n[record]",
    ));
    let changed = stage.start().await;
    let refused = changed
        .manager
        .start_session(&Options::new())
        .await
        .unwrap_err();
    let says = matches!(&refused, Fault::BaselineMismatch(text) if text.contains("current 1 mA against 500 uA"));
    assert!(says, "{refused:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bus_reader_that_freezes_is_dropped_and_the_others_go_on() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(2).await;
    // a client that completes the D-Bus handshake, requests more than a socket buffer holds, and never reads again
    let socket = std::os::unix::net::UnixStream::connect(stage.path().join("run/peer")).unwrap();
    let mut frozen = std::io::BufReader::new(socket);
    let uid = rustix::process::geteuid().as_raw().to_string();
    let uid: String = uid.bytes().map(|digit| format!("{digit:02x}")).collect();
    for message in [
        format!("\0AUTH EXTERNAL {uid}\r\n"),
        "NEGOTIATE_UNIX_FD\r\n".to_owned(),
    ] {
        frozen.get_mut().write_all(message.as_bytes()).unwrap();
        let mut answer = String::new();
        frozen.read_line(&mut answer).unwrap();
        assert!(
            answer.starts_with("OK") || answer.starts_with("AGREE"),
            "{answer}"
        );
    }
    let socket = frozen.get_mut();
    socket.write_all(b"BEGIN\r\n").unwrap();
    for _ in 0..100 {
        let query = zbus::Message::method_call(dbus::ROOT_PATH, "Geometry")
            .interface(dbus::MANAGER_INTERFACE)
            .build(&())
            .unwrap();
        socket.write_all(query.data()).unwrap();
    }
    let session = daemon
        .start(Options::new().with("every_s", 0.1).with("count", 15_u64))
        .await;
    crate::stage::ended(&session).await.unwrap();
    assert_eq!(session.frames_durable().await.unwrap(), 15);
    let record = logbook::SessionReader::open(session.path().await.unwrap()).unwrap();
    let times: Vec<std::time::Duration> = record
        .frames()
        .map(|record| record.unwrap().frame.monotonic)
        .collect();
    let gap = times.windows(2).map(|two| two[1] - two[0]).max().unwrap();
    println!("largest gap beside a frozen client: {gap:?}");
    // a hundred times the 0.5 s after which such a client is disconnected; if it blocked frames, there would be no next
    // frame
    assert!(gap < std::time::Duration::from_secs(50), "{gap:?}");
    // an empty write fails once the daemon has closed the connection
    within(async {
        while frozen.get_mut().write(&[]).is_ok() {
            tokio::time::sleep(std::time::Duration::from_millis(20)).await;
        }
    })
    .await;
    let (status, log) = daemon.terminate().await;
    assert!(
        status.success() && log.contains("does not read its messages"),
        "{log}"
    );
}
