//! Every exit path of a plan, on a rig of test instruments each of whose calls can be made to fail.

mod stand_in;

use std::time::Duration;

use chrono::{DateTime, Utc};
use rig::{
    AcquireError, Clock, EndReason, InjectionSink, MeterSettings, RigError, Stop, acquire,
    acquire_reporting, check_at_start, safe_off,
};
use stand_in::{Fault, Part, StandIn, wirings};
use survey::{Amps, Electrode, Frame, Injection, Plan, Protocol, Reading, Relay, Volts, Wiring};

const METER: MeterSettings = MeterSettings::new(Volts(1.0), 1.0);

/// A clock that does not advance.
struct Frozen;

impl Clock for Frozen {
    fn monotonic(&self) -> Duration {
        Duration::from_secs(7)
    }
    fn wall(&self) -> DateTime<Utc> {
        DateTime::UNIX_EPOCH
    }
}

fn plan(wiring: &Wiring, settle: Duration) -> Plan {
    let protocol = Protocol::sheffield(wiring.electrodes).unwrap();
    Plan::new(&protocol, wiring, Amps(1e-3), Volts(10.0), settle).unwrap()
}

fn wirings(electrodes: usize) -> [Wiring; 3] {
    [
        wirings::pairs(electrodes),
        wirings::matrix(electrodes),
        wirings::board(electrodes),
    ]
}

async fn run(stand_in: &StandIn, plan: &Plan) -> Result<Frame, AcquireError> {
    acquire(&stand_in.rig(), plan, METER, Frozen, &Stop::never()).await
}

#[tokio::test(start_paused = true)]
async fn every_wiring_reads_every_question_in_its_place_and_ends_safe() {
    for wiring in wirings(26) {
        for settle in [Duration::ZERO, Duration::from_millis(2)] {
            let stand_in = StandIn::new(&wiring);
            let plan = plan(&wiring, settle);
            let frame = run(&stand_in, &plan).await.unwrap();
            for (measurement, reading) in plan.protocol.measurements().iter().zip(&frame.readings) {
                assert_eq!(*reading, StandIn::answer(*measurement), "{}", wiring.name);
            }
            assert_eq!(frame.settings.settle, settle);
            assert_eq!(frame.monotonic, Duration::from_secs(7));
            assert!(frame.compliance.is_empty() && frame.simulated);
            stand_in.assert_safe();
        }
    }
}

#[tokio::test(start_paused = true)]
async fn injections_are_reported_once_without_waiting() {
    for wiring in wirings(5) {
        for (held, limited) in [(64, Electrode(2)), (64, Electrode(4)), (2, Electrode(2))] {
            let stand_in = StandIn::new(&wiring).in_compliance_at(limited);
            let plan = plan(&wiring, Duration::from_millis(2));
            let (to, mut came) = tokio::sync::mpsc::channel(held);
            let sink = InjectionSink { frame: 7, to };
            let rig = stand_in.rig();
            let never = Stop::never();
            let frame = acquire_reporting(&rig, &plan, METER, Frozen, &never, Some(sink));
            let frame = frame.await.unwrap();
            let mut all = Vec::new();
            while let Some(injection) = came.recv().await {
                all.push(injection);
            }
            assert_eq!(all.len(), held.min(5), "{}", wiring.name);
            for injection in &all {
                let drive = injection.drive;
                assert_eq!(
                    (injection.frame, injection.frame_began),
                    (7, frame.monotonic)
                );
                assert_eq!(injection.compliance, drive.plus == limited);
                assert!(injection.monotonic >= frame.monotonic && injection.wall >= frame.wall);
                let measurements = plan.protocol.measurements();
                for (number, reading) in &injection.readings {
                    assert_eq!(measurements[*number].drive, drive);
                    assert_eq!(*reading, frame.readings[*number], "{}", wiring.name);
                }
            }
            let of_all: usize = all.iter().map(|injection| injection.readings.len()).sum();
            assert!(held < 5 || of_all == plan.protocol.len());
            assert!(all.is_sorted_by(|a, b| a.monotonic < b.monotonic));
        }
    }
}

/// Number of instrument calls that a plan takes.
async fn calls(wiring: &Wiring, plan: &Plan) -> usize {
    let stand_in = StandIn::new(wiring);
    run(&stand_in, plan).await.unwrap();
    stand_in.calls()
}

#[tokio::test(start_paused = true)]
async fn whichever_call_fails_once_the_source_ends_off_and_verified() {
    for wiring in wirings(5) {
        let plan = plan(&wiring, Duration::from_millis(1));
        for call in 0..calls(&wiring, &plan).await {
            let stand_in = StandIn::new(&wiring).failing(call, Fault::Once);
            let fault = run(&stand_in, &plan).await.unwrap_err();
            assert!(
                fault.cause().is_some() && fault.cleanup().is_none(),
                "{call}: {fault}"
            );
            stand_in.assert_safe();
        }
    }
}

#[tokio::test(start_paused = true)]
async fn lost_source_opens_the_relays_and_is_reported_as_unknown() {
    for wiring in wirings(5) {
        let plan = plan(&wiring, Duration::ZERO);
        // During the last two calls the source is already verified off: losing it there has no effect.
        for call in 0..calls(&wiring, &plan).await - 2 {
            let stand_in = StandIn::new(&wiring).failing(call, Fault::Lost(Part::Source));
            let fault = run(&stand_in, &plan).await.unwrap_err();
            let cleanup = fault
                .cleanup()
                .expect("a lost source cannot be verified off");
            assert!(cleanup.source_state_unknown() && cleanup.relays.is_none());
            assert!(
                fault.to_string().contains("source state unknown"),
                "{fault}"
            );
            assert_eq!(stand_in.closed(), []);
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_lost_switch_switches_the_source_off() {
    for wiring in wirings(5) {
        let plan = plan(&wiring, Duration::ZERO);
        for call in 0..calls(&wiring, &plan).await {
            let stand_in = StandIn::new(&wiring).failing(call, Fault::Lost(Part::SwitchAndMeter));
            let fault = run(&stand_in, &plan).await.unwrap_err();
            let cleanup = fault.cleanup().expect("relays cannot be read back");
            assert!(!cleanup.source_state_unknown() && cleanup.relays.is_some());
            assert!(stand_in.is_off());
        }
    }
}

#[tokio::test(start_paused = true)]
async fn losing_both_instruments_reports_both() {
    let wiring = wirings::pairs(5);
    let stand_in = StandIn::new(&wiring).failing(9, Fault::Lost(Part::Everything));
    let fault = run(&stand_in, &plan(&wiring, Duration::ZERO))
        .await
        .unwrap_err();
    let reported = fault.to_string();
    assert!(reported.contains("treat the sheet as live"), "{reported}");
    assert!(matches!(fault.cause(), Some(RigError::Link(_))));
}

#[tokio::test(start_paused = true)]
async fn stop_takes_effect_between_two_steps() {
    for wiring in wirings(5) {
        let plan = plan(&wiring, Duration::from_secs(3600));
        for call in 0..calls(&wiring, &plan).await {
            let (button, stop) = Stop::button();
            let stand_in = StandIn::new(&wiring).calling(call, move || button.press());
            let ended = acquire(&stand_in.rig(), &plan, METER, Frozen, &stop).await;
            match ended {
                Err(AcquireError {
                    reason: EndReason::Stop(_),
                    made_safe: Ok(_),
                }) => {}
                // the stop was requested during the last step
                Ok(_) => assert!(
                    call + 5 > stand_in.calls(),
                    "{call} of {}",
                    stand_in.calls()
                ),
                Err(fault) => panic!("{fault}"),
            }
            stand_in.assert_safe();
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_stop_cuts_the_settling_short() {
    let wiring = wirings::pairs(5);
    let plan = plan(&wiring, Duration::from_secs(3600));
    let (button, stop) = Stop::button();
    let stand_in = StandIn::new(&wiring);
    let before = tokio::time::Instant::now();
    let press = async {
        tokio::time::sleep(Duration::from_secs(5)).await;
        button.press();
    };
    let rig = stand_in.rig();
    let (ended, ()) = tokio::join!(acquire(&rig, &plan, METER, Frozen, &stop), press);
    let ended = ended.unwrap_err();
    assert!(matches!(ended.reason, EndReason::Stop(_)));
    assert!(ended.made_safe.is_ok());
    assert_eq!(before.elapsed(), Duration::from_secs(5));
    stand_in.assert_safe();
}

#[tokio::test(start_paused = true)]
async fn a_dropped_future_leaves_the_rig_safe_for_the_next_caller() {
    for wiring in wirings(5) {
        let plan = plan(&wiring, Duration::ZERO);
        for call in 0..calls(&wiring, &plan).await {
            let (reached, mut reaches) = tokio::sync::mpsc::unbounded_channel();
            let stand_in = StandIn::new(&wiring).calling(call, move || {
                reached.send(()).ok();
            });
            let (rig, never) = (stand_in.rig(), Stop::never());
            tokio::select! {
                biased;
                Some(()) = reaches.recv() => {}
                _ = acquire(&rig, &plan, METER, Frozen, &never) => {
                    unreachable!("call {call} is reached before the end")
                }
            }
            drop(rig.lock().await);
            stand_in.assert_safe();
        }
    }
}

#[tokio::test(start_paused = true)]
async fn driver_panic_makes_the_rig_safe_before_it_propagates() {
    let wiring = wirings::pairs(5);
    let stand_in = StandIn::new(&wiring).calling(12, || panic!("a broken invariant"));
    let rig = stand_in.rig();
    let plan = plan(&wiring, Duration::ZERO);
    let task = tokio::spawn({
        let rig = rig.clone();
        async move { acquire(&rig, &plan, METER, Frozen, &Stop::never()).await }
    });
    assert!(task.await.unwrap_err().is_panic());
    drop(rig.lock().await);
    stand_in.assert_safe();
}

#[tokio::test(start_paused = true)]
async fn compliance_voids_readings_of_its_drive_and_names_electrode() {
    for wiring in wirings(6) {
        let stand_in = StandIn::new(&wiring).in_compliance_at(Electrode(2));
        let plan = plan(&wiring, Duration::ZERO);
        let frame = run(&stand_in, &plan).await.unwrap();
        assert_eq!(frame.compliance, [Electrode(2)]);
        for (measurement, reading) in plan.protocol.measurements().iter().zip(&frame.readings) {
            let expected = if measurement.drive.plus == Electrode(2) {
                Reading::NotMeasured
            } else {
                StandIn::answer(*measurement)
            };
            assert_eq!(*reading, expected);
        }
        stand_in.assert_safe();
    }
}

#[tokio::test(start_paused = true)]
async fn compliance_before_relays_are_confirmed_voids_both_drives() {
    let wiring = wirings::pairs(6);
    let plan = plan(&wiring, Duration::from_millis(2));
    // the relays of the second injection move long after the query of the source's compliance
    let (late, second) = (Duration::from_millis(80), 9);
    let stand_in = StandIn::new(&wiring).slow(Part::SwitchAndMeter, second, late);
    let hand = stand_in.clone();
    let stand_in = stand_in.calling(second, move || {
        drop(hand.in_compliance_at(Electrode(0)));
    });
    let frame = run(&stand_in, &plan).await.unwrap();
    assert_eq!(frame.compliance, [Electrode(1), Electrode(0)]);
    for (measurement, reading) in plan.protocol.measurements().iter().zip(&frame.readings) {
        let voided = measurement.drive.plus.0 < 2;
        assert_eq!(*reading == Reading::NotMeasured, voided, "{measurement:?}");
    }
    stand_in.assert_safe();
}

#[tokio::test(start_paused = true)]
async fn an_overload_or_a_missing_reading_is_a_flag_in_its_place() {
    let wiring = wirings::pairs(6);
    let plan = plan(&wiring, Duration::ZERO);
    for flag in [Reading::Overload, Reading::NotMeasured] {
        let requested = plan.protocol.measurements()[4];
        let stand_in = StandIn::new(&wiring).answering(requested, flag);
        let frame = run(&stand_in, &plan).await.unwrap();
        assert_eq!(frame.readings[4], flag);
        assert_eq!(
            frame
                .readings
                .iter()
                .filter(|reading| reading.is_ok())
                .count(),
            17
        );
    }
}

#[tokio::test(start_paused = true)]
async fn a_scan_that_answers_too_little_is_an_error_not_a_shift() {
    let wiring = wirings::pairs(6);
    let stand_in = StandIn::new(&wiring).losing_a_reading();
    let fault = run(&stand_in, &plan(&wiring, Duration::ZERO))
        .await
        .unwrap_err();
    assert!(
        matches!(
            fault.cause(),
            Some(RigError::ReadingCount {
                came: 5,
                expected: 6
            })
        ),
        "{fault}"
    );
    stand_in.assert_safe();
}

#[tokio::test(start_paused = true)]
async fn relays_found_closed_at_the_start_are_named_with_their_pair() {
    let wiring = wirings::matrix(26);
    let stand_in = StandIn::new(&wiring);
    let rig = stand_in.rig();
    check_at_start(&rig, &wiring).await.unwrap();
    stand_in.close([Relay(1203), Relay(1226)]);
    let refusal = check_at_start(&rig, &wiring).await.unwrap_err().to_string();
    assert!(
        refusal.contains("1203 (electrodes 3 and 4), 1226 (electrodes 1 and 26)"),
        "{refusal}"
    );
    safe_off(&rig, &wiring).await.unwrap();
    check_at_start(&rig, &wiring).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn safe_off_opens_relays_even_when_the_source_does_not_answer() {
    let wiring = wirings::matrix(26);
    let stand_in = StandIn::new(&wiring).failing(0, Fault::Lost(Part::Source));
    stand_in.close([Relay(1203), Relay(1921)]);
    let reported = safe_off(&stand_in.rig(), &wiring).await.unwrap_err();
    assert!(
        reported.source_state_unknown() && reported.relays.is_none(),
        "{reported}"
    );
    assert_eq!(stand_in.closed(), []);
}

fn both_ways(wiring: &Wiring) -> Plan {
    let injection = Injection {
        current: Amps(1e-3),
        compliance: Volts(10.0),
        settle: Duration::from_millis(1),
        reversal: true,
    };
    let protocol = Protocol::sheffield(wiring.electrodes).unwrap();
    Plan::injecting(&protocol, wiring, injection).unwrap()
}

#[tokio::test(start_paused = true)]
async fn current_reversal_cancels_a_constant_emf() {
    for wiring in wirings(8).map(Wiring::chained) {
        let plan = both_ways(&wiring);
        let stand_in = StandIn::new(&wiring).with_emf(50e-6);
        let frame = run(&stand_in, &plan).await.unwrap();
        for (measurement, reading) in plan.protocol.measurements().iter().zip(&frame.readings) {
            let (Reading::Ok(read), Reading::Ok(true_volts)) =
                (reading, StandIn::answer(*measurement))
            else {
                panic!("{reading:?}");
            };
            let error = (read.0 - true_volts.0).abs();
            // up to the rounding of numbers of this size
            assert!(error <= 1e-12 * true_volts.0.abs().max(1.0), "{error}");
        }
        assert!(frame.settings.precautions.reversal);
        // without reversal the EMF is in the readings
        let plain = run(&stand_in, &self::plan(&wiring, Duration::ZERO))
            .await
            .unwrap();
        assert_ne!(plain.readings, frame.readings);
        stand_in.assert_safe();
    }
}

#[tokio::test(start_paused = true)]
async fn a_zero_current_frame_reads_offsets_only_and_subtracts_them() {
    for wiring in wirings(8) {
        let plan = both_ways(&wiring).at_zero_current();
        let stand_in = StandIn::new(&wiring).with_emf(50e-6);
        let zero = run(&stand_in, &plan).await.unwrap();
        assert!(
            zero.readings
                .iter()
                .all(|reading| *reading == Reading::Ok(Volts(50e-6)))
        );
        let plain = self::plan(&wiring, Duration::from_millis(1));
        let mut frame = run(&stand_in, &plain).await.unwrap();
        frame.subtract(&zero).unwrap();
        assert!(frame.settings.precautions.zeroed);
        for (measurement, reading) in plan.protocol.measurements().iter().zip(&frame.readings) {
            let (Reading::Ok(read), Reading::Ok(true_volts)) =
                (reading, StandIn::answer(*measurement))
            else {
                panic!("{reading:?}");
            };
            assert!((read.0 - true_volts.0).abs() <= 1e-9);
        }
        stand_in.assert_safe();
    }
}

#[tokio::test(start_paused = true)]
async fn extra_readings_of_a_scan_are_kept_apart_and_fail_nothing() {
    let wiring = wirings::pairs(6);
    let plan = plan(&wiring, Duration::ZERO);
    let drive = survey::Dipole::adjacent(0, 6);
    let own = survey::Measurement {
        drive,
        sense: drive,
    };
    let stand_in = StandIn::new(&wiring).answering(own, Reading::Overload);
    let frame = run(&stand_in, &plan).await.unwrap();
    assert!(frame.readings.iter().all(|reading| reading.is_ok()));
    assert_eq!(frame.extra.len(), 6 * 3);
    assert_eq!(frame.extra[0].measurement, own);
    assert_eq!(frame.extra[0].reading, Reading::Overload);
    let quality = survey::Checks::new(&plan.protocol).of(&frame);
    assert_eq!(quality.overloads, 0);
    assert!(!quality.flags.contains(&survey::QualityFlag::Incomplete));
}
