//! Properties that the golden conversations do not test: the relays passed to the wires, times, limits, memory, and
//! arbitrary input.

mod stand_in;

use std::collections::BTreeSet;
use std::time::Duration;

use keysight_34980a::{Module, Settings34980a, Simulator34980a};
use proptest::prelude::*;
use stand_in::{Sheet, mainframe, say};
use survey::Relay;

const START: Duration = Duration::from_secs(3);

fn set(numbers: &[u32]) -> BTreeSet<Relay> {
    numbers.iter().copied().map(Relay).collect()
}

#[test]
fn scan_closes_one_channel_and_its_bus_relay_of_one_bank_only() {
    let (mut unit, mut sheet) = (mainframe(&["34924A", "34932A"]), Sheet::default());
    say(&mut unit, &mut sheet, "ROUT:CLOS (@1005,1036,2921,2922)");
    say(&mut unit, &mut sheet, "CONF:VOLT:DC 10,(@1001:1002)");
    unit.receive("READ?", START, &mut sheet);
    let seen: Vec<&BTreeSet<Relay>> = sheet.requests.iter().map(|(_, _, closed)| closed).collect();
    // 2922 connects row 6 to bus 2: only bus 1 is cleared.
    let during = [
        set(&[1001, 1036, 1911, 2922]),
        set(&[1002, 1036, 1911, 2922]),
    ];
    assert_eq!(seen, during.iter().collect::<Vec<_>>());
    assert_eq!(sheet.closed, set(&[1036, 2922]));
    assert_eq!(unit.closed(), &sheet.closed);
}

#[test]
fn relays_and_readings_take_their_time() {
    let busy = |modules: &[&str], messages: &[&str]| {
        let (mut unit, mut sheet) = (mainframe(modules), Sheet::default());
        let mut last = Duration::ZERO;
        for message in messages {
            last = unit.receive(message, START, &mut sheet).busy;
        }
        assert_eq!(unit.errors_waiting(), 0, "{messages:?}");
        last.as_secs_f64()
    };
    let near = |found: f64, expected: f64| {
        assert!((found - expected).abs() < 1e-9, "{found} for {expected}");
    };
    near(busy(&["34924A"], &["ROUT:CLOS (@1036,1037)"]), 0.5e-3);
    near(busy(&["34932A"], &["ROUT:CLOS (@1101);OPEN (@1101)"]), 8e-3);
    near(
        busy(&["34934A"], &["ROUT:CLOS (@1101);OPEN (@1101)"]),
        0.45e-3,
    );
    // Section 9: 1/rate - 0.02 PLC + integration, at 50 Hz.
    let frame = |nplc: &str| {
        let setup = format!(
            "CONF:VOLT 1,(@1001:1026);:VOLT:NPLC {nplc},(@1001:1026);:VOLT:DC:ZERO:AUTO OFF,(@1001:1026);:ROUT:CHAN:DEL 0"
        );
        busy(&["34924A"], &[&setup, "READ?"])
    };
    near(frame("1"), 26.0 * (2e-3 - 0.4e-3 + 20e-3));
    near(frame("0.02"), 26.0 * 2e-3);
    near(
        busy(&["34924A"], &["CONF:VOLT 1,(@1001)", "READ?"]),
        2e-3 - 0.4e-3 + 40e-3 + 1e-3,
    );
    near(busy(&["34932A"], &["CONF:VOLT 1,(@)", "READ?"]), 40e-3);
    near(
        busy(
            &["34932A"],
            &[
                "CONF:VOLT 1,(@);:VOLT:NPLC 0.02;:VOLT:DC:ZERO:AUTO OFF",
                "READ?",
            ],
        ),
        0.4e-3,
    );
}

#[test]
fn a_fifth_over_range_is_still_a_number() {
    let (mut unit, mut sheet) = (mainframe(&["34932A"]), Sheet::default());
    say(&mut unit, &mut sheet, "CONF:VOLT:DC 1,(@)");
    for (volts, answer) in [
        (1.2, "+1.20000000E+00"),
        (-1.2, "-1.20000000E+00"),
        (1.2000001, "+9.90000000E+37"),
        (-5.0, "-9.90000000E+37"),
        (f64::NAN, "+9.90000000E+37"),
        (f64::INFINITY, "+9.90000000E+37"),
        (1.25e-7, "+1.25000000E-07"),
    ] {
        sheet.volts = Some(volts);
        assert_eq!(
            say(&mut unit, &mut sheet, "READ?").as_deref(),
            Some(answer),
            "{volts}"
        );
    }
    let requested = sheet.requests.last().unwrap().1;
    assert_eq!(
        (requested.channel, requested.range.0, requested.nplc),
        (None, 1.0, 1.0)
    );
    say(&mut unit, &mut sheet, "VOLT:DC:RANG AUTO,(@)");
    sheet.volts = Some(0.11);
    assert_eq!(
        say(&mut unit, &mut sheet, "READ?").as_deref(),
        Some("+1.10000000E-01")
    );
    assert_eq!(sheet.requests.last().unwrap().1.range.0, 0.1);
}

#[test]
fn a_measurement_in_memory_ends_in_its_own_time() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    say(
        &mut unit,
        &mut sheet,
        "*CLS;:CONF:VOLT 10,(@1001:1010);:VOLT:DC:ZERO:AUTO OFF,(@1001:1010);:ROUT:CHAN:DEL 0;:ROUT:CLOS (@1036)",
    );
    let length = 10.0 * 21.6e-3;
    assert_eq!(
        unit.receive("INIT;*OPC", START, &mut sheet).busy,
        Duration::ZERO
    );
    let half = START + survey::duration(length / 2.0);
    let received = unit.receive("STAT:OPER:COND?;*ESR?;:INIT;:SYST:ERR?", half, &mut sheet);
    assert_eq!(
        received.text.as_deref(),
        Some("+16;+0;-213,\"Init ignored\"")
    );
    let waited = unit.receive("*OPC?;*ESR?;:STAT:OPER:COND?", half, &mut sheet);
    assert!((waited.busy.as_secs_f64() - length / 2.0).abs() < 1e-6);
    assert_eq!(waited.text.as_deref(), Some("1;+17;+0"));
    let answer = unit.receive("FETC?", START * 2, &mut sheet).text.unwrap();
    assert_eq!(answer.split(',').count(), 10);
    // After an abort, only the readings taken until then exist.
    let later = START * 3;
    unit.receive("INIT", later, &mut sheet);
    let cut = later + survey::duration(length / 2.0 + 1e-3);
    let answer = unit.receive("ABOR;:FETC?", cut, &mut sheet).text.unwrap();
    assert_eq!(answer.split(',').count(), 5);
}

#[test]
fn triggers_from_the_bus_take_one_sweep_each() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    say(
        &mut unit,
        &mut sheet,
        "CONF:VOLT 10,(@1001:1002);:TRIG:SOUR BUS;COUN 2;:INIT",
    );
    let later = |seconds| START + Duration::from_secs(seconds);
    assert_eq!(
        unit.receive("STAT:OPER:COND?", START, &mut sheet)
            .text
            .as_deref(),
        Some("+32")
    );
    unit.receive("*TRG", later(1), &mut sheet);
    unit.receive("*TRG", later(2), &mut sheet);
    unit.receive("*TRG", later(3), &mut sheet);
    let answer = unit.receive("FETC?;:SYST:ERR?", later(4), &mut sheet).text;
    let answer = answer.unwrap();
    let (readings, error) = answer.split_once(';').unwrap();
    assert_eq!(readings.split(',').count(), 4);
    assert_eq!(error, "-211,\"Trigger ignored\"");
}

#[test]
fn a_read_of_more_than_the_memory_holds_is_refused() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    say(
        &mut unit,
        &mut sheet,
        "CONF:VOLT 1,(@1001:1026);:TRIG:COUN 50000",
    );
    assert_eq!(say(&mut unit, &mut sheet, "READ?"), None);
    say(&mut unit, &mut sheet, "TRIG:COUN INF");
    assert_eq!(say(&mut unit, &mut sheet, "READ?"), None);
    assert_eq!(
        say(&mut unit, &mut sheet, "SYST:ERR?;:SYST:ERR?").as_deref(),
        Some("-225,\"Out of memory\";-214,\"Trigger deadlock\"")
    );
    assert!(sheet.requests.is_empty());
}

#[test]
fn too_many_coils_close_nothing() {
    let (mut unit, mut sheet) = (mainframe(&["34924A", "34925A"]), Sheet::default());
    say(&mut unit, &mut sheet, "ROUT:CLOS (@1001:1011)");
    say(&mut unit, &mut sheet, "ROUT:CLOS (@2001,2002)");
    assert_eq!((unit.closed().len(), unit.errors_waiting()), (0, 2));
    say(&mut unit, &mut sheet, "ROUT:CLOS (@1001:1010,1036:1045)");
    assert_eq!((unit.closed().len(), unit.errors_waiting()), (20, 2));
}

#[test]
fn latching_relays_survive_a_power_cycle_and_reset_opens_them() {
    let modules = ["34924A", "34932A"];
    let (mut unit, mut sheet) = (mainframe(&modules), Sheet::default());
    say(
        &mut unit,
        &mut sheet,
        "ROUT:CLOS (@1036,2101,2921);:CONF:VOLT 1,(@1001)",
    );
    unit.power_cycle(START, &mut sheet);
    assert_eq!(sheet.closed, set(&[2101]));
    assert_eq!(
        say(&mut unit, &mut sheet, "ROUT:SCAN:SIZE?;*ESR?").as_deref(),
        Some("+0;+128")
    );
    say(&mut unit, &mut sheet, "*RST");
    assert_eq!(sheet.closed, set(&[]));
}

#[test]
fn a_bad_value_fails_alone_and_a_bad_header_ends_its_message() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    assert_eq!(
        say(
            &mut unit,
            &mut sheet,
            "VOLT:DC:RANG 999;:ROUT:CLOS (@8001);*OPC?"
        )
        .as_deref(),
        Some("1")
    );
    assert_eq!(say(&mut unit, &mut sheet, "ROUT:KLOS (@1001);*OPC?"), None);
    assert_eq!(unit.errors_waiting(), 3);
}

fn fragment() -> impl Strategy<Value = String> {
    prop_oneof![
        prop::sample::select(vec![
            "*RST",
            "*CLS",
            "*TRG",
            "*OPC?",
            "READ?",
            "INIT",
            "FETC?",
            "ABOR",
            "CONF:VOLT:DC 1,",
            "ROUT:CLOS ",
            "ROUT:OPEN ",
            "ROUT:CLOS? ",
            "ROUT:SCAN ",
            "ROUT:SCAN?",
            "VOLT:NPLC 10,",
            "(@1001:1070)",
            "(@1036)",
            "(@)",
            "(@1001:2001,8999)",
            ";",
            ";:",
            ",",
            "TRIG:COUN 3",
            "TRIG:SOUR BUS",
            "ROUT:OPEN:ALL",
            "SYST:ERR?",
            "FORM:READ:TIME ON",
            "MAX",
            "9.9E37",
        ])
        .prop_map(str::to_owned),
        ".{0,12}",
    ]
}

proptest! {
    #[test]
    fn any_messages_leave_the_simulator_consistent(
        messages in prop::collection::vec(prop::collection::vec(fragment(), 0..6), 0..30),
    ) {
        let mut settings = Settings34980a::default();
        for (slot, module) in ["34924A", "34932A", "34925A", "34934A,none"].iter().enumerate() {
            settings.slots[slot] = Some(module.parse::<Module>().unwrap());
        }
        let (mut unit, mut sheet) = (Simulator34980a::new(settings), Sheet::default());
        let mut at = Duration::ZERO;
        for message in messages {
            let response = unit.receive(&message.concat(), at, &mut sheet);
            prop_assert!(unit.errors_waiting() <= 20);
            prop_assert!(response.text.is_none_or(|text| !text.is_empty() && !text.contains('\n')));
            at += response.busy + Duration::from_millis(5);
        }
    }
}
