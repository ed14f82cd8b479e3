//! The simulated instrument: current, state after a client disconnects, and robustness against any input.

use std::time::Duration;

use keithley_6221::{Load, Resistor, Settings6221, Simulator6221};
use proptest::prelude::*;
use survey::{Amps, Ohms};

const START: Duration = Duration::ZERO;

fn instrument() -> Simulator6221 {
    Simulator6221::new(Settings6221::default())
}

/// A load that records its calls.
#[derive(Default)]
struct Witness {
    resistance: f64,
    changes: Vec<(f64, f64, Duration)>,
}

impl Load for Witness {
    fn resistance(&mut self, _at: Duration) -> Ohms {
        Ohms(self.resistance)
    }

    fn drive(&mut self, flowing: Amps, range: Amps, at: Duration) {
        self.changes.push((flowing.0, range.0, at));
    }
}

#[test]
fn the_level_flows_until_the_limit_holds_it_back() {
    let (mut source, mut load) = (instrument(), Resistor::new(Ohms(1000.0)));
    source.receive("CURR:COMP 5;:CURR -4e-3;:OUTP 1", START, &mut load);
    assert_eq!(load.flowing, Amps(-4e-3));
    assert!(!source.in_compliance());
    source.receive("CURR -10e-3", START, &mut load);
    assert_eq!(load.flowing, Amps(-5e-3));
    assert!(source.in_compliance());
    assert_eq!(source.level(), Amps(-10e-3));
}

#[test]
fn open_output_is_in_compliance_at_any_nonzero_level() {
    let (mut source, mut load) = (instrument(), Resistor::open());
    source.receive("OUTP 1", START, &mut load);
    assert!(!source.in_compliance());
    source.receive("CURR 1e-9", START, &mut load);
    assert!(source.in_compliance());
    assert_eq!(load.flowing, Amps(0.0));
    load.resistance = Ohms(0.0);
    source.load_changed(START, &mut load);
    assert!(!source.in_compliance());
    assert_eq!(load.flowing, Amps(1e-9));
    // The event stays latched until it is read.
    let reply = source.receive("STAT:MEAS?;:STAT:MEAS:COND?", START, &mut load);
    assert_eq!(reply.text.as_deref(), Some("8;0"));
}

#[test]
fn the_load_gets_only_changes_and_the_range() {
    let mut source = instrument();
    let mut load = Witness {
        resistance: 100.0,
        ..Witness::default()
    };
    let later = Duration::from_secs(3);
    source.receive("CURR:RANG 2e-3;:CURR 1e-3;:*IDN?", START, &mut load);
    source.receive("OUTP 1;:OUTP?", later, &mut load);
    source.receive("CURR 1e-3;CURR:COMP 20;FILT 1", later, &mut load);
    source.receive("SOUR:CLE", later, &mut load);
    assert_eq!(
        load.changes,
        [(0.0, 2e-3, START), (1e-3, 2e-3, later), (0.0, 2e-3, later)]
    );
}

#[test]
fn a_change_of_range_takes_longer_than_a_level() {
    let (mut source, mut load) = (instrument(), Resistor::new(Ohms(1.0)));
    let busy = |reply: keithley_6221::Response| reply.busy;
    let range = source.receive("CURR:RANG 2e-3", START, &mut load);
    let level = source.receive("CURR 1e-3", START, &mut load);
    assert_eq!(busy(range), Duration::from_millis(15));
    assert_eq!(busy(level), Duration::from_millis(5));
}

#[test]
fn an_open_interlock_keeps_the_output_off() {
    let (mut source, mut load) = (instrument(), Resistor::new(Ohms(1.0)));
    source.receive("CURR 1e-3;:OUTP 1", START, &mut load);
    source.set_interlock(false, START, &mut load);
    assert_eq!(load.flowing, Amps(0.0));
    let reply = source.receive(
        "OUTP 1;:OUTP?;:OUTP:INT:TRIP?;:STAT:MEAS:COND?;:SYST:ERR?",
        START,
        &mut load,
    );
    assert_eq!(
        reply.text.as_deref(),
        Some("0;0;2;-221,\"Settings conflict\"")
    );
    source.set_interlock(true, START, &mut load);
    source.receive("OUTP 1", START, &mut load);
    assert!(source.output());
}

#[test]
fn a_line_too_long_is_error_363() {
    let (mut source, mut load) = (instrument(), Resistor::open());
    source.refuse(scpi::ParseError::InputOverrun);
    let reply = source.receive("SYST:ERR?", START, &mut load).text;
    assert_eq!(reply.as_deref(), Some("-363,\"Input buffer overrun\""));
}

/// Lines of valid commands, nearly valid commands, and noise.
fn line() -> impl Strategy<Value = String> {
    let unit = prop_oneof![
        "(SOUR:)?CURR [+-]?[0-9](\\.[0-9])?e-[0-9]",
        "CURR:(RANG|COMP) ([0-9]{1,3}|MIN|MAX|DEF|INF|[0-9]e-[0-9])",
        "CURR:RANG:AUTO (0|1|ON|OFF)",
        "OUTP (0|1)",
        "(SOUR:CLE|\\*RST|\\*CLS|\\*OPC|STAT:PRES)",
        "(CURR|OUTP|SYST:ERR|STAT:MEAS|\\*ESR|\\*STB|CURR:RANG)\\?( MIN| MAX)?",
        "[ -~]{0,12}",
        ".{0,6}",
    ];
    proptest::collection::vec(unit, 0..6).prop_map(|units| units.join(";:"))
}

proptest! {
    #[test]
    fn any_input_leaves_the_instrument_within_its_limits(
        lines in proptest::collection::vec(line(), 0..20),
        resistance in prop_oneof![Just(f64::INFINITY), Just(0.0), Just(f64::NAN), 1e-3..1e12],
    ) {
        let (mut source, mut load) = (instrument(), Resistor::new(Ohms(resistance)));
        for line in lines {
            let reply = source.receive(&line, START, &mut load);
            prop_assert!(source.errors() <= 10);
            prop_assert!(reply.text.is_none_or(|text| !text.contains('\n')));
            prop_assert!(source.level().abs() <= Amps(0.105));
            prop_assert!(source.level().abs() <= source.range() * 1.0501);
            prop_assert!(load.flowing.abs() <= source.level().abs());
            prop_assert_eq!(load.flowing, source.flowing());
            if !source.output() {
                prop_assert_eq!(load.flowing, Amps(0.0));
            }
        }
        source.receive("*RST", START, &mut load);
        prop_assert_eq!(load.flowing, Amps(0.0));
    }
}
