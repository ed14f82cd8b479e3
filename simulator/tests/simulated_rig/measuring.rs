//! Each session setting reduces the error that it is meant for, tested through the drivers.

use std::time::Duration;

use crate::drivers::{Frozen, METER, board_rig, mainframe_rig, simulated};
use phantom::{Scene, ThermalEmfSettings, VoltmeterNoiseSettings};
use rig::{MeterSettings, Stop, acquire};
use survey::{Amps, Dipole, Electrode, Frame, Injection, Plan, Protocol, Volts, Wiring};

const CURRENT: Amps = Amps(1e-3);

fn plan(protocol: &Protocol, wiring: &Wiring, reversal: bool) -> Plan {
    let injection = Injection {
        current: CURRENT,
        compliance: Volts(4.0),
        settle: Duration::from_millis(2),
        reversal,
    };
    Plan::injecting(protocol, wiring, injection).unwrap()
}

fn whole() -> Protocol {
    Protocol::sheffield(26).unwrap()
}

fn pairs() -> Wiring {
    keysight_34980a::pairs_34924a(1, 26).unwrap()
}

/// A frame of the pair wiring on a sheet with this scene.
async fn frame(scene: &Scene, plan: &Plan, meter: MeterSettings) -> Frame {
    let simulated = simulated("pairs-34924a", scene.clone());
    let rig = mainframe_rig(&simulated).await;
    acquire(&rig, plan, meter, Frozen, &Stop::never())
        .await
        .unwrap()
}

fn volts(frame: &Frame) -> Vec<f64> {
    let readings = frame.readings.iter();
    readings.map(|one| one.volts().unwrap().0).collect()
}

/// Rms of the difference, uV.
fn apart_uv(one: &[f64], other: &[f64]) -> f64 {
    assert_eq!(one.len(), other.len());
    let squares: f64 = one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum();
    1e6 * (squares / one.len() as f64).sqrt()
}

#[tokio::test]
async fn reversal_and_zero_frame_cancel_thermal_voltages() {
    let mut warm = Scene::quiet();
    warm.effects.thermal_emf = Some(ThermalEmfSettings {
        uv: 10.0,
        tau_s: 900.0,
    });
    let one_way = plan(&whole(), &pairs(), false);
    let both_ways = plan(&whole(), &pairs(), true);
    let truth = volts(&frame(&Scene::quiet(), &one_way, METER).await);
    let plain = apart_uv(&volts(&frame(&warm, &one_way, METER).await), &truth);
    let turned = apart_uv(&volts(&frame(&warm, &both_ways, METER).await), &truth);

    let simulated = simulated("pairs-34924a", warm);
    let rig = mainframe_rig(&simulated).await;
    let at_zero = one_way.at_zero_current();
    let take = |plan: Plan| {
        let rig = rig.clone();
        async move {
            acquire(&rig, &plan, METER, Frozen, &Stop::never())
                .await
                .unwrap()
        }
    };
    let zero = take(at_zero).await;
    let mut zeroed = take(one_way).await;
    zeroed.subtract(&zero).unwrap();
    let zeroed = apart_uv(&volts(&zeroed), &truth);
    println!("10 uV of thermal voltages: {plain:.2} uV, reversed {turned:.2}, zeroed {zeroed:.2}");
    // 26 channels with 10 uV each; they wander by 0.35 uV between the two directions, by 2 uV between frames
    assert!((6.0..16.0).contains(&plain), "{plain}");
    assert!(turned < 0.4, "{turned}");
    assert!(zeroed < 4.0, "{zeroed}");
}

#[tokio::test]
async fn averages_take_noise_down_by_the_root_of_their_number() {
    let mut noisy = Scene::quiet();
    noisy.effects.voltmeter_noise = Some(VoltmeterNoiseSettings { uv: Some(20.0) });
    let plan = plan(&whole(), &pairs(), false);
    let truth = volts(&frame(&Scene::quiet(), &plan, METER).await);
    for averages in [1, 4, 16] {
        let meter = MeterSettings { averages, ..METER };
        let noise = apart_uv(&volts(&frame(&noisy, &plan, meter).await), &truth);
        let expected = 20.0 / f64::from(averages).sqrt();
        println!("{averages} readings averaged: {noise:.2} uV of {expected:.2}");
        // the rms of 598 draws is known to 3 %
        assert!((noise / expected - 1.0).abs() < 0.1, "{noise} uV");
    }
}

#[tokio::test]
async fn half_frame_by_reciprocity_equals_whole_within_noise() {
    let half = Protocol::new(26, survey::half(survey::sheffield(26)).collect()).unwrap();
    assert_eq!(half.len(), 299);
    let (requested_half, requested_whole) = (
        plan(&half, &pairs(), false),
        plan(&whole(), &pairs(), false),
    );
    for uv in [0.0, 5.0] {
        let mut scene = Scene::quiet();
        scene.effects.voltmeter_noise = Some(VoltmeterNoiseSettings { uv: Some(uv) });
        let measured = frame(&scene, &requested_half, METER).await;
        let mut completed = measured.clone();
        completed.readings = whole().answered_by(&half, &measured.readings).unwrap();
        scene.seed += 1;
        let reference = frame(&scene, &requested_whole, METER).await;
        let apart = apart_uv(&volts(&completed), &volts(&reference));
        println!("half against whole at {uv} uV: {apart:.4} uV");
        let expected = uv * 2.0_f64.sqrt();
        assert!((apart - expected).abs() <= 0.1 * expected + 1e-3, "{apart}");
    }
}

#[tokio::test]
async fn skip_pattern_through_the_board_reads_forward_solution() {
    for skip in [1, 3, 6] {
        let protocol = Protocol::new(26, survey::skip(26, skip).collect()).unwrap();
        let wiring = gpio_mux::wiring(26).unwrap().joining(&protocol);
        let simulated = simulated("gpio-board", Scene::quiet());
        let rig = board_rig(&simulated).await;
        let plan = plan(&protocol, &wiring, false);
        // pairs that cross the driven one have more than a volt
        let meter = MeterSettings {
            range: Volts(10.0),
            ..METER
        };
        let frame = acquire(&rig, &plan, meter, Frozen, &Stop::never())
            .await
            .unwrap();
        let bare: Vec<f64> = simulated.with_phantom(|phantom| {
            let z = phantom.transfer_impedance(Duration::ZERO).unwrap();
            let apart =
                |from: Dipole, at: Electrode| z[(at.0, from.plus.0)] - z[(at.0, from.minus.0)];
            let measurements = protocol.measurements().iter();
            measurements
                .map(|requested| {
                    let (drive, sense) = (requested.drive, requested.sense);
                    CURRENT.0 * (apart(drive, sense.plus) - apart(drive, sense.minus))
                })
                .collect()
        });
        let apart = apart_uv(&volts(&frame), &bare);
        println!("skip {skip}: {} readings, {apart:.1e} uV apart", bare.len());
        // half a unit of the ninth digit of a volt
        assert!(bare.len() > 500 && apart < 5e-3, "{apart}");
    }
}
