//! Solutions and readings of the phantom.

use std::sync::Arc;
use std::time::Duration;

use eit::Forward;
use phantom::{Load, Phantom, ReadingContext, Scene, paper};
use survey::{Amps, Ohms, Protocol, Volts};

fn coarse(text: &str) -> Phantom {
    let text = format!("[mesh]\nfineness = 0.6\n{text}");
    Phantom::new(Scene::parse("test.toml", &text).unwrap()).unwrap()
}

#[test]
fn a_scene_that_asks_for_nothing_changes_no_bit() {
    let mut phantom = coarse("");
    let mesh = Arc::clone(phantom.mesh());
    let contacts = phantom.scene().sheet.contact_ohm_m();
    let forward = Forward::new(mesh.clone(), &contacts).unwrap();
    let sigma = vec![phantom.scene().sheet.conductance(); mesh.triangles().len()];
    let bare = forward.transfer_impedance(&sigma).unwrap();
    let shown = phantom
        .transfer_impedance(Duration::from_secs(5))
        .unwrap()
        .clone();
    assert!(
        bare.iter()
            .zip(shown.iter())
            .all(|(a, b)| a.to_bits() == b.to_bits())
    );
    let context = ReadingContext {
        at: Duration::ZERO,
        integration: Duration::from_millis(20),
        range: Volts(1.0),
        nplc: 1.0,
        resolution: 3e-6,
        relay: None,
        flowing: Amps(1e-3),
        source_range: Amps(2e-3),
        since_change: Duration::from_millis(21),
        source_resistance: Ohms(0.0),
        load_resistance: Ohms(0.0),
    };
    for value in bare.iter() {
        let read = phantom.reading(Volts(*value), context);
        assert_eq!(read.0.to_bits(), value.to_bits());
    }
}

#[test]
fn the_readings_of_the_matrix_are_those_of_the_forward_model() {
    let mut phantom = coarse("");
    phantom.press(paper::s1([84.7, 91.3])).unwrap();
    let sigma = phantom.conductance(Duration::ZERO);
    let forward = Forward::new(
        phantom.mesh().clone(),
        &phantom.scene().sheet.contact_ohm_m(),
    )
    .unwrap();
    let protocol = Protocol::sheffield(26).unwrap();
    let readings = forward.readings(&sigma, &protocol).unwrap();
    let z = phantom.transfer_impedance(Duration::ZERO).unwrap();
    for (measurement, reading) in protocol.measurements().iter().zip(readings.iter()) {
        let (d, s) = (measurement.drive, measurement.sense);
        let from_z = z[(s.plus.0, d.plus.0)] - z[(s.plus.0, d.minus.0)] - z[(s.minus.0, d.plus.0)]
            + z[(s.minus.0, d.minus.0)];
        assert!((from_z - reading).abs() < 1e-11 * readings.amax());
    }
}

#[test]
fn the_time_line_presses_and_releases() {
    let mut phantom = coarse(
        "[[load]]\nshape = \"disc\"\ndiameter_mm = 10\nx_mm = 107\ny_mm = 115\nloss_percent = 50\nfrom_s = 10\nto_s = 20\n",
    );
    let mut at = |seconds| {
        phantom
            .transfer_impedance(Duration::from_secs(seconds))
            .unwrap()
            .clone()
    };
    let before = at(0);
    let pressed = at(10);
    assert_ne!(before, pressed);
    assert_eq!(at(19), pressed);
    assert_eq!(at(20), before);
    assert_eq!(phantom.loads(Duration::from_secs(15)).count(), 1);
    assert_eq!(phantom.loads(Duration::from_secs(25)).count(), 0);
}

#[test]
fn a_load_has_the_stated_loss() {
    let mut phantom = coarse("");
    let sheet = phantom.scene().sheet.conductance();
    let load = paper::s4([107.0, 115.0]);
    phantom.press(load.clone()).unwrap();
    let mesh = phantom.mesh().clone();
    let lost: f64 = phantom
        .conductance(Duration::ZERO)
        .iter()
        .enumerate()
        .map(|(t, sigma)| (1.0 - sigma / sheet) * mesh.area(t))
        .sum();
    assert!((lost / (load.loss * load.shape.area()) - 1.0).abs() < 1e-9);
    // the signal of a press is similar on any mesh: 19 to 97 uV rms at 1 mA; the largest reading is 309 mV
    phantom.release();
    let protocol = Protocol::sheffield(26).unwrap();
    let forward = Forward::new(mesh, &phantom.scene().sheet.contact_ohm_m()).unwrap();
    let untouched = forward
        .readings(&phantom.conductance(Duration::ZERO), &protocol)
        .unwrap();
    println!("largest reading {:.1} mV at 1 mA", untouched.amax());
    for centre in paper::test1_positions() {
        phantom.press(paper::s1(centre)).unwrap();
        let pressed = forward
            .readings(&phantom.conductance(Duration::ZERO), &protocol)
            .unwrap();
        let rms = (&pressed - &untouched).norm() / (protocol.len() as f64).sqrt() * 1e3;
        println!("S1 at {centre:?}: {rms:.1} uV rms at 1 mA");
        assert!(rms > 10.0 && rms < 200.0);
        phantom.release();
    }
}

#[test]
fn total_loss_is_solved_and_load_off_the_sheet_is_refused() {
    let mut phantom = coarse("");
    phantom
        .press(Load::disc([107.0, 115.0], 60.0, 1.0))
        .unwrap();
    let z = phantom.transfer_impedance(Duration::ZERO).unwrap();
    assert!(z.iter().all(|value| value.is_finite()));
    let refusal = phantom
        .press(Load::disc([500.0, 0.0], 10.0, 0.5))
        .unwrap_err();
    let cause = std::error::Error::source(&refusal).unwrap().to_string();
    assert!(cause.contains("covers no part of the sheet"), "{cause}");
}

#[test]
fn an_effect_on_contacts_keeps_a_contact_of_the_scene() {
    let first = |effect: &str| {
        let text =
            format!("[mesh]\nfineness = 0.3\n[[contact]]\nelectrode = 3\nohm = 1e6\n{effect}");
        let mut phantom = Phantom::new(Scene::parse("contact.toml", &text).unwrap()).unwrap();
        phantom.transfer_impedance(Duration::ZERO).unwrap()[(2, 2)]
    };
    let (alone, beside) = (first(""), first("[effects.contact-spread]\nstd = 0.0\n"));
    assert!(alone > 1e5);
    assert_eq!(alone.to_bits(), beside.to_bits());
}
