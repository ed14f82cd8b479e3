//! Frames through the byte streams compared with the forward solution.

use std::time::Duration;

use crate::drivers::{Frozen, METER, board_rig, frame, mainframe_rig, plan, simulated};
use phantom::Scene;
use rig::{CurrentSource, Move, Stop, Switch, Voltmeter, acquire};
use simulator::{Instrument, Pace, Profile, SimulatedRig};
use survey::{
    Amps, Dipole, Electrode, Frame, Injection, Plan, Protocol, Reading, Relay, Volts, Wiring,
};

/// Current times transfer impedance, directly from the phantom.
fn bare(simulated: &SimulatedRig, wiring: &Wiring) -> Vec<f64> {
    let plan = plan(wiring);
    simulated.with_phantom(|phantom| {
        let z = phantom.transfer_impedance(Duration::ZERO).unwrap();
        let difference =
            |from: Dipole, at: Electrode| z[(at.0, from.plus.0)] - z[(at.0, from.minus.0)];
        plan.protocol
            .measurements()
            .iter()
            .map(|measurement| {
                let (drive, sense) = (measurement.drive, measurement.sense);
                plan.current.0 * (difference(drive, sense.plus) - difference(drive, sense.minus))
            })
            .collect()
    })
}

/// Tolerance: half a unit of the ninth digit, plus the rounding difference of two calculations.
fn digits(volts: f64, largest: f64) -> f64 {
    0.5 * 10.0_f64.powi(volts.abs().log10().floor() as i32 - 8) + 1e-12 * largest
}

fn assert_bare(simulated: &SimulatedRig, wiring: &Wiring, frame: &Frame) -> f64 {
    let bare = bare(simulated, wiring);
    let largest = bare
        .iter()
        .fold(0.0_f64, |most, volts| most.max(volts.abs()));
    let mut worst = 0.0_f64;
    for (index, (reading, bare)) in frame.readings.iter().zip(&bare).enumerate() {
        let Reading::Ok(Volts(read)) = reading else {
            panic!("reading {index} is {reading:?}");
        };
        let error = (read - bare).abs();
        assert!(
            error <= digits(*bare, largest),
            "reading {index}: {read} against {bare}"
        );
        worst = worst.max(error / largest);
    }
    assert_eq!(frame.readings.len(), 598);
    assert!(frame.compliance.is_empty() && frame.simulated);
    worst
}

fn assert_off(simulated: &SimulatedRig) {
    assert_eq!(simulated.flowing(), Amps(0.0));
    assert_eq!(simulated.source_output(), (false, Amps(0.0)));
    assert!(simulated.closed().is_empty(), "{:?}", simulated.closed());
    assert_eq!(simulated.poles(), [None; 4]);
}

#[tokio::test]
async fn every_wiring_reads_forward_solution_to_the_digits_sent() {
    let pairs = keysight_34980a::pairs_34924a(1, 26).unwrap();
    let rig = simulated("pairs-34924a", Scene::quiet());
    let scanned = frame(&mainframe_rig(&rig).await, &pairs).await.unwrap();
    let worst = assert_bare(&rig, &pairs, &scanned);
    let messages = rig.messages(Instrument::Mainframe);
    println!(
        "pairs: {worst:.1e} of the largest reading, {messages:?}, {:?}",
        rig.now()
    );
    assert_eq!((messages.reading, messages.readings), (26, 26 * 26));
    // The source confirms every message: with two connections only a reply guarantees the order.
    let source = rig.messages(Instrument::Source);
    assert_eq!(source.received, source.answered);
    assert_off(&rig);

    let matrix = keysight_34980a::matrix_34932a(1, 26).unwrap();
    let rig = simulated("matrix-34932a", Scene::quiet());
    let routed = frame(&mainframe_rig(&rig).await, &matrix).await.unwrap();
    let worst = assert_bare(&rig, &matrix, &routed);
    let messages = rig.messages(Instrument::Mainframe);
    println!(
        "matrix: {worst:.1e} of the largest reading, {messages:?}, {:?}",
        rig.now()
    );
    assert_eq!((messages.reading, messages.readings), (598, 598));
    assert_off(&rig);

    let chips = gpio_mux::wiring(26).unwrap();
    let rig = simulated("gpio-board", Scene::quiet());
    let multiplexed = frame(&board_rig(&rig).await, &chips).await.unwrap();
    let worst = assert_bare(&rig, &chips, &multiplexed);
    println!("board: {worst:.1e} of the largest reading, {:?}", rig.now());
    assert_off(&rig);

    assert_eq!(scanned.readings, routed.readings);
    assert_eq!(scanned.readings, multiplexed.readings);

    // map M on armature relays, map F and map Z
    for (profile, wiring, reading_messages) in [
        ("pairs-34922a", keysight_34980a::pairs_34922a(1, 26), 26),
        ("fast-34925a", keysight_34980a::fast_34925a(1, 2, 26), 26),
        ("matrix-34934a", keysight_34980a::matrix_34934a(1, 26), 598),
    ] {
        let wiring = wiring.unwrap();
        let rig = simulated(profile, Scene::quiet());
        let further = frame(&mainframe_rig(&rig).await, &wiring).await.unwrap();
        let worst = assert_bare(&rig, &wiring, &further);
        println!(
            "{profile}: {worst:.1e} of the largest reading, {:?}",
            rig.now()
        );
        let messages = rig.messages(Instrument::Mainframe);
        assert_eq!(messages.reading, reading_messages, "{profile}");
        assert_off(&rig);
        assert_eq!(further.readings, scanned.readings, "{profile}");
    }
}

#[tokio::test]
async fn nothing_connected_is_compliance_and_no_current() {
    let rig = simulated("pairs-34924a", Scene::quiet());
    let mut source = crate::drivers::source(&rig).await;
    source.prepare(Amps(1e-3), Volts(4.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    assert!(!source.in_compliance().await.unwrap());
    source.set_current(Amps(1e-3)).await.unwrap();
    assert!(source.in_compliance().await.unwrap());
    assert_eq!(rig.flowing(), Amps(0.0));
    source.off().await.unwrap();
    assert_off(&rig);
}

#[tokio::test]
async fn current_flows_while_the_driving_pair_is_closed() {
    let rig = simulated("pairs-34924a", Scene::quiet());
    let mut source = crate::drivers::source(&rig).await;
    let mut switch = crate::drivers::mainframe(&rig).await;
    source.prepare(Amps(1e-3), Volts(4.0)).await.unwrap();
    source.set_output(true).await.unwrap();
    source.set_current(Amps(1e-3)).await.unwrap();
    switch
        .move_relays(&[Move::Close(vec![Relay(1036)])])
        .await
        .unwrap();
    switch.settle().await.unwrap();
    assert_eq!(rig.flowing(), Amps(1e-3));
    // Events latch: the first reply still reports the open circuit.
    assert!(source.in_compliance().await.unwrap());
    assert!(!source.in_compliance().await.unwrap());
    // Two neighbouring pairs: the source is shorted through electrode 2, and little current is left for the sheet.
    switch
        .move_relays(&[Move::Close(vec![Relay(1037)])])
        .await
        .unwrap();
    switch.settle().await.unwrap();
    assert_eq!(rig.flowing(), Amps(1e-3));
    switch
        .open_verified(&[Relay(1036), Relay(1037)])
        .await
        .unwrap();
    assert_eq!(rig.flowing(), Amps(0.0));
    assert!(source.in_compliance().await.unwrap());
    source.off().await.unwrap();
}

#[tokio::test]
async fn low_compliance_flags_all_readings_and_names_electrodes() {
    let wiring = keysight_34980a::pairs_34924a(1, 26).unwrap();
    let sim = simulated("pairs-34924a", Scene::quiet());
    let rig = mainframe_rig(&sim).await;
    let mut plan = plan(&wiring);
    plan.compliance = Volts(0.2);
    let frame = rig::acquire(
        &rig,
        &plan,
        crate::drivers::METER,
        crate::drivers::Frozen,
        &rig::Stop::never(),
    )
    .await
    .unwrap();
    assert_eq!(frame.compliance.len(), 26);
    assert!(
        frame
            .readings
            .iter()
            .all(|reading| *reading == Reading::NotMeasured)
    );
    assert_off(&sim);
}

/// Allowed time from compliance to off: the relays' time, the query, and the source's own messages.
const OFF_WITHIN: Duration = Duration::from_millis(100);

#[tokio::test(start_paused = true)]
async fn compliance_switches_the_source_off_within_100_ms() {
    let wiring = keysight_34980a::pairs_34924a(1, 26).unwrap();
    let profile = Profile::shipped("pairs-34924a")
        .unwrap()
        .at_pace(Pace::Real);
    let sim = SimulatedRig::new(&profile, Scene::quiet()).unwrap();
    let rig = mainframe_rig(&sim).await;
    let mut plan = plan(&wiring);
    plan.compliance = Volts(0.2);
    let never = rig::Stop::never();
    let (meter, clock) = (crate::drivers::METER, crate::drivers::Frozen);
    let mut frame = std::pin::pin!(rig::acquire(&rig, &plan, meter, clock, &never));
    let (mut since, mut longest, mut times) = (None, Duration::ZERO, 0);
    let frame = loop {
        tokio::select! {
            frame = &mut frame => break frame.unwrap(),
            () = tokio::time::sleep(Duration::from_millis(1)) => {}
        }
        if sim.status().source.in_compliance {
            let since = since.get_or_insert_with(|| {
                times += 1;
                tokio::time::Instant::now()
            });
            longest = longest.max(since.elapsed());
        } else {
            since = None;
        }
    };
    assert_eq!(frame.compliance.len(), 26);
    // 26 separate times, because the source is off between injections
    assert_eq!(times, 26);
    println!("{longest:?} from compliance to off");
    assert!(longest <= OFF_WITHIN, "{longest:?}");
    assert_off(&sim);
}

#[tokio::test]
async fn one_wrong_relay_number_and_the_readings_go_wrong() {
    let right = keysight_34980a::matrix_34932a(1, 26).unwrap();
    let sim = simulated("matrix-34932a", Scene::quiet());
    let rig = mainframe_rig(&sim).await;
    let bare = bare(&sim, &right);

    // Injecting pair 3 is configured with the relay of pair 30, which is not connected: compliance, no measurement.
    let mut wrong = right.clone();
    wrong.inject[2].1 = vec![Relay(1614)];
    let frame_of_nothing = frame(&rig, &wrong).await.unwrap();
    assert_eq!(frame_of_nothing.compliance, [Electrode(2)]);

    // Measuring pairs 3 and 4 exchanged: each has the other's voltage, everything else is correct.
    let mut wrong = right.clone();
    let third = wrong.measure[2].1.clone();
    wrong.measure[2].1 = std::mem::replace(&mut wrong.measure[3].1, third);
    let exchanged = frame(&rig, &wrong).await.unwrap();
    let plan = plan(&right);
    let mut differing = 0;
    for (measurement, (reading, bare)) in plan
        .protocol
        .measurements()
        .iter()
        .zip(exchanged.readings.iter().zip(&bare))
    {
        let concerned = [2, 3].contains(&measurement.sense.plus.0);
        let differs = reading
            .volts()
            .is_none_or(|volts| (volts.0 - bare).abs() > 1e-6);
        assert!(concerned || !differs, "{measurement:?}");
        differing += usize::from(differs);
    }
    println!("{differing} readings differ");
    assert!(differing > 30);
    assert_off(&sim);
}

#[tokio::test]
async fn a_voltmeter_joined_to_nothing_reads_zero() {
    let sim = simulated("matrix-34932a", Scene::quiet());
    let mut meter = crate::drivers::mainframe(&sim).await;
    Voltmeter::prepare(&mut meter, crate::drivers::METER, &[])
        .await
        .unwrap();
    assert_eq!(meter.read().await.unwrap(), Reading::Ok(Volts(0.0)));
}

#[tokio::test(start_paused = true)]
async fn the_board_waits_longer_than_its_usual_watchdog() {
    let wiring = gpio_mux::wiring(26).unwrap();
    let few = Protocol::sheffield(26).unwrap().measurements()[..1].to_vec();
    let injection = Injection {
        current: Amps(1e-3),
        compliance: Volts(4.0),
        // no message reaches the board meanwhile
        settle: Duration::from_secs(12),
        reversal: true,
    };
    let protocol = Protocol::new(26, few).unwrap();
    let plan = Plan::injecting(&protocol, &wiring, injection).unwrap();
    let profile = Profile::shipped("gpio-board").unwrap();
    let simulated = SimulatedRig::new(&profile, Scene::quiet()).unwrap();
    let rig = board_rig(&simulated).await;
    let frame = acquire(&rig, &plan, METER, Frozen, &Stop::never()).await;
    assert!(matches!(frame.unwrap().readings[..], [Reading::Ok(_)]));
    assert!(simulated.now() > Duration::from_secs(24));
}
