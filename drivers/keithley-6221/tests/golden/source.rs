//! Identity, grammar, levels, ranges, status, errors.

use super::talk::Talk;

/// Sends each line to a fresh instrument with 500 ohm on its terminals. `-` means no reply.
fn conversation(lines: &[(&str, &str)]) {
    Talk::new(500.0).hold(lines);
}

#[test]
fn section_2_identity() {
    conversation(&[
        ("*IDN?", "KEITHLEY INSTRUMENTS INC.,MODEL 6221,1234567,D04"),
        ("SYST:VERS?", "1999.0"),
    ]);
}

#[test]
fn section_3_grammar() {
    conversation(&[
        // Case does not matter; long or short form, no form in between.
        ("SYSTe:PRES", "-"),
        ("syst:err?", "-113,\"Undefined header\""),
        ("System:Error?", "0,\"No error\""),
        // `;` keeps the path, `:` returns to the root, common commands do not move it.
        (
            "SOUR:CURR:COMP 5;RANG 2e-3;*CLS;COMP?;:OUTP?",
            "5.000000E+00;0",
        ),
        // Common clients send a `:` before a common command and a trailing `;`.
        ("status:queue:clear;*RST;:stat:pres;:*CLS;", "-"),
        ("SYST:ERR?", "0,\"No error\""),
        // SOURce is optional.
        ("CURR 1e-6", "-"),
        ("SOUR:CURR?", "1.000000E-06"),
        // Several queries, one line.
        ("CURR?;:OUTP?;:*OPC?", "1.000000E-06;0;1"),
        // MIN, MAX, DEF.
        ("CURR? MIN", "-1.050000E-01"),
        ("CURR? MAX", "1.050000E-01"),
        ("CURR? DEF", "0.000000E+00"),
        ("CURR:COMP? MIN;COMP? MAX", "1.000000E-01;1.050000E+02"),
        ("CURR:RANG? MIN;RANG? MAX", "2.000000E-09;1.000000E-01"),
        // Booleans accept 0|1|OFF|ON and read back 0|1.
        ("CURR:FILT ON;FILT?", "1"),
        ("CURR:FILT OFF;FILT?", "0"),
        ("SYST:ERR?", "0,\"No error\""),
    ]);
}

#[test]
fn section_4_settings_after_reset() {
    conversation(&[
        ("OUTP ON;CURR:COMP 20;RANG:AUTO 1;:CURR 1e-3", "-"),
        ("OUTP:ISH GUAR;LTE 1;RESP SLOW", "-"),
        ("OUTP:ISH?;LTE?;RESP?", "GUAR;1;SLOW"),
        (
            "OUTP?;:CURR?;CURR:RANG?;RANG:AUTO?",
            "1;1.000000E-03;2.000000E-03;1",
        ),
        ("*RST", "-"),
        ("OUTP?;:CURR?;CURR:COMP?", "0;0.000000E+00;1.000000E+01"),
        ("OUTP:ISH?;LTE?", "OLOW;0"),
        ("OUTP:INT:TRIP?", "1"),
        ("SYST:ERR?", "0,\"No error\""),
    ]);
}

#[test]
fn section_4_the_smallest_range_that_holds_the_value() {
    conversation(&[
        ("CURR:RANG 1e-3;RANG?;RANG:AUTO?", "2.000000E-03;0"),
        ("CURR:RANG 2.5e-3;RANG?", "2.000000E-02"),
        ("CURR:RANG -1.5e-8;RANG?", "2.000000E-08"),
        ("SYST:ERR?", "0,\"No error\""),
    ]);
}

#[test]
fn section_4_zero_and_off() {
    conversation(&[
        ("CURR 1e-3;:OUTP 1;:OUTP?", "1"),
        ("SOUR:CLE", "-"),
        ("OUTP?;:CURR?", "0;0.000000E+00"),
    ]);
}

#[test]
fn section_5_compliance_is_condition_and_event_not_error() {
    conversation(&[
        // 1 mA through 500 ohm needs 0.5 V.
        ("CURR:COMP 0.4;:CURR 1e-3;:OUTP 1", "-"),
        ("STAT:MEAS:COND?", "8"),
        ("SYST:ERR?", "0,\"No error\""),
        ("STAT:MEAS:ENAB 8;:*SRE 1;*STB?", "65"),
        ("CURR:COMP 10", "-"),
        ("STAT:MEAS:COND?", "0"),
        ("STAT:MEAS?", "8"),
        ("STAT:MEAS:EVEN?", "0"),
        ("*STB?", "0"),
        // STAT:PRES zeroes the enables, *CLS does not.
        ("*CLS;:STAT:MEAS:ENAB?", "8"),
        ("STAT:PRES;MEAS:ENAB?;:*SRE?", "0;1"),
    ]);
}

#[test]
fn section_5_standard_events_and_status_byte() {
    conversation(&[
        ("*ESR?", "128"),
        ("*ESR?", "0"),
        ("*OPC;*ESR?", "1"),
        // PyMeasure's standard_event_enabled really sends `ESE?`: no reply, error -113.
        ("ESE?", "-"),
        ("*ESE 32;*ESE?", "32"),
        ("*STB?", "36"),
        ("SYST:ERR?;*STB?", "-113,\"Undefined header\";48"),
        ("*ESR?;*STB?", "32;16"),
        ("*ESE 256;*SRE 300", "-"),
        ("*ESR?", "16"),
    ]);
}

#[test]
fn section_6_errors_by_number() {
    conversation(&[
        ("CURR 0.2", "-"),
        ("SYST:ERR?", "-222,\"Parameter data out of range\""),
        ("CURR:COMP 0.05;COMP 106;COMP?", "1.000000E+01"),
        (
            "STAT:QUE?;QUE?",
            "-222,\"Parameter data out of range\";-222,\"Parameter data out of range\"",
        ),
        // A level that exceeds the fixed range; a range smaller than the level.
        ("CURR:RANG 2e-6;:CURR 1e-3", "-"),
        ("SYST:ERR?", "-222,\"Parameter data out of range\""),
        ("CURR 2e-6;CURR:RANG 2e-9", "-"),
        ("SYST:ERR?", "-221,\"Settings conflict\""),
        ("CURR", "-"),
        ("SYST:ERR?", "-109,\"Missing parameter\""),
        ("CURR 1,2", "-"),
        ("SYST:ERR?", "-108,\"Parameter not allowed\""),
        ("OUTP:ISH OPEN", "-"),
        ("SYST:ERR?", "-224,\"Illegal parameter value\""),
        // A query with an undefined header gives no reply.
        ("SOUR:VOLT?", "-"),
        ("SYST:ERR?", "-113,\"Undefined header\""),
        ("SYST:ERR?", "0,\"No error\""),
    ]);
}

#[test]
fn section_6_the_queue_is_ten_deep_and_its_newest_becomes_350() {
    let mut lines = vec![("CURR 1", "-")];
    lines.extend([("XYZ", "-"); 12]);
    lines.push(("SYST:ERR?", "-222,\"Parameter data out of range\""));
    lines.extend([("SYST:ERR?", "-113,\"Undefined header\""); 8]);
    lines.push(("SYST:ERR?", "-350,\"Queue overflow\""));
    lines.push(("SYST:ERR?", "0,\"No error\""));
    lines.extend([("XYZ", "-"), ("SYST:CLE", "-")]);
    lines.push(("SYST:ERR?", "0,\"No error\""));
    conversation(&lines);
}

#[test]
fn section_7_five_per_cent_over_and_ten_millivolt_steps() {
    conversation(&[
        ("CURR:RANG 2e-3;:CURR 2.1e-3;CURR?", "2.100000E-03"),
        (
            "CURR 2.11e-3;:SYST:ERR?",
            "-222,\"Parameter data out of range\"",
        ),
        (
            "CURR -0.105;:SYST:ERR?",
            "-222,\"Parameter data out of range\"",
        ),
        ("CURR:RANG MAX;:CURR -0.105;CURR?", "-1.050000E-01"),
        ("CURR:RANG:AUTO 1;:CURR 2.1e-8;CURR:RANG?", "2.000000E-08"),
        ("CURR 2.2e-8;CURR:RANG?", "2.000000E-07"),
        ("CURR:COMP 4.237;COMP?", "4.240000E+00"),
    ]);
}

#[test]
fn section_6_errors_of_the_conversation_itself() {
    use scpi::ParseError;
    for (refusal, event, text) in [
        (
            ParseError::QueryDeadlocked,
            "4",
            "-430,\"Query DEADLOCKED\"",
        ),
        (
            ParseError::QueryUnterminated,
            "4",
            "-420,\"Query UNTERMINATED\"",
        ),
        (
            ParseError::QueryInterrupted,
            "4",
            "-410,\"Query INTERRUPTED\"",
        ),
        (
            ParseError::InputOverrun,
            "8",
            "-363,\"Input buffer overrun\"",
        ),
    ] {
        let mut talk = Talk::new(500.0);
        talk.hold(&[("*CLS", "-")]);
        talk.source.refuse(refusal);
        talk.hold(&[("*ESR?", event), ("SYST:ERR?", text)]);
    }
}

#[test]
fn section_6_the_depth_of_the_queue_is_a_setting() {
    use keithley_6221::{Settings6221, Simulator6221};
    let mut talk = Talk::new(500.0);
    talk.source = Simulator6221::new(Settings6221 {
        queue_depth: 2,
        ..Settings6221::default()
    });
    talk.hold(&[
        ("XYZ;:XYZ;:XYZ", "-"),
        (
            "SYST:ERR?;ERR?;ERR?",
            "-113,\"Undefined header\";-350,\"Queue overflow\";0,\"No error\"",
        ),
    ]);
}

#[test]
fn section_5_groups_are_summed_up_in_the_status_byte() {
    let mut talk = Talk::new(500.0);
    talk.hold(&[
        ("*ESR?;:STAT:OPER:ENAB 2;:STAT:MEAS:ENAB 2;:*SRE 129", "128"),
        ("*STB?", "0"),
        ("SOUR:DEL 0.001;:SOUR:SWE:POIN 1;ARM;:INIT", "-"),
    ]);
    // Sweep done: bit 1 of the operation group, summarised in bit 7; bit 6 requests service.
    talk.at(1.0)
        .hold(&[("*STB?", "192"), ("STAT:OPER?;*STB?", "1034;16")]);
    let now = talk.now();
    talk.source.set_interlock(false, now, &mut talk.load);
    talk.hold(&[
        ("STAT:MEAS:COND?;*STB?", "2;81"),
        ("STAT:MEAS?;:STAT:PRES;:STAT:MEAS:ENAB?", "2;0"),
    ]);
    talk.source.set_interlock(true, now, &mut talk.load);
    talk.hold(&[(
        "STAT:MEAS:COND?;:STAT:MEAS?;:STAT:QUES?;QUES:COND?",
        "0;0;0;0",
    )]);
}
