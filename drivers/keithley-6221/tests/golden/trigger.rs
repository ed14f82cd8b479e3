//! Arm and trigger layers.

use keithley_6221::Trigger;
use survey::Amps;

use super::talk::Talk;

const DONE: u16 = 1 << 1;
const SWEEPING: u16 = 1 << 3;
const AWAITS_TRIGGER: u16 = 1 << 5;
const AWAITS_ARM: u16 = 1 << 6;
const IDLE: u16 = 1 << 10;

/// A sweep of 1 and 2 mA, a second each, three times.
fn pairs(layers: &str) -> Talk {
    let mut talk = Talk::new(100.0);
    talk.hold(&[
        (
            "SOUR:SWE:SPAC LIST;COUN 3;:SOUR:LIST:CURR 1e-3,2e-3;DEL 1",
            "-",
        ),
        (layers, "-"),
        ("SOUR:SWE:ARM;:INIT;:SYST:ERR?", "0,\"No error\""),
    ]);
    talk
}

#[test]
fn section_4_each_pass_waits_for_the_bus() {
    let mut talk = pairs("ARM:SOUR BUS");
    for pass in 0..3 {
        let start = f64::from(pass) * 10.0;
        talk.at(start + 1.0);
        assert_eq!(talk.operation(), SWEEPING | AWAITS_ARM);
        talk.hold(&[("*TRG", "-")]);
        assert_eq!(talk.operation(), SWEEPING);
        talk.at(start + 2.5);
        assert_eq!(talk.load.flowing, Amps(2e-3));
    }
    talk.at(30.0);
    assert_eq!(talk.operation(), DONE | IDLE);
    talk.hold(&[("*TRG;:SYST:ERR?", "-211,\"Trigger ignored\"")]);
}

#[test]
fn section_4_passes_follow_the_timer() {
    let mut talk = pairs("ARM:SOUR TIM;TIM 5");
    for (seconds, level, operation) in [
        (0.5, 1e-3, SWEEPING),
        (1.5, 2e-3, SWEEPING),
        (4.0, 2e-3, SWEEPING | AWAITS_ARM),
        (5.5, 1e-3, SWEEPING),
        (9.0, 2e-3, SWEEPING | AWAITS_ARM),
        (11.9, 2e-3, SWEEPING),
        (12.0, 2e-3, DONE | IDLE),
    ] {
        talk.at(seconds);
        assert_eq!(talk.load.flowing, Amps(level), "at {seconds} s");
        assert_eq!(talk.operation(), operation, "at {seconds} s");
    }
}

#[test]
fn section_4_each_point_waits_for_its_line() {
    let mut talk = pairs("TRIG:SOUR TLIN;ILIN 2;:SOUR:SWE:COUN 1");
    assert_eq!(talk.operation(), SWEEPING | AWAITS_TRIGGER);
    let now = talk.now();
    assert!(!talk.source.trigger(Trigger::Link(3), now, &mut talk.load));
    assert!(talk.source.trigger(Trigger::Link(2), now, &mut talk.load));
    assert_eq!(talk.load.flowing, Amps(1e-3));
    assert_eq!(talk.operation(), SWEEPING);
    talk.at(60.0);
    assert_eq!(talk.operation(), SWEEPING | AWAITS_TRIGGER);
    assert_eq!(talk.load.flowing, Amps(1e-3));
    talk.hold(&[("TRIG:SIGN", "-")]);
    assert_eq!(talk.load.flowing, Amps(2e-3));
    talk.at(61.0);
    assert_eq!(talk.operation(), DONE | IDLE);
}

#[test]
fn section_4_the_key_and_the_start_of_test_line_arm() {
    let rising = Trigger::StartOfTest { rising: true };
    let falling = Trigger::StartOfTest { rising: false };
    for (layers, deaf, received) in [
        ("ARM:SOUR MAN", Trigger::Bus, Trigger::Key),
        ("ARM:SOUR PST", falling, rising),
        ("ARM:SOUR NST", rising, falling),
        ("ARM:SOUR BST", Trigger::Key, falling),
        ("ARM:SOUR TLIN;ILIN 6", Trigger::Link(1), Trigger::Link(6)),
    ] {
        let mut talk = pairs(layers);
        let now = talk.now();
        assert!(!talk.source.trigger(deaf, now, &mut talk.load), "{layers}");
        assert!(
            talk.source.trigger(received, now, &mut talk.load),
            "{layers}"
        );
        assert_eq!(talk.load.flowing, Amps(1e-3), "{layers}");
    }
}

#[test]
fn section_4_trigger_layers_use_their_lines() {
    // three passes of two points: six levels are set, six delays end, three passes begin and end
    for (layers, line, while_point_4_is_made, count) in [
        ("TRIG:OUTP SOUR;OLIN 3", 3, 4, 6),
        ("TRIG:OUTP DEL;OLIN 4", 4, 3, 6),
        ("ARM:OUTP TENT;OLIN 5", 5, 2, 3),
        ("ARM:OUTP TEX;OLIN 6", 6, 1, 3),
        ("TRIG:OUTP NONE;OLIN 1", 1, 0, 0),
    ] {
        let mut talk = pairs(layers);
        talk.at(3.5);
        assert_eq!(
            talk.source.pulses()[line - 1],
            while_point_4_is_made,
            "{layers}"
        );
        talk.at(60.0);
        let pulses = talk.source.pulses();
        assert_eq!(pulses[line - 1], count, "{layers}");
        assert_eq!(pulses.iter().sum::<u64>(), count, "{layers}");
    }
    // a point that waits for its trigger line has not been set
    let mut talk = pairs("TRIG:SOUR TLIN;ILIN 2;OUTP SOUR;OLIN 1");
    talk.at(10.0);
    assert_eq!(talk.source.pulses()[0], 0);
    let now = talk.now();
    assert!(talk.source.trigger(Trigger::Link(2), now, &mut talk.load));
    assert_eq!(talk.source.pulses()[0], 1);
    // a layer cannot wait for its own output line
    let mut talk = Talk::new(100.0);
    talk.hold(&[
        ("TRIG:SOUR TLIN;ILIN 2;OLIN 2;OUTP SOUR", "-"),
        ("SYST:ERR?", "0,\"No error\""),
        ("SOUR:SWE:ARM;:SYST:ERR?", "-221,\"Settings conflict\""),
        ("TRIG:OLIN 3;:SOUR:SWE:ARM;:SYST:ERR?", "0,\"No error\""),
        (
            "SOUR:SWE:ABOR;:ARM:SOUR TLIN;ILIN 4;OLIN 4;OUTP TENT;:SOUR:SWE:ARM",
            "-",
        ),
        ("SYST:ERR?", "-221,\"Settings conflict\""),
    ]);
    // a wave marks its phase
    talk.hold(&[(
        "*RST;:SOUR:WAVE:FREQ 10;DUR:CYCL 5;:SOUR:WAVE:PMAR:STAT ON;OLIN 2;LEV 90;:SOUR:WAVE:ARM;INIT",
        "-",
    )]);
    let began = talk.now().as_secs_f64();
    talk.at(began + 0.23);
    assert_eq!(talk.source.pulses()[1], 3);
    talk.at(began + 9.0);
    assert_eq!(talk.source.pulses()[1], 5);
}
