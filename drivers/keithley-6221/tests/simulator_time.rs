//! Time in the simulated instrument: one long step and many short ones give the same state.

use std::time::Duration;

use keithley_6221::{Resistor, Settings6221, Simulator6221, Trigger};
use proptest::prelude::*;
use survey::{Amps, Ohms};

const MOST: f64 = 0.105 * (1.0 + 1e-9);

fn instrument() -> Simulator6221 {
    Simulator6221::new(Settings6221::default())
}

fn seconds(at: f64) -> Duration {
    survey::duration(at)
}

/// Settings of a sweep or wave, and its start.
fn beginning() -> impl Strategy<Value = String> {
    let levels = || proptest::collection::vec(-5e-3..5e-3f64, 1..5);
    let delays = || proptest::collection::vec(1u32..400, 1..5);
    let list = (levels(), delays(), 1..5u8).prop_map(|(levels, delays, count)| {
        let text = |values: Vec<String>| values.join(",");
        let levels: Vec<String> = levels.iter().map(f64::to_string).collect();
        let delays = delays.iter().map(|ms| format!("{ms}e-3")).cycle();
        let delays = text(delays.take(levels.len()).collect());
        format!(
            "SOUR:SWE:SPAC LIST;COUN {count};:SOUR:LIST:CURR {};DEL {delays};COMP 3",
            text(levels)
        )
    });
    let linear = (-5e-3..5e-3f64, -5e-3..5e-3f64, 1e-4..1e-3f64).prop_map(|(start, stop, step)| {
        format!("SOUR:CURR:STAR {start};STOP {stop};STEP {step};:SOUR:DEL 0.05;:SOUR:SWE:COUN INF")
    });
    let wave = (0..4usize, 0.1..20.0f64, 1e-6..1e-3f64, 1..30u8).prop_map(
        |(shape, hertz, amplitude, cycles)| {
            let shape = ["SIN", "SQU", "RAMP", "ARB0"][shape];
            format!(
                "SOUR:WAVE:ARB:DATA 0,1,-1;:SOUR:WAVE:FUNC {shape};FREQ {hertz};AMPL {amplitude};DUR:CYCL {cycles}"
            )
        },
    );
    let arm = prop_oneof!["ARM:SOUR IMM", "ARM:SOUR TIM;TIM 0\\.[1-9]"];
    let abort = any::<bool>().prop_map(|on| format!(":SOUR:SWE:CAB {}", u8::from(on)));
    prop_oneof![
        (prop_oneof![list, linear], arm, abort)
            .prop_map(|(sweep, arm, abort)| format!("{sweep};:{arm};{abort};ARM;:INIT")),
        wave.prop_map(|wave| format!("{wave};:SOUR:WAVE:ARM;INIT")),
    ]
}

/// Units with sweeps, waves and triggers.
fn line() -> impl Strategy<Value = String> {
    let unit = prop_oneof![
        "SOUR:CURR:(STAR|STOP|STEP|CENT|SPAN) -?[0-9]e-[2-9]",
        "SOUR:SWE:(SPAC (LIN|LOG|LIST)|COUN ([1-9]|INF)|RANG (BEST|AUTO|FIX)|CAB [01]|POIN [1-9]{1,5})",
        "SOUR:LIST:(CURR|DEL|COMP) (0\\.0[1-9],){0,3}0\\.0[1-9]",
        "SOUR:(DEL [0-9]|SWE:ARM|SWE:ABOR|CLE|WAVE:ARM|WAVE:INIT|WAVE:ABOR)",
        "SOUR:WAVE:(FUNC (SIN|SQU|RAMP|ARB[0-4])|FREQ [1-9]e-?[0-4]|AMPL [1-9]e-[2-9]|OFFS -?[1-9]e-[2-9])",
        "SOUR:WAVE:(DCYC [0-9]{1,2}|DUR:(TIME|CYCL) ([1-9]|INF)|RANG (BEST|FIX)|ARB:(DATA 0,1|COPY [1-4]))",
        "(INIT|ABOR|\\*TRG|\\*RST|\\*WAI|\\*OPC|\\*OPC\\?|\\*SAV [0-4]|\\*RCL [0-4]|OUTP [01]|SYST:PRES)",
        "(ARM:SOUR (IMM|TIM|BUS|TLIN|MAN|BST)|TRIG:SOUR (IMM|TLIN)|ARM:SIGN|TRIG:SIGN|ARM:DIR SOUR)",
        "(CURR:RANG ([1-9]e-[3-9])|CURR:RANG:AUTO [01]|CURR -?[1-9]e-[3-9]|CURR:COMP [1-9])",
        "(SOUR:SWE:POIN|SOUR:WAVE:DUR:TIME|SOUR:CURR:CENT|STAT:OPER|TRAC:DATA)\\?",
        "[A-Z:]{0,8}[? ][0-9A-Z.,-]{0,8}",
    ];
    proptest::collection::vec(unit, 1..5).prop_map(|units| units.join(";:"))
}

proptest! {
    #[test]
    fn one_stride_or_many_come_to_the_same(
        beginning in beginning(),
        steps in proptest::collection::vec(0.0..0.7f64, 1..40),
        ohms in 1.0..2000.0f64,
    ) {
        let (mut watched, mut here) = (instrument(), Resistor::new(Ohms(ohms)));
        let (mut left_alone, mut there) = (instrument(), Resistor::new(Ohms(ohms)));
        watched.receive(&beginning, Duration::ZERO, &mut here);
        left_alone.receive(&beginning, Duration::ZERO, &mut there);
        prop_assert_eq!(watched.errors(), 0);
        let mut now = 0.0;
        for step in steps {
            now += step;
            watched.load_changed(seconds(now), &mut here);
        }
        left_alone.load_changed(seconds(now), &mut there);
        prop_assert_eq!(here, there);
        prop_assert_eq!(watched.level(), left_alone.level());
        prop_assert_eq!(watched.output(), left_alone.output());
        let queries = "STAT:OPER:COND?;:STAT:MEAS:COND?;:SOUR:CURR?;:SOUR:CURR:RANG?;:SOUR:SWE:ARM?";
        prop_assert_eq!(
            watched.receive(queries, seconds(now), &mut here).text,
            left_alone.receive(queries, seconds(now), &mut there).text
        );
    }

    #[test]
    fn any_message_at_any_time_keeps_instrument_within_limits(
        sent in proptest::collection::vec((line(), 0.0..1e7f64, any::<u8>()), 0..20),
        ohms in prop_oneof![Just(f64::INFINITY), Just(0.0), Just(f64::NAN), 1e-3..1e12],
    ) {
        let (mut source, mut load) = (instrument(), Resistor::new(Ohms(ohms)));
        let mut now = 0.0;
        for (line, pause, event) in sent {
            let reply = source.receive(&line, seconds(now), &mut load);
            prop_assert!(reply.text.is_none_or(|text| !text.contains('\n')));
            now += pause;
            source.trigger(Trigger::Link(event % 8), seconds(now), &mut load);
            prop_assert!(source.errors() <= 10);
            prop_assert!(source.level().0.abs() <= MOST);
            prop_assert!(load.flowing.abs() <= source.level().abs());
            prop_assert!(load.flowing.0.abs() <= source.range().0 * 1.0501);
            prop_assert_eq!(load.flowing, source.flowing());
            if !source.output() {
                prop_assert_eq!(load.flowing, Amps(0.0));
            }
        }
        source.receive("*RST", seconds(now), &mut load);
        prop_assert_eq!(load.flowing, Amps(0.0));
        prop_assert_eq!(source.receive("STAT:OPER:COND?", seconds(now), &mut load).text, Some("1024".to_owned()));
    }
}

#[test]
fn an_interlock_that_opens_slowly_switches_off_later() {
    let mut source = Simulator6221::new(Settings6221 {
        interlock_time: Duration::from_millis(50),
        ..Settings6221::default()
    });
    let mut load = Resistor::new(Ohms(1.0));
    source.receive("CURR 1e-3;:OUTP 1", Duration::ZERO, &mut load);
    source.set_interlock(false, seconds(1.0), &mut load);
    assert_eq!(load.flowing, Amps(1e-3));
    source.load_changed(seconds(1.05), &mut load);
    assert_eq!(load.flowing, Amps(0.0));
    assert!(!source.output());
}

#[test]
fn time_does_not_run_back() {
    let (mut source, mut load) = (instrument(), Resistor::new(Ohms(1.0)));
    source.receive("SOUR:WAVE:FREQ 1;ARM;INIT", seconds(10.0), &mut load);
    source.load_changed(seconds(10.25), &mut load);
    let peak = load.flowing;
    source.load_changed(seconds(3.0), &mut load);
    assert_eq!(load.flowing, peak);
    assert!((peak.0 - 1e-3).abs() < 1e-15);
}
