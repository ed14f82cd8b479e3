//! Sweeps in real time.

use std::time::Duration;

use survey::{Amps, Ohms};

use super::talk::Talk;

const DONE: u16 = 1 << 1;
const ABORTED: u16 = 1 << 2;
const SWEEPING: u16 = 1 << 3;
const IDLE: u16 = 1 << 10;

/// A sweep of 0, 1, 2 and 3 mA, half a second each, armed.
fn staircase(ohms: f64) -> Talk {
    let mut talk = Talk::new(ohms);
    talk.hold(&[
        ("SOUR:SWE:SPAC LIN", "-"),
        ("SOUR:CURR:STAR 0;STOP 3e-3;STEP 1e-3", "-"),
        ("SOUR:DEL 0.5;:SOUR:SWE:RANG BEST;COUN 1;CAB OFF", "-"),
        ("SOUR:SWE:ARM;ARM?;:OUTP?", "1;1"),
    ]);
    talk
}

#[test]
fn section_4_a_linear_sweep_takes_its_time() {
    let mut talk = staircase(100.0);
    assert_eq!(talk.operation(), IDLE);
    talk.at(10.0).hold(&[("INIT", "-")]);
    assert_eq!(talk.operation(), SWEEPING);
    for (seconds, level) in [
        (10.0, 0.0),
        (10.49, 0.0),
        (10.5, 1e-3),
        (11.4, 2e-3),
        (11.9, 3e-3),
    ] {
        talk.at(seconds);
        assert_eq!(talk.load.flowing, Amps(level), "at {seconds} s");
        assert_eq!(talk.operation(), SWEEPING, "at {seconds} s");
    }
    // A finished sweep stays on its last point.
    talk.at(12.0);
    assert_eq!(talk.operation(), DONE | IDLE);
    assert_eq!(talk.load.flowing, Amps(3e-3));
    talk.hold(&[
        ("SOUR:CURR?;CURR:RANG?", "3.000000E-03;2.000000E-02"),
        ("STAT:OPER?", "1034"),
        ("STAT:OPER?", "0"),
        ("SOUR:CURR 1e-3;:SYST:ERR?", "0,\"No error\""),
    ]);
}

#[test]
fn section_4_a_list_sweep_has_its_own_delays_and_limits() {
    let mut talk = Talk::new(1000.0);
    talk.hold(&[
        ("SOUR:SWE:SPAC LIST;RANG AUTO;COUN 2", "-"),
        (
            "SOUR:LIST:CURR 1e-3,-2e-6,5e-3;DEL 0.1,0.2,0.3;COMP 10,10,2",
            "-",
        ),
        ("SOUR:SWE:ARM;:INIT:IMM", "-"),
    ]);
    for (seconds, flowing, range) in [
        (0.05, 1e-3, 2e-3),
        (0.15, -2e-6, 2e-6),
        // The voltage limit of this point is 2 V.
        (0.45, 2e-3, 20e-3),
        (0.65, 1e-3, 2e-3),
        (1.1, 2e-3, 20e-3),
    ] {
        talk.at(seconds);
        assert_eq!(talk.load.flowing, Amps(flowing), "at {seconds} s");
        assert_eq!(talk.source.range(), Amps(range), "at {seconds} s");
    }
    talk.hold(&[("STAT:MEAS:COND?;:SYST:ERR?", "8;0,\"No error\"")]);
    talk.at(1.2);
    assert_eq!(talk.operation(), DONE | IDLE);
}

#[test]
fn section_4_a_logarithmic_sweep_multiplies() {
    let mut talk = Talk::new(100.0);
    talk.hold(&[
        (
            "SOUR:SWE:SPAC LOG;POIN 4;:SOUR:CURR:STAR 1e-6;STOP 1e-3;:SOUR:DEL 1",
            "-",
        ),
        ("SOUR:SWE:ARM;:INIT", "-"),
    ]);
    for (seconds, level) in [(0.5, 1e-6), (1.5, 1e-5), (2.5, 1e-4), (3.5, 1e-3)] {
        talk.at(seconds);
        let flowing = talk.load.flowing.0;
        assert!(
            (flowing / level - 1.0).abs() < 1e-12,
            "{flowing} at {seconds} s"
        );
    }
    // A logarithmic sweep that would cross 0.
    talk.at(5.0).hold(&[
        ("SOUR:CURR:STAR -1e-3;:SOUR:SWE:ARM", "-"),
        ("SYST:ERR?", "-221,\"Settings conflict\""),
    ]);
}

#[test]
fn section_4_compliance_ends_a_sweep_if_configured() {
    let mut talk = staircase(1000.0);
    talk.hold(&[(
        "SOUR:CURR:COMP 1.5;:SOUR:SWE:CAB ON;:SOUR:SWE:ARM;:INIT",
        "-",
    )]);
    talk.at(0.9);
    assert_eq!(talk.operation(), SWEEPING);
    // 2 mA need 2 V.
    talk.at(1.0);
    assert_eq!(talk.operation(), ABORTED | IDLE);
    assert_eq!(talk.load.flowing, Amps(0.0));
    talk.hold(&[("OUTP?;:STAT:MEAS?;:SYST:ERR?", "0;8;0,\"No error\"")]);
    // The same sweep without evaluations in between.
    let mut unwatched = staircase(1000.0);
    unwatched.hold(&[(
        "SOUR:CURR:COMP 1.5;:SOUR:SWE:CAB ON;:SOUR:SWE:ARM;:INIT",
        "-",
    )]);
    unwatched.at(1e6);
    assert_eq!(unwatched.operation(), ABORTED | IDLE);
}

#[test]
fn section_4_a_load_that_opens_during_a_point_ends_the_sweep() {
    let mut talk = staircase(100.0);
    talk.hold(&[("SOUR:SWE:CAB ON;:SOUR:SWE:ARM;:INIT", "-")]);
    talk.at(0.6);
    assert_eq!(talk.operation(), SWEEPING);
    talk.load.resistance = Ohms(f64::INFINITY);
    talk.at(0.7);
    assert_eq!(talk.operation(), ABORTED | IDLE);
}

#[test]
fn section_4_compliance_in_passing_is_an_event() {
    let mut talk = staircase(1000.0);
    talk.hold(&[(
        "SOUR:LIST:CURR 3e-3,1e-3;DEL 0.5;COMP 2;:SOUR:SWE:SPAC LIST;ARM;:INIT",
        "-",
    )]);
    talk.say("STAT:MEAS?");
    talk.at(60.0)
        .hold(&[("STAT:MEAS:COND?;:STAT:MEAS?", "0;0")]);
    talk.hold(&[("SOUR:SWE:ARM;:INIT", "-")]);
    talk.at(70.0)
        .hold(&[("STAT:MEAS:COND?;:STAT:MEAS?", "0;8")]);
}

#[test]
fn section_4_abort_stops_a_sweep_and_leaves_others_alone() {
    let mut talk = staircase(100.0);
    talk.hold(&[("INIT", "-")]).at(0.6);
    talk.hold(&[("SOUR:SWE:ABOR;:OUTP?;:SOUR:SWE:ARM?", "0;0")]);
    assert_eq!(talk.operation(), ABORTED | IDLE);
    assert_eq!(talk.load.flowing, Amps(0.0));
    talk.hold(&[
        ("SOUR:CURR 2e-3;:OUTP 1;:SOUR:SWE:ABOR;:OUTP?", "1"),
        ("SYST:ERR?", "0,\"No error\""),
    ]);
}

#[test]
fn section_4_an_endless_sweep_repeats_itself() {
    let mut talk = staircase(100.0);
    talk.hold(&[("SOUR:SWE:COUN INF;ARM;:INIT", "-")]);
    // A year and three quarters of a pass.
    let year = 365.0 * 86_400.0;
    talk.at(year + 1.25);
    assert_eq!(talk.load.flowing, Amps(2e-3));
    assert_eq!(talk.operation(), SWEEPING);
    // The reply is sent when the sweep has been ended, not before.
    talk.hold(&[("*OPC?", "-"), ("OUTP?", "1"), ("OUTP 0", "1")]);
    assert_eq!(talk.operation(), ABORTED | IDLE);
    talk.hold(&[("*OPC?", "1"), ("SOUR:SWE:ARM;:INIT;*OPC?", "-")]);
    talk.hold(&[("*RST", "-"), ("SYST:ERR?", "0,\"No error\"")]);
}

#[test]
fn section_5_opc_behind_a_trigger_is_reported_on_completion() {
    let mut talk = staircase(100.0);
    talk.hold(&[("ARM:SOUR BUS;:INIT;*OPC?", "-"), ("OUTP?", "1")]);
    let now = talk.now();
    let reply = talk.source.receive("*TRG", now, &mut talk.load);
    assert_eq!(reply.text.as_deref(), Some("1"));
    assert_eq!(
        reply.busy,
        Duration::from_millis(5) + Duration::from_secs(2)
    );
    talk.at(2.1);
    talk.hold(&[("SOUR:CURR?;:SYST:ERR?", "3.000000E-03;0,\"No error\"")]);
}

#[test]
fn section_4_a_running_sweep_holds_its_settings() {
    let conflict = "-221,\"Settings conflict\"";
    let mut talk = staircase(100.0);
    talk.hold(&[
        ("INIT", "-"),
        ("INIT;:SYST:ERR?", "-213,\"Init ignored\""),
        ("SOUR:CURR 1e-3;:SYST:ERR?", conflict),
        ("SOUR:DEL 1;:SYST:ERR?", conflict),
        ("SOUR:SWE:ARM;:SYST:ERR?", conflict),
        ("SOUR:WAVE:ARM;:SYST:ERR?", conflict),
        ("*RST;:OUTP?;:SOUR:SWE:ARM?", "0;0"),
        // Nothing is armed.
        ("INIT;:SYST:ERR?", conflict),
    ]);
}

#[test]
fn section_4_what_makes_no_sweep_is_not_armed() {
    let conflict = "-221,\"Settings conflict\"";
    Talk::new(100.0).hold(&[
        (
            "SOUR:CURR:STAR 0;STOP 0.1;STEP 1e-9;:SOUR:SWE:ARM;ARM?",
            "0",
        ),
        ("SYST:ERR?", conflict),
        (
            "SOUR:LIST:CURR 1e-3,2e-3,3e-3;DEL 0.1,0.2;:SOUR:SWE:SPAC LIST;ARM;ARM?",
            "0",
        ),
        ("SYST:ERR?", conflict),
        (
            "SOUR:LIST:DEL 0.1;:SOUR:CURR:RANG 2e-3;:SOUR:SWE:RANG FIX;ARM;ARM?",
            "0",
        ),
        ("SYST:ERR?", conflict),
        ("SOUR:SWE:RANG BEST;ARM;ARM?", "1"),
    ]);
}

#[test]
fn section_5_completion_is_reported_when_a_sweep_is_done() {
    let mut talk = staircase(100.0);
    talk.hold(&[("*ESR?;:INIT;*OPC", "128"), ("*ESR?", "0")]);
    talk.at(1.9).hold(&[("*ESR?", "0")]);
    talk.at(2.0).hold(&[("*ESR?", "1")]);
    // The reply to the query `*OPC?` is delayed until the sweep is over.
    talk.say("INIT");
    let (now, command_time) = (talk.now(), Duration::from_millis(5));
    let reply = talk.source.receive("*OPC?", now, &mut talk.load);
    assert_eq!(reply.text.as_deref(), Some("1"));
    assert_eq!(reply.busy, command_time + Duration::from_secs(2));
    // Commands after `*WAI` in the same message are executed when the sweep is over.
    talk.hold(&[("*WAI;:SOUR:CURR?;:STAT:OPER:COND?", "3.000000E-03;1026")]);
}

#[test]
fn section_4_sweep_uses_settings_of_its_start_and_can_restart() {
    let mut talk = staircase(100.0);
    talk.hold(&[("SOUR:CURR:STOP 1e-3;STEP 1e-3;:SOUR:DEL 0.1;:INIT", "-")]);
    talk.at(0.2);
    assert_eq!(talk.operation(), DONE | IDLE);
    assert_eq!(talk.load.flowing, Amps(1e-3));
    talk.hold(&[("INIT", "-")]);
    assert_eq!(talk.operation(), SWEEPING);
    assert_eq!(talk.load.flowing, Amps(0.0));
}

#[test]
fn section_4_points_stay_when_the_ends_of_a_sweep_change() {
    Talk::new(100.0).hold(&[
        (
            "SOUR:CURR:STAR 0;STOP 4e-3;STEP 1e-3;:SOUR:SWE:SPAC LIN;POIN?",
            "5",
        ),
        (
            "SOUR:CURR:STOP 8e-3;STEP?;:SOUR:SWE:POIN?",
            "2.000000E-03;5",
        ),
        (
            "SOUR:CURR:STAR 4e-3;STEP?;:SOUR:SWE:POIN?",
            "1.000000E-03;5",
        ),
        (
            "SOUR:CURR:SPAN 2e-3;STEP?;STAR?;:SOUR:SWE:POIN?",
            "5.000000E-04;5.000000E-03;5",
        ),
        (
            "SOUR:CURR:CENT 0;STEP?;STAR?;:SOUR:SWE:POIN?",
            "5.000000E-04;-1.000000E-03;5",
        ),
        ("SOUR:CURR:STEP 1e-3;:SOUR:SWE:POIN?", "3"),
        // Header suffix 1 is optional.
        (
            "SOUR1:SWE1:POIN?;:ARM:SEQ1:LAY1:SOUR?;:SYST:ERR?",
            "3;IMM;0,\"No error\"",
        ),
    ]);
}
