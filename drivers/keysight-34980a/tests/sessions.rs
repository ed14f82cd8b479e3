//! Several clients at once, sequences, faults: effects of one session on another.

mod stand_in;

use std::time::Duration;

use keysight_34980a::{Protection, Session, Simulator34980a};
use scpi::ParseError;
use stand_in::{Sheet, mainframe, say};
use survey::Relay;

const START: Duration = Duration::from_secs(3);
const A: Session = Session(0);
const B: Session = Session(1);

fn ms(milliseconds: u64) -> Duration {
    START + Duration::from_millis(milliseconds)
}

fn ask(
    unit: &mut Simulator34980a,
    sheet: &mut Sheet,
    session: Session,
    message: &str,
    at: Duration,
) -> String {
    let response = unit.receive_from(session, message, at, sheet);
    response.text.unwrap_or_default()
}

#[test]
fn a_query_that_waits_keeps_only_its_own_session() {
    let (mut unit, mut sheet) = (mainframe(&["34922A"]), Sheet::default());
    ask(
        &mut unit,
        &mut sheet,
        A,
        "CONF:VOLT 10,(@1001:1010);:TRIG:SOUR TIM;TIM 1;COUN 3;:INIT",
        START,
    );
    let waiting = unit.receive_from(A, "*OPC?", START, &mut sheet);
    assert!(waiting.busy > Duration::from_secs(2), "{waiting:?}");
    let other = unit.receive_from(B, "*IDN?;:DATA:POIN?;:STAT:OPER:COND?", ms(500), &mut sheet);
    assert_eq!(other.busy, Duration::ZERO);
    let text = other.text.unwrap();
    assert!(text.ends_with(";+9;+16"), "{text}");
    // A message of A that arrives meanwhile is executed when A's pending query has been completed.
    let next = unit.receive_from(A, "STAT:OPER:COND?", ms(600), &mut sheet);
    assert_eq!(next.text.as_deref(), Some("+0"));
    assert_eq!(ms(600) + next.busy, START + waiting.busy);
}

#[test]
fn readings_of_anothers_read_appear_one_by_one() {
    let (mut unit, mut sheet) = (mainframe(&["34922A"]), Sheet::default());
    ask(
        &mut unit,
        &mut sheet,
        A,
        "CONF:VOLT 10,(@1001:1010);:READ?",
        START,
    );
    let points = |unit: &mut Simulator34980a, sheet: &mut Sheet, at| {
        ask(unit, sheet, B, "DATA:POIN?;:STAT:OPER:COND?", at)
    };
    // 1/rate - 0.02 PLC + 2 PLC + 1 ms of delay: 50.6 ms.
    assert_eq!(points(&mut unit, &mut sheet, ms(50)), "+0;+16");
    assert_eq!(points(&mut unit, &mut sheet, ms(254)), "+5;+16");
    assert_eq!(
        ask(&mut unit, &mut sheet, B, "INIT;:SYST:ERR?", ms(260)),
        "-213,\"Init ignored\""
    );
    assert_eq!(points(&mut unit, &mut sheet, ms(507)), "+10;+0");
}

#[test]
fn faults_of_a_session_are_in_the_error_queue() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    for fault in [
        ParseError::QueryInterrupted,
        ParseError::QueryUnterminated,
        ParseError::QueryDeadlocked,
    ] {
        unit.fault_of_session(fault);
    }
    let errors = "SYST:ERR?;:SYST:ERR?;:SYST:ERR?;:SYST:ERR?;*ESR?";
    assert_eq!(
        ask(&mut unit, &mut sheet, A, errors, ms(2)),
        "-410,\"Query INTERRUPTED\";-420,\"Query UNTERMINATED\";-430,\"Query DEADLOCKED\";\
         +0,\"No error\";+132"
    );
}

#[test]
fn one_session_at_a_time_holds_the_lock() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    unit.name_session(B, "LAN169.254.149.35");
    let mut say = |session, message| ask(&mut unit, &mut sheet, session, message, START);
    assert_eq!(
        say(A, "SYST:LOCK:NAME?;OWN?;REQ?;REQ?;OWN?"),
        "LAN1;NONE;+1;+1;LAN1"
    );
    assert_eq!(
        say(B, "SYST:LOCK:REQ?;NAME?;:STAT:OPER:COND?"),
        "+0;LAN169.254.149.35;+1024"
    );
    // Queries are allowed, changes and measurements are not.
    assert_eq!(say(B, "ROUT:CLOS (@1001);:ROUT:CLOS? (@1001)"), "0");
    assert_eq!(say(B, "READ?;:*RST;SYST:LOCK:REL"), "");
    assert_eq!(
        say(B, "SYST:ERR?;:SYST:ERR?;:SYST:ERR?;:SYST:ERR?"),
        "-203,\"Command protected\";-203,\"Command protected\";-203,\"Command protected\";\
         +0,\"No error\""
    );
    assert_eq!(
        say(A, "SYST:LOCK:REL;OWN?;REL;OWN?;:STAT:OPER:COND?"),
        "LAN1;NONE;+0"
    );
    assert_eq!(say(B, "SYST:LOCK:REQ?"), "+1");
    unit.end_session(B);
    assert_eq!(
        ask(&mut unit, &mut sheet, A, "SYST:LOCK:OWN?", START),
        "NONE"
    );
}

#[test]
fn a_sequence_runs_by_itself() {
    let (mut unit, mut sheet) = (mainframe(&["34932A"]), Sheet::default());
    let define =
        "ROUT:SEQ:DEF walk,\"ROUT:CLOS (@1101);:SYST:DEL 0.1;:ROUT:OPEN (@1101);CLOS (@1102)\"";
    ask(&mut unit, &mut sheet, A, define, START);
    let run = unit.receive(
        "ROUT:SEQ:TRIG WALK;BUSY?;:STAT:OPER:COND?",
        START,
        &mut sheet,
    );
    assert_eq!(
        (run.text.as_deref(), run.busy),
        (Some("1;+16384"), Duration::ZERO)
    );
    assert_eq!(unit.due(), Some(ms(4)));
    // Queries of relays wait for the end of the sequence; status queries get an immediate reply.
    assert_eq!(
        ask(&mut unit, &mut sheet, B, "STAT:OPER:COND?", ms(50)),
        "+16384"
    );
    assert_eq!(sheet.closed, [Relay(1101)].into());
    let answer = unit.receive("ROUT:CLOS? (@1101,1102)", ms(60), &mut sheet);
    assert_eq!(answer.text.as_deref(), Some("0,1"));
    assert_eq!(answer.busy, Duration::from_millis(112 - 60));
    assert_eq!(
        ask(
            &mut unit,
            &mut sheet,
            A,
            "STAT:OPER:COND?;:SYST:ERR?",
            ms(200)
        ),
        "+0;+0,\"No error\""
    );
    // Sequences are kept while power is off.
    unit.power_cycle(ms(300), &mut sheet);
    assert_eq!(sheet.closed, [Relay(1102)].into());
    let waited = unit.receive("ROUT:SEQ:TRIG WALK;:*OPC?", ms(300), &mut sheet);
    assert_eq!(waited.busy, Duration::from_millis(4 + 100 + 4));
}

#[test]
fn sequences_nest_four_deep_and_an_error_ends_them() {
    let (mut unit, mut sheet) = (mainframe(&["34932A"]), Sheet::default());
    for level in 1..=5 {
        let define = format!(
            "ROUT:SEQ:DEF S{level},\"ROUT:CLOS (@110{level});:ROUT:SEQ:TRIG S{}\"",
            level + 1
        );
        say(&mut unit, &mut sheet, &define);
    }
    say(
        &mut unit,
        &mut sheet,
        "ROUT:SEQ:DEF S6,\"ABOR\";:ROUT:SEQ:TRIG S3;:*OPC?",
    );
    assert_eq!(unit.errors_waiting(), 0);
    let answer = say(
        &mut unit,
        &mut sheet,
        "*RST;:ROUT:SEQ:TRIG S1;:*OPC?;:SYST:ERR?",
    );
    assert_eq!(answer.as_deref(), Some("1;-276,\"Macro recursion error\""));
    assert_eq!(sheet.closed, [1101, 1102, 1103, 1104].map(Relay).into());
    let answer = say(
        &mut unit,
        &mut sheet,
        "ROUT:SEQ:DEL S6;:ROUT:SEQ:TRIG S6;:SYST:ERR?",
    );
    assert_eq!(
        answer.as_deref(),
        Some("-292,\"Referenced name does not exist\"")
    );
    // Channels are checked when the sequence runs.
    let bad = "ROUT:SEQ:DEF BAD,\"ROUT:CLOS (@1199);CLOS (@1101)\";:SYST:ERR?";
    assert_eq!(
        say(&mut unit, &mut sheet, bad).as_deref(),
        Some("+0,\"No error\"")
    );
    let answer = say(
        &mut unit,
        &mut sheet,
        "*RST;:ROUT:SEQ:TRIG BAD;WAIT;:SYST:ERR?",
    );
    assert!(answer.unwrap().starts_with("+112,"));
    assert!(sheet.closed.is_empty());
}

#[test]
fn without_a_voltmeter_relays_still_move() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    unit.set_voltmeter(false, START, &mut sheet);
    assert_eq!(
        say(&mut unit, &mut sheet, "CONF:VOLT:DC 1,(@1001);:READ?"),
        None
    );
    let answer = say(
        &mut unit,
        &mut sheet,
        "SYST:ERR?;:SYST:ERR?;:INST:DMM:INST?",
    );
    let missing = "-241,\"Hardware missing\"";
    assert_eq!(answer, Some(format!("{missing};{missing};0")));
    let answer = say(&mut unit, &mut sheet, "ROUT:CLOS (@1036);CLOS? (@1036)");
    assert_eq!(answer.as_deref(), Some("1"));
    unit.set_voltmeter(true, START, &mut sheet);
    assert!(say(&mut unit, &mut sheet, "CONF:VOLT:DC 1,(@1001);:READ?").is_some());
}

#[test]
fn an_emptied_slot_takes_its_relays_and_channels_with_it() {
    let (mut unit, mut sheet) = (mainframe(&["34924A", "34924A"]), Sheet::default());
    say(
        &mut unit,
        &mut sheet,
        "ROUT:CLOS (@1036,2036);:CONF:VOLT 1,(@1001,2001)",
    );
    unit.set_module(1, None, START, &mut sheet);
    assert_eq!(sheet.closed, [Relay(2036)].into());
    let answer = say(
        &mut unit,
        &mut sheet,
        "SYST:CTYP? 1;:ROUT:SCAN?;:ROUT:CLOS (@1036);:SYST:ERR?",
    );
    assert_eq!(
        answer.as_deref(),
        Some(
            "Agilent Technologies,0,0,0;#17(@2001);\
             +111,\"Channel list: slot number out of range\""
        )
    );
}

#[test]
fn an_open_terminal_block_keeps_the_buses_open() {
    let (mut unit, mut sheet) = (mainframe(&["34924A", "34934A,8x64"]), Sheet::default());
    say(&mut unit, &mut sheet, "ROUT:CLOS (@1036,1912,1921)");
    for slot in [1, 2] {
        unit.set_interlock(slot, true, START, &mut sheet);
    }
    assert_eq!(sheet.closed, [Relay(1036)].into());
    let answer = say(&mut unit, &mut sheet, "SYST:MOD:TERM:TYPE? 2;:SYST:CTYP? 2");
    assert_eq!(
        answer.as_deref(),
        Some("NONE;Agilent Technologies,34934A-8x64,MY44900002,1.00")
    );
    for list in ["(@1911)", "(@2101)"] {
        let answer = say(
            &mut unit,
            &mut sheet,
            &format!("ROUT:CLOS {list};:SYST:ERR?"),
        );
        assert!(answer.unwrap().starts_with("+305,"));
    }
    unit.set_interlock(2, false, START, &mut sheet);
    let answer = say(
        &mut unit,
        &mut sheet,
        "ROUT:CLOS (@2101);CLOS? (@2101);:SYST:MOD:TERM:TYPE? 2",
    );
    assert_eq!(answer.as_deref(), Some("1;R8_R64"));
    assert_eq!(unit.protection(2), Some(Protection::Auto100));
}

#[test]
fn commands_may_overlap_with_relays_that_move() {
    let (mut unit, mut sheet) = (mainframe(&["34932A", "34924A"]), Sheet::default());
    let message = "ROUT:OPER:OVER ON;:ROUT:CLOS (@1101);CLOS (@1102);CLOS (@2001);:ROUT:MOD:BUSY? 1;BUSY? ANY;:ROUT:OPER:OVER?";
    let answer = unit.receive(message, START, &mut sheet);
    assert_eq!(
        (answer.text.as_deref(), answer.busy),
        (Some("1;1;1"), Duration::ZERO)
    );
    let wait = unit.receive("ROUT:MOD:WAIT 2;BUSY? 2;BUSY? 1", START, &mut sheet);
    assert_eq!(
        (wait.text.as_deref(), wait.busy),
        (Some("0;1"), Duration::from_micros(500))
    );
    let wait = unit.receive("*OPC?;:ROUT:MOD:BUSY?", START, &mut sheet);
    assert_eq!(
        (wait.text.as_deref(), wait.busy),
        (Some("1;0"), Duration::from_millis(8))
    );
}

#[test]
fn an_overflown_error_queue_ends_with_its_own_number() {
    let (mut unit, mut sheet) = (mainframe(&[]), Sheet::default());
    unit.overflow_errors();
    assert_eq!(unit.errors_waiting(), 20);
    for _ in 0..19 {
        assert_eq!(
            say(&mut unit, &mut sheet, "SYST:ERR?").as_deref(),
            Some("-102,\"Syntax error\"")
        );
    }
    assert_eq!(
        say(&mut unit, &mut sheet, "SYST:ERR?;:SYST:ERR?").as_deref(),
        Some("-350,\"Queue overflow\";+0,\"No error\"")
    );
}

#[test]
fn a_trigger_may_come_before_a_busy_session_waits_for_it() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    let set = "CONF:VOLT 10,(@1001);:TRIG:SOUR BUS;:SYST:DEL 1;:INIT";
    ask(&mut unit, &mut sheet, A, set, START);
    // by A's clock the measurement has yet to begin
    assert_eq!(
        ask(&mut unit, &mut sheet, B, "*TRG;:SYST:ERR?", ms(500)),
        "+0,\"No error\""
    );
    let readings = ask(&mut unit, &mut sheet, B, "DATA:POIN?", ms(1045));
    assert_eq!(readings, "+1");
}

#[test]
fn a_reading_that_is_waited_for_is_taken_when_it_is_due() {
    let (mut unit, mut sheet) = (mainframe(&["34924A"]), Sheet::default());
    ask(&mut unit, &mut sheet, A, "CONF:VOLT 10,(@1001:1002)", START);
    sheet.volts = Some(1.0);
    let (begun, later) = unit.begin_from(A, "*ESE?;:READ?", ms(0), &mut sheet);
    assert!(later && begun.text.is_none(), "{begun:?}");
    assert_eq!(begun.busy, Duration::from_micros(85_200));
    unit.pass(ms(60), &mut sheet);
    sheet.volts = Some(2.0);
    // a query of another session is not delayed, and its reply is not delivered to A
    let (other, later) = unit.begin_from(B, "*IDN?", ms(70), &mut sheet);
    assert!(!later && other.text.is_some());
    assert_eq!(unit.fetch(B, ms(70), &mut sheet), None);
    let answer = unit.fetch(A, ms(86), &mut sheet);
    assert_eq!(
        answer.as_deref(),
        Some("+0;+1.00000000E+00,+2.00000000E+00")
    );
    assert_eq!(unit.fetch(A, ms(90), &mut sheet), None);
    // the reply to a client that has disconnected is dropped
    assert!(unit.begin_from(A, "READ?", ms(100), &mut sheet).1);
    unit.end_session(A);
    assert_eq!(unit.fetch(A, ms(300), &mut sheet), None);
    assert_eq!(ask(&mut unit, &mut sheet, B, "DATA:POIN?", ms(300)), "+2");
}
