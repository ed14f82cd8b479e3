//! A session may have its own measuring settings, which are shown in its plan; changes during the session are reported.

use crate::stage::{SMALL, Stage, within};
use dbus::{Fault, Options};

#[tokio::test(flavor = "multi_thread")]
async fn session_measures_with_its_options_and_plan_shows_them() {
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    let manager = &daemon.manager;
    let configured = manager.plan().await.unwrap();
    assert_eq!(configured.more.reversal, Some(false));
    let how = || {
        Options::new()
            .with("reversal", true)
            .with("averages", 4_u64)
    };
    let path = manager
        .record_baseline(&how().with("frames", 2_u64))
        .await
        .unwrap();
    within(daemon.session(&path).await.wait()).await.unwrap();

    let refused = manager.start_session(&Options::new()).await.unwrap_err();
    assert!(
        matches!(&refused, Fault::BaselineMismatch(text) if text.contains("current reversal")),
        "{refused:?}"
    );
    for (options, says) in [
        (how().with("averages", 0_u64), "0 is not from 1 to 1000"),
        (how().with("ranges", "wide"), "'fixed' or 'planned'"),
        (how().with("zero_every", 5_u64), "cancels offsets already"),
        (how().with("nplc", 3.0), "3 is none of"),
        (how().with("averages", "many"), "'averages' must be"),
    ] {
        let refused = manager.start_session(&options).await.unwrap_err();
        assert!(
            matches!(&refused, Fault::InvalidOption(text) if text.contains(says)),
            "{says}: {refused:?}"
        );
    }

    let session = daemon.start(how().with("step", true)).await;
    assert_eq!(within(session.step(1)).await.unwrap(), 1);
    let plan = manager.plan().await.unwrap();
    assert_eq!(plan.more.reversal, Some(true));
    assert_eq!(plan.more.averages, Some(4));
    assert!(plan.duration_s > 4.0 * configured.duration_s);
    let frame = session.latest_frame().await.unwrap();
    assert!(frame.flags.iter().all(|flag| *flag == 0));
    within(session.stop()).await.unwrap();
    let after = manager.plan().await.unwrap();
    assert_eq!(after.duration_s, configured.duration_s);
}

/// A session with half of the readings, of pairs that are not neighbours: in the plan, the frame, the map and the
/// record.
#[tokio::test(flavor = "multi_thread")]
async fn a_session_can_have_a_pattern_of_its_own() {
    // the board connects any two electrodes
    let config = SMALL
        .replace("PROFILE", "board.toml")
        .replace("[survey]\n", "[survey]\ncompliance_v = 4.0\n");
    let stage = Stage::new(&format!("{config}[wiring]\nkind = \"gpio-board\"\n"));
    let board = "time = \"instant\"\n[board]\n";
    std::fs::write(stage.path().join("board.toml"), board).unwrap();
    let daemon = stage.start().await;
    let manager = &daemon.manager;
    let readings = survey::half(survey::skip(16, 1)).count();
    let pattern = || Options::new().with("skip", 1_u64).with("half", true);
    let plan = manager.plan_with(&pattern()).await.unwrap();
    assert_eq!(plan.readings, readings as u64);
    assert_eq!((plan.more.skip, plan.more.half), (Some(1), Some(true)));
    let error = manager
        .plan_with(&Options::new().with("skip", 15_u64))
        .await;
    assert!(matches!(error, Err(Fault::InvalidOption(_))), "{error:?}");

    let path = manager
        .record_baseline(&pattern().with("frames", 2_u64))
        .await;
    let baseline = daemon.session(&path.unwrap()).await;
    within(baseline.wait()).await.unwrap();
    let error = manager.start_session(&Options::new()).await.unwrap_err();
    assert!(matches!(error, Fault::BaselineMismatch(_)), "{error:?}");
    // ranges and costs of the configured pattern do not depend on that baseline
    assert!(manager.plan_with(&Options::new()).await.is_ok());

    let session = daemon.start(pattern().with("step", true)).await;
    assert_eq!(within(session.step(1)).await.unwrap(), 1);
    assert_eq!(session.latest_frame().await.unwrap().volts.len(), readings);
    let map = crate::stage::map_of(&session, 1).await;
    assert!(map.values.iter().all(|value| value.is_finite()));
    within(session.stop()).await.unwrap();
    let file = session.path().await.unwrap();
    let record = logbook::SessionReader::open(file).unwrap();
    let header = record.header();
    assert_eq!(header.protocol.len(), readings);
    assert!(header.asked.contains("\"half\":true"), "{}", header.asked);
}

/// Before a session runs: cost and gain of a setting are the differences between the plans with and without it.
#[tokio::test(flavor = "multi_thread")]
async fn a_plan_shows_what_each_setting_would_cost() {
    let stage = Stage::new(&SMALL.replace("[survey]\n", "[survey]\nnplc = 0.02\nsettle_ms = 0\n"));
    let daemon = stage.start().await;
    let manager = &daemon.manager;
    let plainest = manager.plan().await.unwrap();
    assert_eq!(plainest.more.costs(), [], "{:?}", plainest.more);
    let root = 2.0_f64.sqrt();
    for (option, setting, gain) in [
        (Options::new().with("nplc", 1.0), "nplc", 100.0 / 3.0),
        (Options::new().with("averages", 9_u64), "averages", 3.0),
        (Options::new().with("autozero", true), "autozero", 1.0),
        (Options::new().with("settle_ms", 7.0), "settle", 1.0),
        (
            Options::new().with("channel_delay_ms", 3.0),
            "channel_delay",
            1.0,
        ),
        (Options::new().with("reversal", true), "reversal", root),
    ] {
        let with = manager.plan_with(&option).await.unwrap();
        let costs = with.more.costs();
        assert_eq!(costs.len(), 1, "{setting}: {costs:?}");
        assert_eq!(costs[0].setting, setting);
        let (cost, gained) = (costs[0].seconds, costs[0].gain);
        let longer = with.duration_s - plainest.duration_s;
        println!("{setting}: {cost:.3} s a frame, noise / {gained:.2}");
        assert!(
            cost > 0.0 && (cost - longer).abs() < 1e-9,
            "{setting}: {cost}, {longer}"
        );
        let noise = |plan: &dbus::PlanReport| plan.more.noise_v.unwrap();
        assert!((gained / gain - 1.0).abs() < 1e-9, "{setting}: {gained}");
        assert!(
            (noise(&plainest) / noise(&with) / gain - 1.0).abs() < 1e-9,
            "{setting}"
        );
    }
    let every_fifth = Options::new().with("zero_every", 5_u64);
    let with = manager.plan_with(&every_fifth).await.unwrap();
    let cost = with.more.cost_zero_every_s.unwrap();
    assert!((cost - plainest.duration_s / 5.0).abs() < 1e-9, "{cost}");
    let refused = manager
        .plan_with(&Options::new().with("count", 3_u64))
        .await
        .unwrap_err();
    assert!(
        matches!(&refused, Fault::InvalidOption(text) if text.contains("'count'")),
        "{refused:?}"
    );
    assert_eq!(
        manager.plan().await.unwrap().duration_s,
        plainest.duration_s
    );
    within(daemon.terminate()).await;

    // half of the readings, on a wiring that takes each reading separately
    let half = SMALL.replace("[survey]\n", "[survey]\nhalf = true\n")
        + "[wiring]\nkind = \"matrix-34932a\"\n";
    stage.configure(&half);
    std::fs::write(
        stage.path().join("profile.toml"),
        "time = \"instant\"\n[slots]\n1 = \"34932A\"\n",
    )
    .unwrap();
    let planned = |stage: &Stage| {
        let message = stage.run(&["--plan", "--json"]);
        assert!(message.status.success(), "{message:?}");
        serde_json::from_slice::<serde_json::Value>(&message.stdout).unwrap()
    };
    let of_half = planned(&stage);
    stage.configure(&half.replace("half = true\n", ""));
    let of_whole = planned(&stage);
    let saved = of_whole["duration_s"].as_f64().unwrap() - of_half["duration_s"].as_f64().unwrap();
    let measuring = &of_half["measuring"];
    assert_eq!(
        (&measuring["half"], &measuring["skip"]),
        (&true.into(), &0.into()),
        "{measuring}"
    );
    let cost = measuring["cost_half_s"].as_f64().unwrap();
    assert!(
        saved > 0.0 && (saved + cost).abs() < 1e-9,
        "{saved}, {cost}"
    );
    assert_eq!(
        2 * of_half["readings"].as_u64().unwrap(),
        of_whole["readings"].as_u64().unwrap()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_zero_current_frame_is_reported_and_its_baseline_kept() {
    let stage = Stage::new(&SMALL.replace("[survey]\n", "[survey]\nzero_every = 2\n"));
    let daemon = stage.start().await;
    let mut happened = daemon.manager.receive_happened().await.unwrap();
    daemon.baseline(3).await;
    let session = daemon.start(Options::new().with("count", 1_u64)).await;
    crate::stage::ended(&session).await.unwrap();
    // a zero frame before the first frame of each session, and one after the second frame
    for _ in 0..3 {
        let signal = within(dbus::next(&mut happened)).await.unwrap();
        let reported = signal.args().unwrap();
        assert_eq!(reported.kind, "zero", "{}", reported.text);
        assert!(
            reported.text.contains("208 of 208 readings"),
            "{}",
            reported.text
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_overload_selects_the_next_larger_range_and_is_reported() {
    // measure the readings first, then choose a current at which the largest just fits the smallest range
    let stage = Stage::new(SMALL);
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let volts = daemon.manager.baseline().await.unwrap().volts;
    let largest = volts
        .iter()
        .fold(0.0_f64, |most, volts| most.max(volts.abs()));
    within(daemon.terminate()).await;
    let current = 1000.0 * 0.098 / largest;
    let survey =
        format!("[survey]\ncurrent_ua = {current:.1}\nranges = \"planned\"\nrange_margin = 1.0\n");
    stage.configure(&SMALL.replace("[survey]\n", &survey));
    let daemon = stage.start().await;
    let manager = &daemon.manager;
    let mut happened = manager.receive_happened().await.unwrap();
    daemon.baseline(2).await;
    let before = manager.plan().await.unwrap();
    assert_eq!(before.more.planned_ranges, Some(true));
    let noise = |plan: &dbus::PlanReport| plan.more.noise_v.unwrap();
    assert!(noise(&before) < 0.2 * before.more.noise_fixed_v.unwrap());

    let session = daemon.start(Options::new().with("step", true)).await;
    assert_eq!(within(session.step(1)).await.unwrap(), 1);
    let hand = daemon.simulation().await;
    hand.press("disc", 0.11, 0.0, 0.035, 0.9).await.unwrap();
    assert_eq!(within(session.step(1)).await.unwrap(), 2);
    let frame = session.latest_frame().await.unwrap();
    let overloads = frame.quality.overloads.unwrap();
    assert!((1..104).contains(&overloads), "{overloads} overloads");
    let signal = within(dbus::next(&mut happened)).await.unwrap();
    let reported = signal.args().unwrap();
    assert_eq!(reported.kind, "ranges");
    let says = format!("{overloads} of {overloads} overloaded readings have the next larger range");
    assert!(reported.text.contains(&says), "{}", reported.text);
    assert_eq!(reported.details.session, Some(session.id().await.unwrap()));
    let after = manager.plan().await.unwrap();
    assert!(noise(&after) > noise(&before));

    assert_eq!(within(session.step(1)).await.unwrap(), 3);
    let frame = session.latest_frame().await.unwrap();
    assert_eq!(frame.quality.overloads, Some(0));
    within(session.stop()).await.unwrap();
    let record = logbook::SessionReader::open(session.path().await.unwrap()).unwrap();
    let events = record.events().unwrap();
    assert!(
        events.iter().any(|event| event.kind == "ranges"),
        "{events:?}"
    );
}

/// Electrodes of the wired ring.
const RING: usize = 16;

#[tokio::test(flavor = "multi_thread")]
async fn a_wiring_file_is_compared_with_the_modules_found() {
    let scene = simulator::Scene::parse("scene", "[disc-tank]\nelectrodes = 16\n").unwrap();
    let profile = simulator::Profile::load("pairs-34924a").unwrap();
    let rig =
        simulator::SimulatedRig::new(&profile.at_pace(simulator::Pace::Instant), scene).unwrap();
    let options = simulator::ServeOptions {
        port_6221: 0,
        port_34980a: 0,
        serial_6221: true,
        ..simulator::ServeOptions::default()
    };
    let server = simulator::serve(rig.clone(), &options).await.unwrap();
    let ready = server.ready();
    let relays = |from: usize| {
        let each: Vec<String> = (0..RING).map(|pair| format!("[{}]", from + pair)).collect();
        each.join(", ")
    };
    let wired = |module: &str| {
        format!(
            "name = \"by hand\"\nsensing = \"scan\"\ntransition = \"overlap\"\nmodules = {{ 1 = \"{module}\" }}\n\
             inject = [{}]\nmeasure = [{}]\nbus = []\n",
            relays(1036),
            relays(1001)
        )
    };
    let config = format!(
        "[rig]\nkind = \"instruments\"\n[source]\naddress = \"serial:{}@115200\"\n[switch]\naddress = \"tcp:{}\"\n\
         [wiring]\nkind = \"file\"\nfile = \"wiring.toml\"\n[survey]\nelectrodes = {RING}\nnplc = 0.02\n\
         [geometry]\npreset = \"disc-tank\"\n[geometry.disc-tank]\nelectrodes = {RING}\n\
         [record]\ndirectory = \"state\"\n[bus]\npeer_path = \"run/peer\"\n",
        ready.source_serial.as_deref().unwrap(),
        ready.mainframe
    );
    let stage = Stage::new(&config);
    std::fs::write(stage.path().join("wiring.toml"), wired("34922A")).unwrap();
    let refused = tokio::task::spawn_blocking(move || (stage.run(&[]), stage));
    let (refused, stage) = within(refused).await.unwrap();
    let reported = String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success());
    assert!(
        reported.contains("slot 1 holds a 34924A, the wiring needs a 34922A"),
        "{reported}"
    );

    std::fs::write(stage.path().join("wiring.toml"), wired("34924A")).unwrap();
    let daemon = stage.start().await;
    daemon.baseline(1).await;
    let report = daemon.manager.baseline().await.unwrap();
    assert_eq!(report.volts.len(), RING * (RING - 3));
    assert!(report.flags.iter().all(|flag| *flag == 0) && !report.simulated);
    assert!(report.volts.iter().all(|volts| volts.abs() > 1e-6));
    let (off, _) = rig.source_output();
    assert!(!off && rig.closed().is_empty());
}
