//! Waves: the current at an instant.

use survey::{Amps, Ohms};

use super::talk::Talk;

const STARTED: u16 = 1 << 4;
const STOPPED: u16 = 1 << 7;
const IDLE: u16 = 1 << 10;

fn wave(settings: &str) -> Talk {
    let mut talk = Talk::new(100.0);
    talk.hold(&[
        ("SOUR:WAVE:FREQ 1;AMPL 2e-3;OFFS 1e-3", "-"),
        (settings, "-"),
        ("SOUR:WAVE:ARM;:SYST:ERR?", "0,\"No error\""),
    ]);
    talk
}

fn flows(talk: &mut Talk, expected: &[(f64, f64)]) {
    for (seconds, amps) in expected {
        talk.at(*seconds);
        let flowing = talk.load.flowing.0;
        assert!((flowing - amps).abs() < 1e-12, "{flowing} at {seconds} s");
    }
}

#[test]
fn section_4_a_sine_flows_while_it_lasts() {
    let mut talk = wave("SOUR:WAVE:DUR:CYCL 10");
    assert_eq!(talk.operation(), IDLE);
    talk.at(5.0).hold(&[("SOUR:WAVE:INIT;:OUTP?", "1")]);
    assert_eq!(talk.operation(), STARTED);
    flows(
        &mut talk,
        &[
            (5.0, 1e-3),
            (5.25, 3e-3),
            (5.5, 1e-3),
            (5.75, -1e-3),
            (14.25, 3e-3),
        ],
    );
    talk.at(15.0);
    assert_eq!(talk.operation(), STOPPED | IDLE);
    assert_eq!(talk.load.flowing, Amps(0.0));
    assert_eq!(talk.source.range(), Amps(20e-3));
    // A wave of finite duration switches the output off at its end.
    talk.hold(&[("OUTP?;:SYST:ERR?", "0;0,\"No error\"")]);
    // Once more, to its own end.
    talk.hold(&[("SOUR:WAVE:INIT", "-")]);
    assert_eq!(talk.operation(), STARTED);
    talk.hold(&[("SOUR:WAVE:ABOR;:OUTP?", "0")]);
    assert_eq!(talk.operation(), STOPPED | IDLE);
}

#[test]
fn section_4_squares_and_ramps_keep_their_duty_cycle() {
    let mut talk = wave("SOUR:WAVE:FUNC SQU;DCYC 25");
    talk.hold(&[("SOUR:WAVE:INIT", "-")]);
    flows(
        &mut talk,
        &[
            (0.1, 3e-3),
            (0.24, 3e-3),
            (0.26, -1e-3),
            (0.99, -1e-3),
            (1.1, 3e-3),
        ],
    );
    let mut talk = wave("SOUR:WAVE:FUNC RAMP;DCYC 50");
    talk.hold(&[("SOUR:WAVE:INIT", "-")]);
    flows(
        &mut talk,
        &[(0.0, -1e-3), (0.25, 1e-3), (0.5, 3e-3), (0.75, 1e-3)],
    );
    for duty in ["0", "100"] {
        let mut talk = wave(&format!("SOUR:WAVE:FUNC RAMP;DCYC {duty}"));
        talk.hold(&[("SOUR:WAVE:INIT", "-")]);
        flows(&mut talk, &[(0.5, 1e-3)]);
    }
}

#[test]
fn section_4_an_arbitrary_wave_is_sent_stored_and_generated() {
    let mut talk = wave("SOUR:WAVE:ARB:DATA -1,0,0.5,1;COPY 2;DATA 0;:SOUR:WAVE:FUNC ARB2");
    talk.hold(&[("SOUR:WAVE:INIT", "-")]);
    flows(
        &mut talk,
        &[
            (0.1, -1e-3),
            (0.3, 1e-3),
            (0.6, 2e-3),
            (0.9, 3e-3),
            (1.1, -1e-3),
        ],
    );
    // A wave from an empty memory is not armed; *RST does not clear the memories.
    talk.hold(&[
        (
            "SOUR:WAVE:ABOR;FUNC ARB1;ARM;:SYST:ERR?",
            "-221,\"Settings conflict\"",
        ),
        ("*RST;:SOUR:WAVE:FUNC ARB2;ARM;:SYST:ERR?", "0,\"No error\""),
    ]);
}

#[test]
fn section_4_a_frequency_changes_without_a_jump() {
    let mut talk = wave("SOUR:WAVE:FUNC RAMP");
    talk.hold(&[("SOUR:WAVE:INIT", "-")]);
    talk.at(0.25).hold(&[("SOUR:WAVE:FREQ 0.5", "-")]);
    flows(&mut talk, &[(0.25, 1e-3), (0.5, 2e-3), (0.75, 3e-3)]);
    talk.hold(&[
        ("SOUR:WAVE:AMPL 1e-3;:SYST:ERR?", "0,\"No error\""),
        (
            "SOUR:WAVE:FUNC SIN;:SYST:ERR?",
            "-221,\"Settings conflict\"",
        ),
        (
            "SOUR:WAVE:AMPL 0.1;:SYST:ERR?",
            "-221,\"Settings conflict\"",
        ),
        ("SOUR:WAVE:INIT;:SYST:ERR?", "-213,\"Init ignored\""),
        ("SOUR:WAVE:AMPL?", "1.000000E-03"),
    ]);
}

#[test]
fn section_4_a_wave_beyond_its_range_is_not_armed() {
    let conflict = "-221,\"Settings conflict\"";
    Talk::new(100.0).hold(&[
        ("SOUR:WAVE:AMPL 0.1;OFFS 0.01;ARM;:SYST:ERR?", conflict),
        (
            "SOUR:CURR:RANG 2e-3;:SOUR:WAVE:RANG FIX;OFFS 0;AMPL 5e-3;ARM;:SYST:ERR?",
            conflict,
        ),
        ("SOUR:WAVE:AMPL 2e-3;ARM;:SYST:ERR?", "0,\"No error\""),
        ("SOUR:WAVE:ABOR;INIT;:SYST:ERR?", conflict),
    ]);
}

#[test]
fn section_5_a_wave_is_held_back_at_its_peaks() {
    let mut talk = wave("SOUR:CURR:COMP 5;:SOUR:WAVE:OFFS 0");
    talk.load.resistance = Ohms(4000.0);
    talk.hold(&[("SOUR:WAVE:INIT;:STAT:MEAS:COND?", "0")]);
    flows(&mut talk, &[(0.25, 1.25e-3)]);
    talk.hold(&[("STAT:MEAS:COND?", "8")]);
    flows(&mut talk, &[(0.5, 0.0)]);
    talk.hold(&[("STAT:MEAS?;:STAT:MEAS:COND?", "8;0")]);
    // The wave reached its peak between two evaluations.
    talk.at(2.0).hold(&[("STAT:MEAS?;:STAT:MEAS:COND?", "8;0")]);
}

#[test]
fn section_4_a_wave_starts_with_the_settings_of_its_start() {
    let mut talk = wave("SOUR:WAVE:FUNC SQU");
    talk.hold(&[
        (
            "SOUR:WAVE:AMPL 50e-3;OFFS 0;FREQ 10;DUR:TIME 1;:SOUR:WAVE:INIT",
            "-",
        ),
        ("SYST:ERR?", "0,\"No error\""),
    ]);
    flows(&mut talk, &[(0.01, 50e-3), (0.06, -50e-3), (1.01, 0.0)]);
    talk.hold(&[(
        "SOUR:WAVE:FUNC ARB4;INIT;:SYST:ERR?",
        "-221,\"Settings conflict\"",
    )]);
}
