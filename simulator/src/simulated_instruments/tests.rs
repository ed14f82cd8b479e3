//! Endless scans of the simulated mainframe after a long time without messages.

use phantom::Scene;

use crate::instrument::of_memory;
use crate::simulated_instruments::*;

const SCAN: &str = "CONF:VOLT:DC 10,(@1001:1003);:VOLT:DC:ZERO:AUTO OFF,(@1001:1003);:ROUT:CLOS (@1036);\
    :TRIG:COUN INF;:FORM:READ:TIME ON;CHAN ON;:INIT";

/// Instruments with a mainframe that holds this number of readings, scanning without end.
fn scanning(scene: &str, memory: usize) -> SimulatedInstruments {
    let profile = Profile::default().at_pace(Pace::Instant);
    let phantom = Phantom::new(Scene::parse("test.toml", scene).unwrap()).unwrap();
    let mut scanning = SimulatedInstruments::new(&profile, phantom, Vec::new());
    scanning.place_mut(Instrument::Mainframe).instrument = of_memory(&profile, memory);
    ask(&mut scanning, Instrument::Source, "SOUR:CURR 1e-3;:OUTP ON");
    ask(&mut scanning, Instrument::Mainframe, SCAN);
    scanning
}

fn ask(instruments: &mut SimulatedInstruments, role: Instrument, line: &str) -> String {
    let reply = instruments.receive(role, 0, line, ReplyTiming::AtOnce);
    reply.text.unwrap_or_default()
}

/// Advances the time in steps, performs what is due after each, and queries the state of both instruments.
fn after(instruments: &mut SimulatedInstruments, time: Duration, steps: u32) -> [String; 2] {
    for _ in 0..steps {
        instruments.advance(time / steps);
        instruments.catch_up();
    }
    [
        (
            Instrument::Mainframe,
            "DATA:POIN?;:STAT:QUES:COND?;EVEN?;:STAT:OPER:COND?;EVEN?;:SYST:ERR?;:FETC?;\
             :DIAG:REL:CYCL? (@1001:1003,1911)",
        ),
        (Instrument::Source, "STAT:MEAS:COND?;EVEN?;:SYST:ERR?"),
    ]
    .map(|(role, line)| ask(instruments, role, line))
}

#[test]
fn hours_of_an_endless_scan_cost_one_memory_of_readings() {
    let mut instruments = scanning("", 100);
    instruments.advance(Duration::from_secs(3600));
    assert_eq!(
        ask(&mut instruments, Instrument::Mainframe, "DATA:POIN?"),
        "+100"
    );
    let taken = instruments.messages(Instrument::Mainframe).readings;
    assert!(taken < 120, "{taken}");
}

#[test]
fn a_long_wait_ends_as_many_short_ones_do() {
    let wear = "[effects.wear]\nlife_closures = 300\nshape = 20\nclosed_percent = 0";
    let time = Duration::from_secs(60);
    let worn = |steps| {
        let mut instruments = scanning(wear, 60);
        let state = after(&mut instruments, time, steps);
        let relays = [1001, 1002, 1003, 1911, 1036].map(Relay);
        (state, relays.map(|relay| instruments.sheet.is_stuck(relay)))
    };
    let (slow, fast) = (worn(2000), worn(1));
    assert_eq!(slow, fast);
    assert_eq!(fast.1, [true, true, true, true, false]);
}

#[test]
fn noise_is_the_same_where_no_reading_is_skipped() {
    let noise = "[effects.voltmeter-noise]\nuv = 20";
    let time = Duration::from_secs(2);
    let noisy = |steps| after(&mut scanning(noise, 1000), time, steps);
    assert_eq!(noisy(200), noisy(1));
}
