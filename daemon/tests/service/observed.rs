//! The health of a running daemon: without problems, and then with problems and their reasons.

use std::collections::BTreeSet;
use std::time::Duration;

use dbus::Options;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::stage::{Measuring, SMALL, Stage, reported, within};

/// The health as the daemon reports it.
async fn health(daemon: &crate::stage::Running) -> dbus::Health {
    within(daemon.manager.health()).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_reports_its_health() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let before = health(&daemon).await;
    assert_eq!(before.well, Some(true), "{before:?}");
    assert_eq!((before.session, before.last_frame_ns), (None, None));
    assert!(before.disk_free_bytes.unwrap() > 0);

    daemon.baseline(2).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(3)).await.unwrap();
    let now = health(&daemon).await;
    // on a busy machine a map may be late; no other alarm is allowed
    let alarms = now.troubles.clone().unwrap();
    assert!(
        alarms.iter().all(|text| text.starts_with("session: ")),
        "{now:?}"
    );
    assert_eq!(now.frames_durable, Some(3));
    assert_eq!(now.backlog, Some(0));
    assert_eq!(now.total_durable, Some(5));
    assert_eq!(now.last_frame_sequence, Some(3));
    assert!(now.baseline_age_s.unwrap() >= 0.0);
    // the counters were read before the first session; the closures since are extrapolated
    assert!(now.relay_used.unwrap() > 0.0, "{now:?}");
    // a frame taken on request is never overdue
    assert_eq!(now.quiet_s, None);
    assert_eq!(
        now.instruments.unwrap(),
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
    reported(&mut happened, "suspended").await;
    let lost = health(&daemon).await;
    assert_eq!(lost.well, Some(false));
    let alarms = lost.troubles.unwrap();
    assert!(
        alarms.iter().any(|text| text.starts_with("instrument: ")),
        "{alarms:?}"
    );
    assert_eq!(lost.total_failed, Some(1));
    let why = lost.last_gap.unwrap();
    assert!(why.contains("failed: "), "{why}");
    let instruments = lost.instruments.unwrap();
    assert!(
        instruments[0].starts_with("source: fault: "),
        "{instruments:?}"
    );

    let _server = crate::stage::serve(&rig, ports).await;
    reported(&mut happened, "resumed").await;
    let back = health(&daemon).await;
    let alarms = back.troubles.unwrap();
    assert!(
        !alarms.iter().any(|text| text.starts_with("instrument")),
        "{alarms:?}"
    );
    assert_eq!(
        back.instruments.unwrap(),
        ["source: ready", "switch+voltmeter: ready"]
    );
    within(session.stop()).await.unwrap();
}

/// Requests the metrics once; returns the body.
async fn scrape(address: &str) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n";
    stream.write_all(request).await.unwrap();
    let mut answer = String::new();
    within(stream.read_to_string(&mut answer)).await.unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    assert!(
        head.starts_with(
            "HTTP/1.1 200 OK\r\nContent-Type: application/openmetrics-text; version=1.0.0"
        ),
        "{head}"
    );
    body.to_owned()
}

/// The samples of an exposition. Panics unless every line is a comment of a known kind or a sample of a described
/// family, and the end is marked.
fn parsed(body: &str) -> Vec<(String, f64)> {
    let mut families = BTreeSet::new();
    let mut samples = Vec::new();
    let lines: Vec<&str> = body.strip_suffix("# EOF\n").unwrap().lines().collect();
    for line in lines {
        if let Some(rest) = line.strip_prefix("# ") {
            let words: Vec<&str> = rest.splitn(3, ' ').collect();
            assert!(["TYPE", "HELP", "UNIT"].contains(&words[0]), "{line}");
            if words[0] == "UNIT" {
                assert!(words[1].ends_with(&format!("_{}", words[2])), "{line}");
            }
            families.insert(words[1].to_owned());
            continue;
        }
        let (name, value) = line.rsplit_once(' ').unwrap();
        let plain = name.split('{').next().unwrap();
        let known = ["", "_total", "_info", "_sum", "_count", "_bucket"]
            .iter()
            .any(|end| {
                plain
                    .strip_suffix(end)
                    .is_some_and(|family| families.contains(family))
            });
        assert!(known, "{line} is of no family");
        samples.push((name.to_owned(), value.parse().unwrap()));
    }
    samples
}

/// The address of the metrics. Waits for it, because the listener is opened in a separate task.
async fn address(daemon: &crate::stage::Running) -> String {
    loop {
        if let Some(address) = health(daemon).await.metrics {
            return address;
        }
        tokio::task::yield_now().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn alarms_of_rules_are_in_the_metrics() {
    let stage = Stage::new(&format!(
        "{SMALL}[metrics]\nlisten = \"127.0.0.1:0\"\n\
         [[alarm]]\nname = \"old\"\nquantity = \"baseline-age\"\nabove = 1e-9\nfor_s = 0.0\nseverity = \"major\"\n\
         [[alarm]]\nname = \"lying\"\nquantity = \"unrelieved-area\"\nabove = 100.0\n"
    ));
    let daemon = stage.start().await;
    let address = address(&daemon).await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    let begun = [
        (
            "tactus_alarm_active{name=\"old\",severity=\"major\"}".to_owned(),
            1.0,
        ),
        (
            "tactus_alarm_active{name=\"lying\",severity=\"minor\"}".to_owned(),
            0.0,
        ),
        (
            "tactus_alarm_unjudged{name=\"old\",severity=\"major\"}".to_owned(),
            0.0,
        ),
        // the value of this quantity needs hours of frames
        (
            "tactus_alarm_unjudged{name=\"lying\",severity=\"minor\"}".to_owned(),
            1.0,
        ),
        (
            "tactus_alarm_set_aside{name=\"old\",severity=\"major\"}".to_owned(),
            0.0,
        ),
    ];
    within(async {
        loop {
            session.step(1).await.unwrap();
            let samples = parsed(&scrape(&address).await);
            if begun.iter().all(|sample| samples.contains(sample)) {
                break;
            }
        }
    })
    .await;
    within(session.stop()).await.unwrap();
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_that_cannot_be_served_have_no_address() {
    let with = |address: &str| format!("{SMALL}[metrics]\nlisten = \"{address}\"\n");
    let stage = Stage::new(&with("127.0.0.1:0"));
    let daemon = stage.start().await;
    within(address(&daemon)).await;
    let other = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    stage.configure(&with(&other.local_addr().unwrap().to_string()));
    within(daemon.manager.reload()).await.unwrap();
    within(async {
        while health(&daemon).await.metrics.is_some() {
            tokio::task::yield_now().await;
        }
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn metrics_are_scraped_and_every_line_is_understood() {
    let with = format!("{SMALL}[metrics]\nlisten = \"127.0.0.1:0\"\n");
    let stage = Stage::new(&with);
    let daemon = stage.start().await;
    let address = address(&daemon).await;
    assert!(address.starts_with("127.0.0.1:"), "{address}");
    let before = parsed(&scrape(&address).await);
    daemon.baseline(2).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    within(session.step(3)).await.unwrap();
    let after = parsed(&scrape(&address).await);
    let of = |samples: &[(String, f64)], wanted: &str| {
        let found = samples.iter().find(|(name, _)| name == wanted);
        found.map(|(_, value)| *value)
    };
    assert_eq!(of(&before, "tactus_frames_total"), Some(0.0));
    assert_eq!(of(&before, "tactus_backlog_frames"), None);
    assert_eq!(of(&before, "tactus_well"), Some(1.0));
    for (name, value) in [
        ("tactus_frames_total", 5.0),
        ("tactus_durable_frames_total", 5.0),
        ("tactus_failed_frames_total", 0.0),
        ("tactus_backlog_frames", 0.0),
        ("tactus_simulated", 1.0),
        ("tactus_instrument_up{role=\"source\"}", 1.0),
        ("tactus_state{state=\"acquiring\"}", 1.0),
        ("tactus_state{state=\"idle\"}", 0.0),
        ("tactus_trouble{kind=\"no-frame\"}", 0.0),
    ] {
        assert_eq!(of(&after, name), Some(value), "{name}\n{after:#?}");
    }
    // a map may be counted after its frame, and each bucket includes those below it
    let maps = of(&after, "tactus_reconstruction_seconds_count").unwrap();
    let buckets: Vec<f64> = after
        .iter()
        .filter(|(name, _)| name.starts_with("tactus_reconstruction_seconds_bucket"))
        .map(|(_, value)| *value)
        .collect();
    assert_eq!(buckets.len(), 9, "{after:#?}");
    assert!(buckets.is_sorted() && maps <= 3.0, "{after:#?}");
    let all = of(&after, "tactus_reconstruction_seconds_bucket{le=\"+Inf\"}");
    assert_eq!(all, Some(maps));
    assert!(of(&after, "process_resident_memory_bytes").unwrap() > 1e6);
    assert!(of(&after, "tactus_disk_free_bytes").unwrap() > 0.0);
    // a few dozen series, whatever the daemon does
    assert!(after.len() < 60, "{}", after.len());
    within(session.stop()).await.unwrap();
    daemon.terminate().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_healthy_session_of_1000_frames_logs_two_lines() {
    // a session without maps, because late maps on a busy machine would be events. `disk_days` is small, because frames
    // without a pause would soon fill any disk
    let stage = Stage::new(&format!("{SMALL}[notify]\ndisk_days = 1e-6\n"));
    let daemon = stage.start_with_its_usual_words().await;
    let session = daemon.baseline(1000).await;
    assert_eq!(session.frames_durable().await.unwrap(), 1000);
    let id = session.id().await.unwrap();
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "{log}");
    let of_the_session: Vec<&str> = log.lines().filter(|line| line.contains(&id)).collect();
    assert_eq!(of_the_session.len(), 2, "{log}");
    assert!(of_the_session[0].contains("begins"), "{log}");
    assert!(
        of_the_session[1].contains("1000 frames on disk, 0 failed"),
        "{log}"
    );
    // the other lines are about the start and the end of the daemon
    assert!(log.lines().count() <= 6, "{log}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_daemons_own_events_are_on_disk() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    std::fs::write(stage.config(), "[rig\n").unwrap();
    daemon.manager.reload().await.unwrap_err();
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "{log}");
    let events = logbook::read_daemon_log(stage.path().join("state")).unwrap();
    let kinds: Vec<&str> = events.iter().map(|event| event.kind.as_str()).collect();
    assert_eq!(
        kinds,
        ["started", "reload-refused", "stopped"],
        "{events:#?}"
    );
    assert!(events[2].text.contains("SIGTERM"), "{events:#?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_notify_command_runs_and_its_test_reports_the_outcome() {
    let stage = Stage::new(SMALL);
    let payload = stage.path().join("letter.json");
    let script = format!("cat >> {}; echo to the wind >&2; exit 4", payload.display());
    // a baseline counts as old immediately
    let with = format!(
        "{SMALL}[notify]\ncommand = [\"/bin/sh\", \"-c\", \"{script}\"]\nbaseline_days = 1e-9\n"
    );
    stage.configure(&with);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    let fared = within(daemon.manager.notify_test()).await.unwrap();
    assert_eq!(fared.done, Some(false));
    assert_eq!(fared.code, Some(4));
    assert_eq!(fared.stderr.as_deref(), Some("to the wind\n"));
    let read = |text: &str| -> serde_json::Value { serde_json::from_str(text).unwrap() };
    let text = std::fs::read_to_string(&payload).unwrap();
    let test = read(text.trim());
    assert_eq!(
        (&test["kind"], &test["phase"]),
        (&"test".into(), &"test".into())
    );
    assert_eq!(test["simulated"], true);

    daemon.baseline(1).await;
    let why = reported(&mut happened, "trouble").await;
    assert!(why.starts_with("baseline-stale: "), "{why}");
    // the command fails, which is an event too
    let failed = reported(&mut happened, "notify-failed").await;
    assert!(failed.contains("exit code 4: to the wind"), "{failed}");
    let text = std::fs::read_to_string(&payload).unwrap();
    let stale = read(text.lines().nth(1).unwrap());
    assert_eq!(stale["kind"], "baseline-stale");
    assert_eq!(stale["phase"], "begun");
    assert_eq!(stale["troubles"][0]["kind"], "baseline-stale");
    daemon.terminate().await;
}

/// The command hangs: frames continue, and the end of the daemon is not delayed.
#[tokio::test(flavor = "multi_thread")]
async fn a_command_that_hangs_holds_no_frame_back() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pid");
    let with = format!(
        "{SMALL}[notify]\ncommand = [\"/bin/sh\", \"-c\", \"sleep 3600 & echo $! > {}; wait\"]\n\
         baseline_days = 1e-9\ndeadline_s = 600\n",
        file.display()
    );
    let stage = Stage::new(&with);
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    daemon.baseline(1).await;
    reported(&mut happened, "trouble").await;
    let session = daemon.start(Options::new().with("count", 200_u64)).await;
    crate::stage::ended(&session).await.unwrap();
    assert_eq!(session.frames_durable().await.unwrap(), 200);
    let begun = std::time::Instant::now();
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "{log}");
    assert!(
        begun.elapsed() < Duration::from_secs(600),
        "it waited for the command"
    );
    // the command and its child processes end with the daemon
    let pid = std::fs::read_to_string(&file).unwrap();
    let stat = format!("/proc/{}/stat", pid.trim());
    within(async {
        while std::fs::read_to_string(&stat).is_ok_and(|text| !text.contains(") Z")) {
            tokio::task::yield_now().await;
        }
    })
    .await;
}

#[test]
fn impossible_value_is_reported_with_line_and_column() {
    let stage = Stage::new(&format!(
        "{SMALL}[metrics]\nlisten = \"0.0.0.0:9617\"\n[notify]\ncommand = [\"mail\"]\nrelay_life = 1.5\nagain_s = 0.0\n\
         no_frame_periods = 0.5\ndisk_dais = 3\n"
    ));
    let message = |stage: &Stage| {
        let checked = stage.run(&["--check"]);
        String::from_utf8_lossy(&checked.stderr).into_owned()
    };
    let unknown = message(&stage);
    assert!(
        unknown.contains(":26:1: unknown key 'disk_dais'; did you mean 'disk_days'?"),
        "{unknown}"
    );
    let text = std::fs::read_to_string(stage.config()).unwrap();
    stage.configure(&text.replace("disk_dais", "disk_days"));
    let wrong = message(&stage);
    for wanted in [
        ":20:10: metrics.listen: 0.0.0.0:9617 can be reached from other machines",
        ":22:11: notify.command: 'mail' is not an absolute path",
        ":23:14: notify.relay_life: 1.5 is not above 0 and at most 1",
        ":24:11: notify.again_s: 0 is not above 0",
        ":25:20: notify.no_frame_periods: 0.5 is not from 1 to 1000000",
    ] {
        assert!(wrong.contains(wanted), "{wanted}\n{wrong}");
    }
    let sound = format!(
        "{SMALL}[metrics]\nlisten = \"0.0.0.0:9617\"\nbeyond_localhost = true\n[notify]\ncommand = [\"/bin/true\"]\n"
    );
    stage.configure(&sound);
    assert_eq!(message(&stage), "");
    stage.configure(&format!("{SMALL}[metrics]\nlisten = \"localhost\"\n"));
    let wrong = message(&stage);
    assert!(
        wrong.contains(":20:10: metrics.listen: 'localhost' is not an address"),
        "{wrong}"
    );
}
