use std::time::Duration;

use chrono::DateTime;

use super::*;
use crate::{Amps, Extra, Measurement, Precautions, Settings, Volts};

const RING: usize = 8;

/// Readings of a passive sheet, in which the potential between two electrodes is a Green's function of their distance.
fn volts(measurement: Measurement) -> f64 {
    let green = |a: Electrode, b: Electrode| match a.0.abs_diff(b.0) {
        0 => 2.0,
        apart => -(2.0 * (std::f64::consts::PI * apart as f64 / RING as f64).sin()).ln(),
    };
    let at =
        |sensed| green(sensed, measurement.drive.plus) - green(sensed, measurement.drive.minus);
    at(measurement.sense.plus) - at(measurement.sense.minus)
}

fn answered(measurement: Measurement) -> Reading {
    Reading::Ok(Volts(volts(measurement)))
}

/// A sound frame with the whole ring read at each injection, 3 uV of noise in readings of 2.8 V at most.
fn sound() -> (Checks, Frame) {
    let protocol = Protocol::sheffield(RING).unwrap();
    let whole = protocol.drives().into_iter().flat_map(|drive| {
        (0..RING).map(move |plus| Measurement {
            drive,
            sense: Dipole::adjacent(plus, RING),
        })
    });
    let frame = Frame {
        sequence: 1,
        readings: protocol
            .measurements()
            .iter()
            .copied()
            .map(answered)
            .collect(),
        extra: whole
            .filter(|measurement| measurement.drive.touches(measurement.sense))
            .map(|measurement| Extra {
                measurement,
                reading: answered(measurement),
            })
            .collect(),
        monotonic: Duration::ZERO,
        wall: DateTime::UNIX_EPOCH,
        duration: Duration::from_secs(1),
        settings: Settings {
            protocol_hash: protocol.hash(),
            current: Amps(1e-3),
            range: Volts(1.0),
            nplc: 1.0,
            settle: Duration::ZERO,
            wiring: "w".into(),
            precautions: Precautions {
                resolution: 3e-6,
                ..Precautions::default()
            },
        },
        compliance: Vec::new(),
        simulated: true,
    };
    (Checks::new(&protocol).against(&frame.readings), frame)
}

fn scaled(reading: &mut Reading, factor: f64) {
    *reading = Reading::Ok(Volts(factor * reading.volts().unwrap().0));
}

#[test]
fn a_sound_frame_raises_no_flag_and_what_a_load_does_neither() {
    let (checks, mut frame) = sound();
    let quality = checks.of(&frame);
    assert_eq!(quality.words(), "");
    let missing = [quality.overloads, quality.not_measured];
    assert_eq!((missing, quality.compliance.len()), ([0; 2], 0));
    assert!(quality.reciprocity.unwrap() < 1e-12 && quality.loop_sum.unwrap() < 1e-12);
    for reading in &mut frame.readings {
        scaled(reading, 1.2);
    }
    for extra in &mut frame.extra {
        scaled(&mut extra.reading, 1.2);
    }
    assert_eq!(checks.of(&frame).flags, []);
}

#[test]
fn one_reading_off_breaks_reciprocity_and_its_loop() {
    let (checks, mut frame) = sound();
    scaled(&mut frame.readings[0], 1.01);
    let quality = checks.of(&frame);
    assert_eq!(quality.words(), "reciprocity,loop_sum");
    let off = 0.01 * volts(checks.protocol.measurements()[0]).abs() / largest(&frame.readings);
    assert!(
        (quality.reciprocity.unwrap() - off).abs() < 1e-9,
        "{quality:?}"
    );
    assert!(
        (quality.loop_sum.unwrap() - off).abs() < 1e-9,
        "{quality:?}"
    );
}

#[test]
fn noise_that_the_settings_explain_is_no_fault() {
    let (checks, mut frame) = sound();
    scaled(&mut frame.readings[0], 1.01);
    // 1e-4 of 100 V: 10 mV a reading
    frame.settings.precautions.resolution = 1e-4;
    frame.settings.range = Volts(100.0);
    assert_eq!(checks.of(&frame).flags, []);
}

#[test]
fn a_contact_read_wrong_breaks_only_the_loop() {
    let (checks, mut frame) = sound();
    scaled(&mut frame.extra[0].reading, 1.01);
    assert_eq!(checks.of(&frame).flags, [QualityFlag::LoopSum]);
    frame.extra.clear();
    assert_eq!(checks.of(&frame).loop_sum, None);
}

#[test]
fn reading_above_the_drive_or_of_wrong_sign_is_implausible() {
    let (checks, mut frame) = sound();
    let measurement = checks.protocol.measurements()[0];
    let twin = checks.twins[0].unwrap();
    for at in [0, twin] {
        scaled(&mut frame.readings[at], -1.0);
    }
    let quality = checks.of(&frame);
    assert_eq!(quality.implausible, 2, "{measurement:?}: {quality:?}");
    assert!(quality.flags.contains(&QualityFlag::Plausibility));
    for at in [0, twin] {
        scaled(&mut frame.readings[at], -40.0);
    }
    assert_eq!(checks.of(&frame).implausible, 2);
    // without a baseline and the driven pair's voltage, no reading can be found implausible
    frame.extra.clear();
    assert_eq!(Checks::new(&checks.protocol).of(&frame).implausible, 0);
}
