//! Functions of the rig itself: wires that break, power cycles, time, presses, closed relays.

use std::time::Duration;

use crate::drivers::{frame, link, mainframe_rig, simulated};
use keysight_34980a::Keysight34980a;
use phantom::{Load, Scene};
use rig::{CurrentSource, EndReason, Move, Switch, acquire};
use simulator::{Fault, Instrument, Pace, Profile, SimulatedRig, Wire};
use survey::{Amps, Relay, Volts, Wiring};

fn pairs() -> Wiring {
    keysight_34980a::pairs_34924a(1, 26).unwrap()
}

#[tokio::test]
async fn the_meter_measures_four_entries_of_z_times_the_current() {
    let sim = simulated("matrix-34932a", Scene::quiet());
    let mut source = crate::drivers::source(&sim).await;
    let mut switch = crate::drivers::mainframe(&sim).await;
    source.prepare(Amps(1e-3), Volts(4.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    let wiring = keysight_34980a::matrix_34932a(1, 26).unwrap();
    switch
        .move_relays(&[Move::Close(vec![Relay(1921)])])
        .await
        .unwrap();
    let mut worst = 0.0_f64;
    for (drive, inject) in wiring.inject.iter().step_by(5) {
        for (sense, measure) in &wiring.measure {
            let closed: Vec<Relay> = inject.iter().chain(measure).copied().collect();
            switch
                .move_relays(&[Move::Close(closed.clone())])
                .await
                .unwrap();
            switch.settle().await.unwrap();
            source.set_current(Amps(1e-3)).await.unwrap();
            let expected = sim.with_phantom(|phantom| {
                let z = phantom.transfer_impedance(Duration::ZERO).unwrap();
                let (a, b) = (drive.plus.0, drive.minus.0);
                let (k, l) = (sense.plus.0, sense.minus.0);
                1e-3 * ((z[(k, a)] - z[(k, b)]) - (z[(l, a)] - z[(l, b)]))
            });
            worst = worst.max((sim.voltage().0 - expected).abs());
            switch.open_verified(&closed).await.unwrap();
        }
    }
    println!("largest error {worst:.1e} V of readings up to 1 V");
    assert!(worst < 1e-12 * 0.3, "{worst:e}");
    source.off().await.unwrap();
}

#[tokio::test]
async fn source_lost_in_mid_frame_opens_relays_and_is_unknown() {
    let sim = simulated("pairs-34924a", Scene::quiet());
    let rig = mainframe_rig(&sim).await;
    let cutting = sim.clone();
    let cut = async move {
        while cutting.messages(Instrument::Mainframe).reading < 5 {
            tokio::task::yield_now().await;
        }
        cutting.set_wire(Instrument::Source, Wire::Cut);
    };
    let wiring = pairs();
    let (ended, ()) = tokio::join!(frame(&rig, &wiring), cut);
    let fault = ended.unwrap_err();
    assert!(matches!(fault.reason, EndReason::Step(..)), "{fault}");
    assert!(fault.cleanup().unwrap().source_state_unknown());
    assert!(sim.closed().is_empty());
    // The output stays on when its client disconnects; without a closed relay no current flows.
    assert!(sim.source_output().0);
    assert_eq!(sim.flowing(), Amps(0.0));
    sim.set_wire(Instrument::Source, Wire::Sound);
    let mut source = crate::drivers::source(&sim).await;
    source.off().await.unwrap();
    assert_eq!(sim.source_output(), (false, Amps(0.0)));
}

#[tokio::test]
async fn mainframe_power_loss_in_mid_frame_turns_the_source_off() {
    let sim = simulated("pairs-34924a", Scene::quiet());
    let rig = mainframe_rig(&sim).await;
    let cutting = sim.clone();
    let cut = async move {
        while cutting.messages(Instrument::Mainframe).reading < 5 {
            tokio::task::yield_now().await;
        }
        cutting.power_cycle(Instrument::Mainframe);
    };
    let wiring = pairs();
    let (ended, ()) = tokio::join!(frame(&rig, &wiring), cut);
    let fault = ended.unwrap_err();
    assert!(!fault.cleanup().unwrap().source_state_unknown(), "{fault}");
    assert_eq!(sim.source_output(), (false, Amps(0.0)));
    // Reeds open without power.
    assert!(sim.closed().is_empty());
}

#[tokio::test(start_paused = true)]
async fn a_wire_without_replies_is_a_timeout() {
    let sim = simulated("pairs-34924a", Scene::quiet());
    let mut source = crate::drivers::source(&sim).await;
    sim.set_wire(Instrument::Source, Wire::Silent);
    let fault = source.off().await.unwrap_err();
    assert!(fault.to_string().contains("did not answer"), "{fault}");
}

#[tokio::test(start_paused = true)]
async fn a_cut_lasts_through_faults_of_the_instrument() {
    let sim = simulated("pairs-34924a", Scene::quiet());
    for fault in [
        "reset 34980a",
        "power-cut",
        "slot 1 empty",
        "voltmeter missing",
    ] {
        sim.set_wire(Instrument::Mainframe, Wire::Cut);
        sim.fault(&fault.parse().unwrap()).unwrap();
        let stream = sim.connect(Instrument::Mainframe);
        let reached = Keysight34980a::connect(link(stream, "34980A")).await;
        assert!(reached.is_err(), "{fault}");
    }
    sim.fault(&Fault::None).unwrap();
    crate::drivers::mainframe(&sim).await;
}

#[tokio::test(start_paused = true)]
async fn real_time_takes_what_the_instruments_need() {
    let profile = Profile::shipped("pairs-34924a").unwrap();
    // 676 readings of 20 ms with a reed each, and settling: 14.6 s
    for (pace, seconds) in [(Pace::Real, 14.6), (Pace::Scaled(10.0), 1.46)] {
        let sim = SimulatedRig::new(&profile.clone().at_pace(pace), Scene::quiet()).unwrap();
        let rig = mainframe_rig(&sim).await;
        let before = tokio::time::Instant::now();
        frame(&rig, &pairs()).await.unwrap();
        let took = before.elapsed().as_secs_f64();
        println!("{pace:?}: {took:.2} s");
        // Every delay is rounded up to the timer's millisecond.
        assert!((seconds..seconds * 1.25).contains(&took), "{took}");
    }
}

#[tokio::test]
async fn press_changes_the_frame_and_release_restores_every_digit() {
    let sim = simulated("pairs-34924a", Scene::quiet());
    let rig = mainframe_rig(&sim).await;
    let untouched = frame(&rig, &pairs()).await.unwrap();
    sim.press(Load::disc([107.0, 115.0], 10.0, 0.5)).unwrap();
    let pressed = frame(&rig, &pairs()).await.unwrap();
    assert_ne!(untouched.readings, pressed.readings);
    sim.release();
    assert_eq!(
        frame(&rig, &pairs()).await.unwrap().readings,
        untouched.readings
    );
}

#[tokio::test]
async fn the_same_seed_is_the_same_noise() {
    let scene = "seed = 7\n[effects.voltmeter-noise]\nuv = 2.0\n";
    let mut frames = Vec::new();
    for _ in 0..2 {
        let scene = Scene::parse("noisy.toml", scene).unwrap();
        let sim = simulated("pairs-34924a", scene);
        frames.push(frame(&mainframe_rig(&sim).await, &pairs()).await.unwrap());
    }
    assert_eq!(frames[0], frames[1]);
    let quiet = simulated("pairs-34924a", Scene::quiet());
    let quiet = frame(&mainframe_rig(&quiet).await, &pairs()).await.unwrap();
    assert_ne!(frames[0].readings, quiet.readings);
}

#[tokio::test]
async fn the_transcript_tells_what_went_over_the_wires() {
    let sim = simulated("pairs-34924a", Scene::quiet());
    let rig = mainframe_rig(&sim).await;
    sim.keep_transcript();
    let plan = crate::drivers::plan(&pairs());
    acquire(
        &rig,
        &plan,
        crate::drivers::METER,
        crate::drivers::Frozen,
        &rig::Stop::never(),
    )
    .await
    .unwrap();
    let transcript = sim.transcript();
    let reads = transcript
        .iter()
        .filter(|message| message.received.contains("READ?"));
    assert_eq!(reads.clone().count(), 26);
    // The overlap is in the same segment as the query: close first, then open.
    let second = reads.clone().nth(1).unwrap();
    assert!(
        second.received.starts_with("ROUT:CLOS (@1037);"),
        "{}",
        second.received
    );
    // the error queue is read after it
    let (readings, error) = second.answered.as_ref().unwrap().split_once(';').unwrap();
    assert_eq!(readings.split(',').count(), 26);
    assert_eq!(error, "+0,\"No error\"");
}

#[tokio::test(start_paused = true)]
async fn frames_in_instant_time_wait_for_nothing() {
    let sim = simulated("pairs-34924a", Scene::quiet());
    let rig = mainframe_rig(&sim).await;
    frame(&rig, &pairs()).await.unwrap();
    let (before, computing) = (tokio::time::Instant::now(), std::time::Instant::now());
    for _ in 0..10 {
        frame(&rig, &pairs()).await.unwrap();
    }
    println!("{:?} of computing a frame", computing.elapsed() / 10);
    // the paused clock advances only while all tasks wait for it
    assert_eq!(before.elapsed(), Duration::ZERO);
}

#[tokio::test(start_paused = true)]
async fn source_answers_at_the_rate_of_its_command_time() {
    let mut profile = Profile::shipped("pairs-34924a").unwrap();
    // a timer of whole milliseconds would round this up
    profile.source.command_ms = 5.3;
    let rig = SimulatedRig::new(&profile.at_pace(Pace::Real), Scene::quiet()).unwrap();
    let mut source = rig::Link::new(
        rig.connect(Instrument::Source),
        "6221",
        Duration::from_secs(1),
    );
    let begun = tokio::time::Instant::now();
    for _ in 0..200 {
        source.ask("SOUR:CURR?").await.unwrap();
    }
    let took = begun.elapsed();
    let expected = Duration::from_micros(200 * 5300);
    assert!(took + Duration::from_millis(1) >= expected, "{took:?}");
    assert!(took <= expected + Duration::from_millis(5), "{took:?}");
}

/// Every example in the README's table is refused as an undefined header, or as an invalid argument if the table
/// states -108.
#[test]
fn commands_named_as_refused_are_undefined() {
    let chapter = include_str!("../../README.md");
    let (_, table) = chapter
        .split_once("## What the simulated instruments refuse")
        .unwrap();
    let (table, _) = table.split_once("\n## ").unwrap();
    let profile = Profile::shipped("pairs-34924a").unwrap();
    let rig = SimulatedRig::new(&profile.at_pace(Pace::Instant), Scene::quiet()).unwrap();
    let mut rows = 0;
    for row in table.lines().filter(|line| line.contains("` |")) {
        let cells: Vec<&str> = row.trim_matches(['|', ' ']).split(" | ").collect();
        let instrument = match cells[0] {
            "6221" => Instrument::Source,
            _ => Instrument::Mainframe,
        };
        let command = cells[2].trim_matches('`');
        rig.receive(instrument, command);
        let error = rig.receive(instrument, "SYST:ERR?").0.unwrap();
        // a known header with an unsupported argument
        let code = match cells[1].contains("(-108)") {
            true => "-108,",
            false => "-113,",
        };
        assert!(error.starts_with(code), "{command}: {error}");
        rows += 1;
    }
    assert!(rows >= 8, "{rows} rows");
}
