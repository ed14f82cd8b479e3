//! All data from phantom to frame pass as SCPI text: 26 messages carry a frame, readings have the digits of the
//! instruments, and one wrong relay number makes the frame wrong.

use std::time::Duration;

use keithley_6221::Keithley6221;
use keysight_34980a::Keysight34980a;
use phantom::Scene;
use rig::{BoxStream, Link, MeterSettings, Rig, Stop, SystemClock};
use simulator::{Instrument, Pace, Profile, SimulatedRig};
use survey::{Amps, Dipole, Frame, Plan, Protocol, Relay, Volts, Wiring};

use crate::test_rig::runtime;

const DEADLINE: Duration = Duration::from_secs(30);
pub const METER: MeterSettings = MeterSettings::new(Volts(1.0), 1.0);
pub const CURRENT: Amps = Amps(1e-3);

pub type PairRig =
    Rig<Keithley6221<BoxStream>, Keysight34980a<BoxStream>, Keysight34980a<BoxStream>>;

/// A simulated rig in instant time.
pub fn simulated(profile: &str, scene: Scene) -> SimulatedRig {
    let profile = Profile::shipped(profile)
        .expect("the profile ships with the bench")
        .at_pace(Pace::Instant);
    SimulatedRig::new(&profile, scene).expect("the scene's sheet can be made")
}

/// The real drivers on the simulated rig's streams.
pub async fn drivers(bench: &SimulatedRig) -> PairRig {
    let source = Keithley6221::connect(Link::new(
        bench.connect(Instrument::Source),
        "6221 in memory",
        DEADLINE,
    ))
    .await
    .expect("the simulated 6221 answers");
    let mainframe = Keysight34980a::connect(Link::new(
        bench.connect(Instrument::Mainframe),
        "34980A in memory",
        DEADLINE,
    ))
    .await
    .expect("the simulated 34980A answers");
    Rig::new(source, mainframe.clone(), mainframe).as_simulated(true)
}

pub fn plan(wiring: &Wiring) -> Plan {
    let protocol = Protocol::sheffield(26).expect("26 electrodes");
    // without a delay, relays and query are in one message
    Plan::new(&protocol, wiring, CURRENT, Volts(10.0), Duration::ZERO)
        .expect("the wiring serves the protocol")
}

pub async fn frame(rig: &PairRig, plan: &Plan) -> Frame {
    rig::acquire(rig, plan, METER, SystemClock::new(), &Stop::never())
        .await
        .expect("a frame is acquired")
}

pub fn volts(frame: &Frame) -> Vec<f64> {
    let volt = |(index, reading): (usize, &survey::Reading)| match reading.volts() {
        Some(volts) => volts.0,
        None => panic!(
            "m{index} is {reading:?}, in compliance: {:?}",
            frame.compliance
        ),
    };
    frame.readings.iter().enumerate().map(volt).collect()
}

#[test]
fn frame_is_26_messages_and_their_replies() {
    runtime().block_on(async {
        let bench = simulated("pairs-34924a", Scene::quiet());
        let rig = drivers(&bench).await;
        let plan = plan(&keysight_34980a::pairs_34924a(1, 26).expect("26 pairs fit"));
        bench.keep_transcript();
        let before = bench.messages(Instrument::Mainframe);
        frame(&rig, &plan).await;
        let after = bench.messages(Instrument::Mainframe);
        assert_eq!(
            after.reading - before.reading,
            26,
            "one reading message an injection"
        );
        assert_eq!(
            after.readings - before.readings,
            26 * 26,
            "a scan takes all 26 pairs"
        );
        let transcript = bench.transcript();
        let scans: Vec<_> = transcript
            .iter()
            .filter(|message| message.received.contains("READ?"))
            .collect();
        assert_eq!(scans.len(), 26);
        for message in &scans[1..] {
            assert!(
                message.received.contains("ROUT:CLOS (@"),
                "relays and question in one message: {}",
                message.received
            );
            let answer = message.answered.as_deref().expect("READ? is answered");
            // the readings, and the error queue queried in the same message
            let (readings, errors) = answer.split_once(';').expect("two questions");
            assert_eq!(readings.split(',').count(), 26, "{answer}");
            assert_eq!(errors, "+0,\"No error\"");
        }
    });
}

#[test]
fn first_frame_is_the_forward_solution_in_instrument_digits() {
    runtime().block_on(async {
        let bench = simulated("pairs-34924a", Scene::quiet());
        let rig = drivers(&bench).await;
        let plan = plan(&keysight_34980a::pairs_34924a(1, 26).expect("26 pairs fit"));
        let measured = volts(&frame(&rig, &plan).await);
        let impedance = bench.with_phantom(|phantom| {
            phantom
                .transfer_impedance(Duration::ZERO)
                .expect("it is solved")
                .clone()
        });
        for (measurement, measured) in plan.protocol.measurements().iter().zip(measured) {
            let (drive, sense) = (measurement.drive, measurement.sense);
            let between =
                |to: usize| impedance[(sense.plus.0, to)] - impedance[(sense.minus.0, to)];
            let exact = CURRENT.0 * (between(drive.plus.0) - between(drive.minus.0));
            // +d.ddddddddE+dd: half a unit of the ninth digit
            let digit = 0.5 * 10_f64.powf(exact.abs().log10().floor() - 8.0);
            assert!(
                (measured - exact).abs() <= 1.01 * digit,
                "{drive} {sense}: {measured:e} against {exact:e}"
            );
        }
    });
}

#[test]
fn one_wrong_relay_number_spoils_the_readings() {
    // the paused clock does not advance while a task works, so a busy machine is not slower than the relays
    let mut paused = tokio::runtime::Builder::new_current_thread();
    let paused = paused.enable_all().start_paused(true).build();
    paused.expect("a runtime can be built").block_on(async {
        let bench = simulated("pairs-34924a", Scene::quiet());
        let rig = drivers(&bench).await;
        let right = keysight_34980a::pairs_34924a(1, 26).expect("26 pairs fit");
        let good = volts(&frame(&rig, &plan(&right)).await);
        let mut wrong = right.clone();
        // pair 6 is configured with the relay of a pair wired elsewhere: 62 is not connected
        wrong.inject[5] = (Dipole::adjacent(5, 26), vec![Relay(1062)]);
        let spoiled = rig::acquire(
            &rig,
            &plan(&wrong),
            METER,
            SystemClock::new(),
            &Stop::never(),
        )
        .await
        .expect("the frame is taken, its readings tell");
        let injected: Vec<usize> = (0..598).filter(|reading| reading / 23 == 5).collect();
        assert!(
            injected
                .iter()
                .all(|reading| !spoiled.readings[*reading].is_ok()),
            "nothing closed: compliance, not numbers: {:?}",
            spoiled.readings[injected[0]]
        );
        assert_eq!(spoiled.compliance.len(), 1);

        let mut swapped = right;
        swapped.measure.swap(2, 9);
        let (third, tenth) = (swapped.measure[2].0, swapped.measure[9].0);
        swapped.measure[2].0 = tenth;
        swapped.measure[9].0 = third;
        let spoiled = frame(&rig, &plan(&swapped)).await;
        // exchanged pairs read the driven pair in two injections: its contacts carry the current, so the reading is
        // over range
        let changed = good
            .iter()
            .zip(&spoiled.readings)
            .filter(|(good, read)| {
                read.volts()
                    .is_none_or(|volts| (*good - volts.0).abs() > 1e-6)
            })
            .count();
        assert!(changed > 20, "{changed} readings changed");
    });
}
