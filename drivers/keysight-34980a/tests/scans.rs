//! Measurements into memory: readings that appear one by one at their own instants, triggers, the timer, overflow.

mod stand_in;

use std::time::Duration;

use keysight_34980a::{Settings34980a, Simulator34980a};
use proptest::prelude::*;
use stand_in::{Sheet, mainframe, say};

const START: Duration = Duration::from_secs(3);
/// One channel of a 34924A at 1 PLC, autozero off, delay 0, 50 Hz (section 9).
const PERIOD: Duration = Duration::from_micros(21_600);
const SET_UP: &str = "*CLS;:CONF:VOLT 10,(@1001:1010);:VOLT:DC:ZERO:AUTO OFF,(@1001:1010);:ROUT:CHAN:DEL 0;:ROUT:CLOS (@1036)";

fn scanner() -> (Simulator34980a, Sheet) {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    say(&mut unit, &mut sheet, SET_UP);
    (unit, sheet)
}

fn ask(unit: &mut Simulator34980a, sheet: &mut Sheet, message: &str, at: Duration) -> String {
    unit.receive(message, at, sheet).text.unwrap_or_default()
}

#[test]
fn readings_are_taken_and_appear_at_their_own_instants() {
    let (mut unit, mut sheet) = scanner();
    ask(&mut unit, &mut sheet, "INIT", START);
    for taken in 0..10_u32 {
        // Just before the next reading.
        let at = START + PERIOD * (taken + 1) - Duration::from_nanos(1);
        assert_eq!(
            ask(&mut unit, &mut sheet, "DATA:POIN?;:STAT:OPER:COND?", at),
            format!("{taken:+};+16")
        );
    }
    let end = START + PERIOD * 10;
    assert_eq!(
        ask(&mut unit, &mut sheet, "DATA:POIN?;:STAT:OPER:COND?", end),
        "+10;+0"
    );
    let instants: Vec<Duration> = sheet.requests.iter().map(|(at, ..)| *at).collect();
    let expected: Vec<Duration> = (1..=10).map(|k| START + PERIOD * k).collect();
    assert_eq!(instants, expected);
    assert_eq!(sheet.closed, [survey::Relay(1036)].into());
}

#[test]
fn a_scan_has_the_time_of_its_next_event() {
    let (mut unit, mut sheet) = scanner();
    assert_eq!(unit.due(), None);
    ask(&mut unit, &mut sheet, "INIT", START);
    let mut looked = 0;
    while let Some(due) = unit.due() {
        unit.pass(due, &mut sheet);
        looked += 1;
    }
    assert_eq!(sheet.requests.len(), 10);
    assert!(looked <= 21, "{looked}");
}

#[test]
fn what_the_source_does_during_a_scan_is_seen_from_then_on() {
    let (mut unit, mut sheet) = scanner();
    sheet.volts = Some(1.0);
    ask(&mut unit, &mut sheet, "INIT", START);
    unit.pass(START + PERIOD * 4, &mut sheet);
    sheet.volts = Some(2.0);
    let readings = ask(&mut unit, &mut sheet, "FETC?", START);
    let ones = readings.matches("+1.00000000E+00").count();
    assert_eq!((ones, readings.split(',').count()), (4, 10));
}

#[test]
fn readings_are_drained_while_the_scan_runs() {
    let (mut unit, mut sheet) = scanner();
    ask(&mut unit, &mut sheet, "INIT", START);
    let at = START + PERIOD * 5;
    assert_eq!(
        ask(&mut unit, &mut sheet, "R? 2", at),
        "#231+1.00100000E+00,+1.00200000E+00"
    );
    assert_eq!(ask(&mut unit, &mut sheet, "DATA:REM? 4", at), "");
    assert_eq!(
        ask(&mut unit, &mut sheet, "SYST:ERR?;:DATA:POIN?", at),
        "-222,\"Data out of range\";+3"
    );
    assert_eq!(
        ask(&mut unit, &mut sheet, "DATA:REM? 2", at),
        "+1.00300000E+00,+1.00400000E+00"
    );
    assert_eq!(
        ask(&mut unit, &mut sheet, "R?;:R?", at),
        "#215+1.00500000E+00;#10"
    );
    let rest = ask(&mut unit, &mut sheet, "*OPC?;:R?", at);
    assert!(rest.starts_with("1;#279+1.00600000E+00,"), "{rest}");
}

#[test]
fn the_timer_paces_sweeps_until_they_are_stopped() {
    let (mut unit, mut sheet) = scanner();
    say(
        &mut unit,
        &mut sheet,
        "ROUT:SCAN (@1001:1002);:TRIG:SOUR TIM;TIM 0.5;COUN INF;:FORM:READ:TIME ON",
    );
    let begin = Duration::from_secs(10);
    assert_eq!(
        ask(&mut unit, &mut sheet, "TRIG:COUN?;:INIT", begin),
        "+9.90000000E+37"
    );
    let at = begin + Duration::from_millis(1100);
    assert_eq!(
        ask(&mut unit, &mut sheet, "DATA:POIN?;:R?", at),
        "+6;#3179+1.00100000E+00,000000000.022,+1.00200000E+00,000000000.043,\
         +1.00100000E+00,000000000.522,+1.00200000E+00,000000000.543,\
         +1.00100000E+00,000000001.022,+1.00200000E+00,000000001.043"
    );
    // `*OPC?` does not wait for a measurement without end.
    let waited = unit.receive("*OPC?", at, &mut sheet);
    assert_eq!(
        (waited.text.as_deref(), waited.busy),
        (Some("1"), Duration::ZERO)
    );
    assert_eq!(
        ask(&mut unit, &mut sheet, "ROUT:SCAN (@1003);:SYST:ERR?", at),
        "-221,\"Settings conflict\""
    );
    assert_eq!(
        ask(
            &mut unit,
            &mut sheet,
            "ABOR;:STAT:OPER:COND?;:FETC?;:SYST:ERR?",
            at
        ),
        "+0;-230,\"Data corrupt or stale\""
    );
}

#[test]
fn a_timer_shorter_than_a_sweep_does_not_hurry_it() {
    let (mut unit, mut sheet) = scanner();
    say(&mut unit, &mut sheet, "TRIG:SOUR TIM;TIM 0.1;COUN 3");
    let begin = Duration::from_secs(10);
    let waited = unit.receive("INIT;*OPC?", begin, &mut sheet);
    assert_eq!(waited.busy, PERIOD * 30);
    say(&mut unit, &mut sheet, "TRIG:TIM 1");
    let begin = begin * 2;
    let waited = unit.receive("INIT;*OPC?", begin, &mut sheet);
    assert_eq!(waited.busy, Duration::from_secs(2) + PERIOD * 10);
    let read = unit.receive("READ?", begin * 2, &mut sheet);
    assert_eq!(read.busy, Duration::from_secs(2) + PERIOD * 10);
}

#[test]
fn external_pulse_triggers_a_waiting_scan_and_nothing_else() {
    let (mut unit, mut sheet) = scanner();
    say(
        &mut unit,
        &mut sheet,
        "ROUT:SCAN (@1001);:TRIG:SOUR EXT;COUN 2",
    );
    unit.pulse(START, &mut sheet);
    ask(&mut unit, &mut sheet, "INIT", START);
    for _ in 0..2 {
        assert_eq!(ask(&mut unit, &mut sheet, "STAT:OPER:COND?", START), "+32");
        unit.pulse(START, &mut sheet);
        assert_eq!(ask(&mut unit, &mut sheet, "STAT:OPER:COND?", START), "+16");
        unit.pass(START + PERIOD, &mut sheet);
    }
    assert_eq!(
        ask(
            &mut unit,
            &mut sheet,
            "*TRG;:SYST:ERR?;:DATA:POIN?",
            START + PERIOD
        ),
        "-211,\"Trigger ignored\";+2"
    );
}

#[test]
fn a_full_memory_loses_the_oldest_and_reports_it() {
    let mut settings = Settings34980a {
        memory: 25,
        ..Settings34980a::default()
    };
    settings.slots[0] = Some("34924A".parse().unwrap());
    let (mut unit, mut sheet) = (Simulator34980a::new(settings), Sheet::default());
    say(&mut unit, &mut sheet, SET_UP);
    say(&mut unit, &mut sheet, "TRIG:COUN 3;:FORM:READ:TIME ON");
    ask(&mut unit, &mut sheet, "INIT", START);
    let at = |readings| START + PERIOD * readings;
    assert_eq!(ask(&mut unit, &mut sheet, "STAT:QUES:COND?", at(25)), "+0");
    assert_eq!(
        ask(
            &mut unit,
            &mut sheet,
            "STAT:QUES:COND?;EVEN?;:DATA:POIN?",
            at(30)
        ),
        "+4096;+4096;+25"
    );
    let readings = ask(&mut unit, &mut sheet, "FETC?", at(30));
    assert!(
        readings.starts_with("+1.00600000E+00,000000000.130,"),
        "{readings}"
    );
    ask(&mut unit, &mut sheet, "INIT", at(40));
    assert_eq!(ask(&mut unit, &mut sheet, "STAT:QUES:COND?", at(40)), "+0");
}

#[test]
fn a_year_without_commands_costs_at_most_a_full_memory() {
    let mut settings = Settings34980a {
        memory: 1000,
        ..Settings34980a::default()
    };
    settings.slots[0] = Some("34924A".parse().unwrap());
    let (mut unit, mut sheet) = (Simulator34980a::new(settings), Sheet::default());
    say(&mut unit, &mut sheet, SET_UP);
    say(&mut unit, &mut sheet, "TRIG:COUN INF;:FORM:READ:CHAN ON");
    ask(&mut unit, &mut sheet, "INIT", START);
    let year = Duration::from_secs(31_557_600);
    let answer = ask(
        &mut unit,
        &mut sheet,
        "DATA:POIN?;:STAT:QUES:COND?;:R? 1",
        year,
    );
    assert!(answer.starts_with("+1000;+4096;"), "{answer}");
    assert!(sheet.requests.len() < 1100, "{}", sheet.requests.len());
    let (last, ..) = sheet.requests.last().unwrap();
    assert!(year - *last < PERIOD, "{last:?}");
    let cycles = ask(&mut unit, &mut sheet, "ABOR;:DIAG:REL:CYCL? (@1001)", year);
    let sweeps = (year - START).as_secs_f64() / (PERIOD * 10).as_secs_f64();
    assert!(
        (cycles.parse::<f64>().unwrap() - sweeps).abs() < 2.0,
        "{cycles}"
    );
}

#[test]
fn skipped_sweeps_leave_memory_state_and_closures_alike() {
    let relays = "(@1001,1002,1036,1037,1911,1922)";
    // The first of these scans has four-wire readings, which also close the partner channels and relays to both buses.
    for set_up in [
        "CONF:FRES 1000,(@1001:1002)",
        "CONF:VOLT 10,(@1001:1003);:TRIG:SOUR TIM;TIM 0.5",
        "CONF:VOLT 10;:SAMP:COUN 3",
    ] {
        let end = START + Duration::from_secs(600);
        let scan = |step_by_step: bool| {
            let mut settings = Settings34980a {
                memory: 50,
                ..Settings34980a::default()
            };
            settings.slots[0] = Some("34924A".parse().unwrap());
            let (mut unit, mut sheet) = (Simulator34980a::new(settings), Sheet::default());
            say(&mut unit, &mut sheet, set_up);
            say(
                &mut unit,
                &mut sheet,
                "ROUT:CLOS (@1040);:TRIG:COUN INF;:FORM:READ:TIME ON;CHAN ON",
            );
            ask(&mut unit, &mut sheet, "INIT", START);
            while let Some(due) = unit.due().filter(|due| step_by_step && *due < end) {
                unit.pass(due, &mut sheet);
            }
            let state = "DATA:POIN?;:STAT:QUES:COND?;EVEN?;:STAT:OPER:COND?;EVEN?;:*STB?;:SYST:ERR?;:DATA:LAST? (@1001);:R?";
            let state = ask(&mut unit, &mut sheet, state, end);
            let cycles = format!("ABOR;:DIAG:REL:CYCL? {relays}");
            let cycles = ask(&mut unit, &mut sheet, &cycles, end);
            // The closures reported to the circuit, including those of skipped sweeps.
            let mut closures = sheet.skipped.clone();
            let mut before = std::collections::BTreeSet::new();
            for (_, closed) in sheet.history {
                for relay in closed.difference(&before) {
                    *closures.entry(*relay).or_default() += 1;
                }
                before = closed;
            }
            ((state, cycles, closures), sheet.requests.len())
        };
        let ((slow, all), (fast, measured)) = (scan(true), scan(false));
        assert!(all > 1000 && measured < 70, "{set_up}: {measured} of {all}");
        assert_eq!(slow, fast, "{set_up}");
    }
}

#[test]
fn a_threshold_of_readings_is_an_event() {
    let (mut unit, mut sheet) = scanner();
    ask(
        &mut unit,
        &mut sheet,
        "DATA:POIN:EVEN:THR 4;:STAT:OPER?;:INIT",
        START,
    );
    let events = "STAT:OPER?";
    assert_eq!(
        ask(&mut unit, &mut sheet, events, START + PERIOD * 3),
        "+16"
    );
    assert_eq!(
        ask(&mut unit, &mut sheet, events, START + PERIOD * 4),
        "+512"
    );
}

#[test]
fn order_off_keeps_order_and_repeats() {
    let (mut unit, mut sheet) = scanner();
    assert_eq!(
        ask(
            &mut unit,
            &mut sheet,
            "ROUT:SCAN:ORD OFF;:ROUT:SCAN (@1005,1003,1005,1002:1001);:ROUT:SCAN?;SCAN:SIZE?;:READ?",
            START
        ),
        "#227(@1005,1003,1005,1001,1002);+5;\
         +1.00500000E+00,+1.00300000E+00,+1.00500000E+00,+1.00100000E+00,+1.00200000E+00"
    );
    assert_eq!(
        ask(
            &mut unit,
            &mut sheet,
            "ROUT:SCAN:ORD ON;:ROUT:SCAN?;SCAN:ADD (@1004);REM (@1001);:ROUT:SCAN?",
            START * 2
        ),
        "#222(@1001,1002,1003,1005);#222(@1002,1003,1004,1005)"
    );
}

proptest! {
    /// The number of time steps does not affect the readings, their times, and the end of a scan.
    #[test]
    fn the_number_of_clock_updates_changes_nothing(
        looks in prop::collection::vec(1_u64..2_000_000, 0..40),
        timer in prop::sample::select(vec!["IMM", "TIM"]),
    ) {
        let frame = |looks: &[u64]| {
            let (mut unit, mut sheet) = scanner();
            say(&mut unit, &mut sheet, &format!("TRIG:SOUR {timer};TIM 0.3;COUN 4"));
            ask(&mut unit, &mut sheet, "INIT", START);
            let mut at = START;
            for look in looks {
                at += Duration::from_micros(*look);
                unit.pass(at, &mut sheet);
            }
            let waited = unit.receive("*OPC?", START, &mut sheet).busy;
            let readings = ask(&mut unit, &mut sheet, "FETC?", at + START);
            let instants: Vec<Duration> = sheet.requests.iter().map(|(at, ..)| *at).collect();
            (waited.min(PERIOD * 40), readings, instants, sheet.history)
        };
        let (_, readings, instants, history) = frame(&[]);
        let found = frame(&looks);
        prop_assert_eq!((readings, instants, history), (found.1, found.2, found.3));
    }
}
