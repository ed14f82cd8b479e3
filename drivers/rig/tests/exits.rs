//! Time until a rig is safe, and errors detected by reading the relays back.

mod stand_in;

use std::time::Duration;

use rig::{
    EndReason, MeterSettings, RigError, StartError, Stop, SystemClock, acquire, check_at_start,
    safe_off,
};
use stand_in::{Fault, Part, StandIn, wirings};
use survey::{Amps, Plan, Protocol, Relay, Volts};
use tokio::time::Instant;

const METER: MeterSettings = MeterSettings {
    autozero: true,
    ..MeterSettings::new(Volts(1.0), 200.0)
};

/// Allowed time from detection to verified off.
const ALLOWED: Duration = Duration::from_millis(100);

fn plan() -> Plan {
    let wiring = wirings::pairs(5);
    let protocol = Protocol::sheffield(5).unwrap();
    Plan::new(&protocol, &wiring, Amps(1e-3), Volts(10.0), Duration::ZERO).unwrap()
}

#[tokio::test(start_paused = true)]
async fn a_stop_while_a_scan_takes_minutes_switches_off_at_once() {
    let plan = plan();
    let minutes = Duration::from_secs(208);
    let stand_in = StandIn::new(&plan.wiring).slow(Part::SwitchAndMeter, 6, minutes);
    let (button, stop) = Stop::button();
    let rig = stand_in.rig();
    let watched = async {
        // well into the first scan
        tokio::time::sleep(minutes / 2).await;
        assert!(!stand_in.is_off(), "a scan is under way");
        let pressed = Instant::now();
        button.press();
        while !stand_in.is_off() && pressed.elapsed() < minutes {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        pressed.elapsed()
    };
    let clock = SystemClock::new();
    let (ended, took) = tokio::join!(acquire(&rig, &plan, METER, clock, &stop), watched);
    let ended = ended.unwrap_err();
    assert!(matches!(ended.reason, EndReason::Stop(_)), "{ended}");
    assert!(ended.made_safe.is_ok(), "{ended}");
    assert!(took <= ALLOWED, "{took:?}");
    assert!(ended.off_after().unwrap() <= ALLOWED, "{ended:?}");
    stand_in.assert_safe();
}

#[tokio::test(start_paused = true)]
async fn relays_open_beside_a_source_that_does_not_answer_in_time() {
    let plan = plan();
    let stand_in = StandIn::new(&plan.wiring).slow(Part::Source, 0, Duration::from_secs(30));
    stand_in.close([Relay(1036), Relay(1037)]);
    let rig = stand_in.rig();
    let watched = async {
        let begun = Instant::now();
        while !stand_in.closed().is_empty() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        begun.elapsed()
    };
    let (made, opened) = tokio::join!(safe_off(&rig, &plan.wiring), watched);
    made.unwrap();
    assert!(opened <= 2 * ALLOWED, "{opened:?}");
    stand_in.assert_safe();
}

#[tokio::test(start_paused = true)]
async fn relays_open_cold_where_the_source_answers() {
    let plan = plan();
    let stand_in = StandIn::new(&plan.wiring).slow(Part::Source, 0, Duration::from_millis(40));
    stand_in.close([Relay(1036)]);
    let rig = stand_in.rig();
    let watched = async {
        while !stand_in.closed().is_empty() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        stand_in.is_off()
    };
    let (made, off_first) = tokio::join!(safe_off(&rig, &plan.wiring), watched);
    made.unwrap();
    assert!(off_first);
}

#[tokio::test(start_paused = true)]
async fn relay_in_wrong_state_fails_the_frame_and_is_named() {
    let plan = plan();
    let counted = StandIn::new(&plan.wiring);
    let never = Stop::never();
    acquire(&counted.rig(), &plan, METER, SystemClock::new(), &never)
        .await
        .unwrap();
    // the last two calls read the relays back and open them; the call before them switches the source off
    let before = counted.calls() - 3;
    for (change, reported) in [(1040, "read open: 1040"), (1037, "read closed: 1037")] {
        let stand_in = StandIn::new(&plan.wiring);
        let hand = stand_in.clone();
        let stand_in = stand_in.calling(before, move || match change {
            1040 => hand.open(Relay(1040)),
            other => hand.close([Relay(other)]),
        });
        let refused = acquire(&stand_in.rig(), &plan, METER, SystemClock::new(), &never)
            .await
            .unwrap_err();
        let Some(cause @ RigError::RelayMismatch { .. }) = refused.cause() else {
            panic!("{refused:?}");
        };
        let cause = cause.to_string();
        assert!(
            cause.contains(reported) && cause.contains("electrodes"),
            "{cause}"
        );
        assert!(refused.off_after().unwrap() <= ALLOWED, "{refused:?}");
        stand_in.assert_safe();
    }
}

#[tokio::test(start_paused = true)]
async fn whatever_fails_the_source_is_off_in_time() {
    let plan = plan();
    let each = Duration::from_millis(20);
    let mut failed = 0;
    for call in 0..40 {
        let stand_in = StandIn::new(&plan.wiring)
            .slow(Part::Source, 0, each)
            .failing(call, Fault::Lost(Part::SwitchAndMeter));
        let never = Stop::never();
        let ended = acquire(&stand_in.rig(), &plan, METER, SystemClock::new(), &never).await;
        let Err(ended) = ended else { break };
        assert!(ended.off_after().unwrap() <= ALLOWED, "{call}: {ended:?}");
        assert!(stand_in.is_off());
        failed += 1;
    }
    assert!(failed > 20, "only {failed} calls of a frame failed");
}

#[tokio::test]
async fn relays_left_out_of_a_half_frame_are_checked_and_opened() {
    let half = survey::half(survey::sheffield(8)).collect();
    let wiring = wirings::board(8).joining(&Protocol::new(8, half).unwrap());
    // the last electrode is not driven from its plus pole, the first not measured from it
    let left_out = [Relay(108), Relay(301)];
    let pairs = wiring.inject.iter().chain(&wiring.measure);
    let mut in_a_frame = pairs.flat_map(|(_, relays)| relays);
    assert!(in_a_frame.all(|relay| !left_out.contains(relay)));
    let stand_in = StandIn::new(&wiring);
    stand_in.close(left_out);
    let rig = stand_in.rig();
    let refused = check_at_start(&rig, &wiring).await.unwrap_err();
    assert!(matches!(refused, StartError::Closed(_)), "{refused:?}");
    let text = refused.to_string();
    assert!(text.contains("108 (electrodes 1 and 8)"), "{text}");
    safe_off(&rig, &wiring).await.unwrap();
    stand_in.assert_safe();
}
