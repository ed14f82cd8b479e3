//! Self-test and relay wear, on simulated rigs with and without faults.

use crate::stage::{SMALL, Stage, on_tcp, reported, within};
use dbus::{Fault, Options, TestReport};
use simulator::{Instrument, Wire};

const QUIET: &str = "[disc-tank]\nelectrodes = 16\n[effects.voltmeter-noise]\nuv = 2.0\n";

/// Tests a rig with this wiring and module, on the quiet scene with these lines added; returns the report.
async fn tested(wiring: &str, slots: &str, scene: &str) -> TestReport {
    of_scene(wiring, slots, &format!("{QUIET}{scene}")).await
}

/// The same on this scene.
async fn of_scene(wiring: &str, slots: &str, scene: &str) -> TestReport {
    let stage = Stage::new(&format!("{SMALL}[wiring]\nkind = \"{wiring}\"\n"));
    let profile = format!("time = \"instant\"\n{slots}\n");
    std::fs::write(stage.path().join("profile.toml"), profile).unwrap();
    std::fs::write(stage.path().join("scene.toml"), scene).unwrap();
    let daemon = stage.start().await;
    let report = within(daemon.manager.test_instruments(&Options::new()))
        .await
        .unwrap();
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    let kept = std::fs::read_to_string(stage.path().join("state/tests.jsonl")).unwrap();
    assert_eq!(kept.lines().count(), 1);
    report
}

fn fault(what: &str) -> String {
    format!("[[fault]]\nat_s = 0\nwhat = \"{what}\"\n")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sound_rig_passes_and_its_sheet_is_measured_two_ways() {
    for (wiring, slots) in [
        ("pairs-34924a", "[slots]\n1 = \"34924A\""),
        ("fast-34925a", "[slots]\n1 = \"34925A\"\n2 = \"34924A\""),
        ("matrix-34932a", "[slots]\n1 = \"34932A\""),
        ("matrix-34934a", "[slots]\n1 = \"34934A,4x128\""),
    ] {
        let report = tested(wiring, slots, "").await;
        assert!(report.passed, "{wiring}: {:?}", report.findings);
        assert_eq!(report.lines.len(), 16 + 16 + 16 + 16 + 5, "{wiring}");
        assert!(
            report.lines.iter().all(|line| line.verdict == "ok"),
            "{wiring}"
        );
        let found = &report.more;
        let noise_v = found.noise_v.unwrap();
        println!(
            "{wiring}: sheet {:.2} ohm, misfit {:.1e}, van der Pauw {:.2} (raw {:.2}), reciprocity {:.1e}, noise {:.2} uV",
            found.sheet_ohm.unwrap(),
            found.misfit.unwrap(),
            found.pauw_ohm.unwrap(),
            found.pauw_raw_ohm.unwrap(),
            found.reciprocity.unwrap(),
            1e6 * noise_v
        );
        let truth = 1.0 / eit::DiscTank::default().conductance();
        for measured in [found.sheet_ohm, found.pauw_ohm].map(Option::unwrap) {
            let off = (measured / truth - 1.0).abs();
            assert!(off < 0.015, "{wiring}: {measured} ohm, {truth} is true");
        }
        assert!((0.5e-6..6e-6).contains(&noise_v), "{}", noise_v);
    }
}

/// The self-test uses pairs of neighbouring electrodes for any `skip`; it is refused with `half`.
#[tokio::test(flavor = "multi_thread")]
async fn surveys_of_other_pairs_are_tested_by_neighbours() {
    for (survey, possible) in [("skip = 1", true), ("half = true", false)] {
        let survey = format!("electrodes = 16\n{survey}\n[record]");
        let config = SMALL.replace("electrodes = 16\n[record]", &survey);
        let stage = Stage::new(&format!("{config}[wiring]\nkind = \"matrix-34934a\"\n"));
        let profile = "time = \"instant\"\n[slots]\n1 = \"34934A,4x128\"\n";
        std::fs::write(stage.path().join("profile.toml"), profile).unwrap();
        std::fs::write(stage.path().join("scene.toml"), QUIET).unwrap();
        let daemon = stage.start().await;
        let tested = within(daemon.manager.test_instruments(&Options::new())).await;
        match possible {
            true => assert!(
                tested.as_ref().is_ok_and(|report| report.passed),
                "{tested:?}"
            ),
            false => assert!(
                matches!(&tested, Err(Fault::Unsupported(text)) if text.contains("survey.half")),
                "{tested:?}"
            ),
        }
        assert_eq!(daemon.manager.state().await.unwrap(), "idle");
    }
}

/// A sheet whose resistance and contacts differ from the configuration: the self-test measures the actual sheet and
/// does not assume the configured one.
#[tokio::test(flavor = "multi_thread")]
async fn a_sheet_that_is_not_as_configured_is_measured_as_it_is() {
    for truth in [310.0, 2400.0] {
        let sheet = format!("[disc-tank]\nelectrodes = 16\nsheet_ohm = {truth}\n");
        let scene = QUIET.replace("[disc-tank]\nelectrodes = 16\n", &sheet)
            + "[effects.contact-spread]\nstd = 0.2\n";
        let report = of_scene("pairs-34924a", "[slots]\n1 = \"34924A\"", &scene).await;
        assert!(report.passed, "{:?}", report.findings);
        for measured in [report.more.sheet_ohm, report.more.pauw_ohm].map(Option::unwrap) {
            println!("a sheet of {truth} ohm: {measured:.2}");
            assert!((measured / truth - 1.0).abs() < 0.015, "{measured}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_noisy_channel_and_a_noisy_electrode_are_named() {
    let noisy =
        |channels: &str| format!("[effects.channel-noise]\nchannels = {channels}\nuv = 60.0\n");
    for (channels, finding) in [
        ("[1005]", "relay 1005: noisy, "),
        ("[1016]", "relay 1016: noisy, "),
        ("[1005, 1006]", "electrode 6: noisy, "),
        ("[1016, 1001]", "electrode 1: noisy, "),
    ] {
        let report = tested("pairs-34924a", "[slots]\n1 = \"34924A\"", &noisy(channels)).await;
        println!("{channels}: {:?}", report.findings);
        assert_eq!(report.findings.len(), 1, "{:?}", report.findings);
        assert!(
            report.findings[0].starts_with(finding),
            "{:?}",
            report.findings
        );
        let lines = report.lines.iter().filter(|line| line.check == "noise");
        let failed = lines.filter(|line| line.verdict == "failed");
        assert_eq!(failed.count(), channels.split(',').count(), "{channels}");
        // the reported noise stays that of the voltmeter: the channel does not affect it
        let noise = report.more.noise_v.unwrap();
        assert!((0.5e-6..6e-6).contains(&noise), "{noise}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn each_fault_is_found_and_named() {
    let pairs = ("pairs-34924a", "[slots]\n1 = \"34924A\"");
    let large = ("matrix-34934a", "[slots]\n1 = \"34934A,4x128\"");
    let matrix = ("matrix-34932a", "[slots]\n1 = \"34932A\"");
    let cases = [
        (
            pairs,
            fault("stuck-open 1042"),
            "relay 1042 stays open: it joins electrodes 7 and 8 to the source",
        ),
        (
            pairs,
            fault("stuck-open 1005"),
            "relay 1005 stays open: it joins electrodes 5 and 6 to the voltmeter",
        ),
        (
            pairs,
            fault("stuck-closed 1042"),
            "relay 1042 stays closed: it joins electrodes 7 and 8 to the source",
        ),
        (
            pairs,
            fault("stuck-closed 1005"),
            "relay 1005 stays closed: it joins electrodes 5 and 6 to the voltmeter",
        ),
        (
            pairs,
            "[[contact]]\nelectrode = 11\nohm = 1e9\n".to_owned(),
            "electrode 11: open; check its wire",
        ),
        (
            pairs,
            "[[contact]]\nelectrode = 11\nohm = 3000\n".to_owned(),
            "electrode 11: poor contact, 30",
        ),
        (
            matrix,
            fault("stuck-open 1203"),
            "relay 1203 stays open: it joins electrodes 3 and 4 to the source",
        ),
        (
            matrix,
            fault("stuck-closed 1103"),
            "relay 1103 stays closed: it joins electrodes 3 and 4 to the voltmeter",
        ),
        (
            large,
            fault("stuck-open 1105"),
            "relay 1105 stays open: it joins electrode 5 to the source",
        ),
        (
            large,
            fault("stuck-open 1706"),
            "relay 1706 stays open: it joins electrode 6 to the voltmeter",
        ),
        (
            large,
            fault("stuck-closed 1309"),
            "relay 1309 stays closed: it joins electrode 9 to the source",
        ),
        (
            large,
            fault("stuck-closed 1509"),
            "relay 1509 stays closed: it joins electrode 9 to the voltmeter",
        ),
    ];
    for ((wiring, slots), scene, finding) in cases {
        let report = tested(wiring, slots, &scene).await;
        println!(
            "{wiring}, {}: {:?}",
            scene.trim().replace('\n', ", "),
            report.findings
        );
        assert_eq!(report.findings.len(), 1, "{:?}", report.findings);
        assert!(
            report.findings[0].starts_with(finding),
            "wanted {finding}, got {:?}",
            report.findings
        );
        assert!(!report.passed);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn self_test_and_recording_exclude_each_other() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let session = daemon.start(Options::new().with("step", true)).await;
    let options = Options::new();
    for refused in [
        daemon.manager.test_instruments(&options).await.unwrap_err(),
        daemon.manager.relays(&options).await.unwrap_err(),
    ] {
        assert!(
            matches!(&refused, Fault::SessionActive(text) if text.contains("a session is running")),
            "{refused:?}"
        );
    }
    within(session.stop()).await.unwrap();
    assert!(
        within(daemon.manager.test_instruments(&options))
            .await
            .unwrap()
            .passed
    );
    let refused = daemon
        .manager
        .relays(&Options::new().with("all", true))
        .await
        .unwrap_err();
    assert!(matches!(refused, Fault::InvalidOption(_)), "{refused:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_in_the_middle_leaves_the_source_off() {
    let stage = Stage::new(&SMALL.replace(
        "electrodes = 16\n[record]",
        "electrodes = 16\nnplc = 2\n[record]",
    ));
    std::fs::write(
        stage.path().join("profile.toml"),
        "time = \"real\"\n[slots]\n1 = \"34924A\"\n",
    )
    .unwrap();
    let daemon = stage.start().await;
    let mut progress = daemon.manager.receive_test_progress().await.unwrap();
    let manager = daemon.manager.clone();
    let test = tokio::spawn(async move { manager.test_instruments(&Options::new()).await });
    // after the second step current flows, or is about to flow
    for _ in 0..2 {
        within(dbus::next(&mut progress)).await.unwrap();
    }
    assert_eq!(daemon.manager.state().await.unwrap(), "testing");
    let (status, log) = daemon.terminate().await;
    assert!(status.success(), "the source was verified off: {log}");
    assert!(within(test).await.unwrap().is_err());
    assert!(
        !stage.path().join("state/tests.jsonl").exists(),
        "half a test is no report"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn closures_are_counted_and_projected() {
    for averages in [1, 2] {
        let survey = format!("electrodes = 16\naverages = {averages}\n[record]");
        let config = SMALL.replace("electrodes = 16\n[record]", &survey);
        let stage = Stage::new(&format!("{config}[relay_wear]\nrelay_life_cycles = 1000\n"));
        let daemon = stage.start().await;
        daemon.baseline(3).await;
        let relays = within(daemon.manager.relays(&Options::new()))
            .await
            .unwrap();
        assert_eq!(relays.len(), 32);
        let of = |number: u32| relays.iter().find(|wear| wear.relay == number).unwrap();
        let (injecting, measuring) = (of(1036), of(1001));
        // after three frames: a frame closes each injecting relay once, and scans each measuring relay at each of 16
        // injections, once for each averaged reading
        let scans = 16 * averages;
        assert_eq!((injecting.cycles, measuring.cycles), (3, 3 * scans));
        assert_eq!((injecting.rated, injecting.used), (1000, 0.003));
        let frame = daemon.manager.plan().await.unwrap().duration_s;
        assert!(
            (injecting.left_s / (997.0 * frame) - 1.0).abs() < 1e-6,
            "{}",
            injecting.left_s
        );
        let frames = (1000 - 3 * scans) as f64 / scans as f64;
        assert!(
            (measuring.left_s / (frames * frame) - 1.0).abs() < 1e-6,
            "{}",
            measuring.left_s
        );
        assert_eq!(injecting.purpose, "joins electrodes 1 and 2 to the source");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn zero_current_frames_count_in_the_life_of_relays() {
    let config = SMALL.replace("[survey]\n", "[survey]\nzero_every = 2\n")
        + "[relay_wear]\nrelay_life_cycles = 1000\n[schedule]\nevery_s = EVERY\n";
    for every_s in [0, 60] {
        let stage = Stage::new(&config.replace("EVERY", &format!("{every_s}.0")));
        let daemon = stage.start().await;
        daemon.baseline(4).await;
        let relays = within(daemon.manager.relays(&Options::new()))
            .await
            .unwrap();
        let wear = relays.iter().find(|wear| wear.relay == 1036).unwrap();
        // a zero-current frame precedes the first and the third frame
        assert_eq!(wear.cycles, 6);
        // the relay closes three times for two frames
        let left = 994.0 / 1.5;
        let frame = daemon.manager.plan().await.unwrap().duration_s;
        let period = f64::from(every_s).max(1.5 * frame);
        assert!(
            (wear.left_s / (left * period) - 1.0).abs() < 1e-6,
            "{} s, {period} s a frame",
            wear.left_s
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn relay_life_follows_a_sessions_own_measuring_options() {
    let config = |life, every_s| {
        format!(
            "{SMALL}[relay_wear]\nrelay_life_cycles = {life}\n[schedule]\nevery_s = {every_s}.0\n"
        )
    };
    let stage = Stage::new(&config(1000, 0));
    let daemon = stage.start().await;
    let frame = daemon.manager.plan().await.unwrap().duration_s;
    let life = async || within(daemon.manager.health()).await.unwrap().relay_left_s;
    let close = |left: Option<f64>, expected: f64| {
        left.is_some_and(|left| (left / expected - 1.0).abs() < 1e-6)
    };
    // each measuring relay is scanned at each of 16 injections, also in the zero-current frames of the second session
    for (zero_every, used, runs) in [(None, 16, 1.0), (Some(1_u64), 48, 2.0), (None, 64, 1.0)] {
        let mut options = Options::new().with("frames", 1_u64);
        if let Some(every) = zero_every {
            options = options.with("zero_every", every);
        }
        let path = daemon.manager.record_baseline(&options).await.unwrap();
        let session = daemon.session(&path).await;
        crate::stage::ended(&session).await.unwrap();
        let left = life().await;
        let frames = f64::from(1000 - used) / (16.0 * runs);
        let expected = frames * runs * frame;
        assert!(
            close(left, expected),
            "{left:?} s, {expected} s expected after {used} closures"
        );
    }
    // the life of another rating is not that of the one before; measuring after a baseline follows the schedule
    stage.configure(&config(2000, 60));
    within(daemon.manager.reload()).await.unwrap();
    assert_eq!(life().await, None);
    daemon.baseline(1).await;
    let (left, expected) = (life().await, f64::from(2000 - 80) / 16.0 * 60.0);
    assert!(close(left, expected), "{left:?} s, {expected} s expected");
}

#[tokio::test(flavor = "multi_thread")]
async fn reading_relay_counters_ends_no_fault() {
    let (rig, _server, config) = on_tcp().await;
    rig.receive(Instrument::Mainframe, "ROUT:CLOS (@1040)");
    let stage = Stage::new(&config);
    let daemon = stage.start().await;
    let why = daemon.manager.last_error().await.unwrap();
    assert!(why.contains("1040"), "{why}");
    within(daemon.manager.relays(&Options::new()))
        .await
        .unwrap();
    assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
    assert_eq!(daemon.manager.last_error().await.unwrap(), why);
    daemon.manager.open_all().await.unwrap();

    // a rig that is lost while its relay counters are read is reconnected
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    rig.set_wire(Instrument::Mainframe, Wire::Cut);
    let refused = within(daemon.manager.relays(&Options::new())).await;
    assert!(
        matches!(&refused, Err(Fault::InstrumentFault(_))),
        "{refused:?}"
    );
    reported(&mut happened, "reconnecting").await;
    let refused = within(daemon.manager.relays(&Options::new()))
        .await
        .unwrap_err();
    assert!(
        matches!(&refused, Fault::Failed(text) if text.contains("cannot be reached")),
        "{refused:?}"
    );
    assert_eq!(daemon.manager.state().await.unwrap(), "faulted");
    rig.set_wire(Instrument::Mainframe, Wire::Sound);
    reported(&mut happened, "reconnected").await;
    daemon.baseline(1).await;
    assert_eq!(daemon.manager.state().await.unwrap(), "idle");
}

#[tokio::test(flavor = "multi_thread")]
async fn relay_counters_that_come_late_do_not_fail_a_frame() {
    let (rig, _server, config) = on_tcp().await;
    let [switch, voltmeter] = ["[switch]\n", "[voltmeter]\n"];
    let impatient = |section| format!("{section}deadline_ms = 2000\n");
    let config = config.replace(switch, &impatient(switch));
    let stage = Stage::new(&config.replace(voltmeter, &impatient(voltmeter)));
    let daemon = stage.start().await;
    rig.keep_transcript();
    // of the counters, which are the first query of a session
    let late = simulator::ReplyFault::Late(std::time::Duration::from_millis(2500));
    let late = simulator::Fault::Replies(Instrument::Mainframe, late, 1);
    rig.fault(&late).unwrap();
    let session = daemon.baseline(1).await;
    let messages = rig.transcript();
    let mut of_mainframe = messages
        .iter()
        .filter(|message| message.instrument == Instrument::Mainframe);
    let first = &of_mainframe.next().unwrap().received;
    assert!(first.contains("DIAG:REL:CYCL?"), "{first}");
    let record = logbook::SessionReader::open(session.path().await.unwrap()).unwrap();
    let events = record.events().unwrap();
    assert!(events.is_empty(), "{events:?}");
    assert_eq!(record.len().unwrap(), 1);
}
