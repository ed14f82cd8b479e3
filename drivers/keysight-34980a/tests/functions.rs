//! Functions other than DC volts: the manual's CONFigure, MEASure and SENSe pages, against wires that are one resistor.

use std::collections::BTreeSet;
use std::time::Duration;

use keysight_34980a::{Alternating, MeterRequest, Module, Settings34980a, Simulator34980a, Wires};
use survey::{Amps, Ohms, Relay, Volts};

/// A resistor between the voltmeter's terminals, a battery in series with it, and an alternating voltage.
struct Circuit {
    ohms: f64,
    volts: f64,
    rms: f64,
    hertz: f64,
    requests: Vec<MeterRequest>,
    closed: BTreeSet<Relay>,
    /// The relays closed at the last reading.
    seen: BTreeSet<Relay>,
}

impl Wires for Circuit {
    fn relays(&mut self, closed: &BTreeSet<Relay>, _: Duration) {
        self.closed.clone_from(closed);
    }

    fn measure(&mut self, _: Duration, requested: MeterRequest) -> Volts {
        self.requests.push(requested);
        self.seen.clone_from(&self.closed);
        Volts(self.volts) + requested.test_current * Ohms(self.ohms)
    }

    fn alternating(&mut self, _: Duration, _: MeterRequest) -> Alternating {
        Alternating {
            rms: Volts(self.rms),
            hertz: self.hertz,
        }
    }
}

struct Talk(Simulator34980a, Circuit, Duration);

impl Talk {
    fn with(modules: &[&str], ohms: f64) -> Self {
        let mut settings = Settings34980a::default();
        for (slot, module) in settings.slots.iter_mut().zip(modules) {
            *slot = Some(module.parse::<Module>().unwrap());
        }
        let circuit = Circuit {
            ohms,
            volts: 0.0,
            rms: 0.0,
            hertz: 0.0,
            requests: Vec::new(),
            closed: BTreeSet::new(),
            seen: BTreeSet::new(),
        };
        Self(Simulator34980a::new(settings), circuit, Duration::ZERO)
    }

    fn say(&mut self, line: &str) -> String {
        let response = self.0.receive(line, self.2, &mut self.1);
        self.2 += response.busy;
        response.text.unwrap_or_default()
    }

    /// Sends one query after the other and checks each reply.
    fn holds(&mut self, talk: &[(&str, &str)]) {
        for (line, reply) in talk {
            assert_eq!(self.say(line), *reply, "{line}");
        }
        assert_eq!(self.say("SYST:ERR?"), "+0,\"No error\"");
    }

    fn refuses(&mut self, line: &str, error: &str) {
        assert_eq!(self.say(line), "", "{line}");
        assert!(self.say("SYST:ERR?").starts_with(error), "{line}");
    }
}

#[test]
fn resistance_is_the_test_current_through_the_circuit() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.holds(&[
        ("CONF:RES 1000,(@1001);:READ?", "+4.70000000E+02"),
        ("CONF:RES (@1001);:READ?", "+4.70000000E+02"),
        (
            "MEAS:RES? 1E3,(@1001:1002)",
            "+4.70000000E+02,+4.70000000E+02",
        ),
        ("CONF:RES 100,(@1001);:READ?", "+9.90000000E+37"),
        // resistance has its own questionable bit, section 7
        ("STAT:QUES?", "+512"),
        ("MEAS:RES? AUTO,(@1001)", "+4.70000000E+02"),
        ("FORM:READ:UNIT ON;:READ?", "+4.70000000E+02 OHM"),
    ]);
    assert_eq!(talk.1.requests.last().unwrap().test_current, Amps(1e-3));
    // an open circuit exceeds every range
    talk.1.ohms = f64::INFINITY;
    assert_eq!(talk.say("MEAS:RES? AUTO,(@1001)"), "+9.90000000E+37");
    // each range has its own test current; the circuit's own voltage adds to the reading
    talk.1.ohms = 5e4;
    talk.1.volts = 0.1;
    talk.holds(&[
        ("CONF:RES 1E5,(@1001);:READ?", "+6.00000000E+04"),
        ("RES:OCOM ON,(@1001);:READ?", "+5.00000000E+04"),
        ("RES:OCOM? (@1001);:FRES:OCOM? (@1001)", "1;1"),
    ]);
    talk.1.volts = -2.0;
    assert_eq!(
        talk.say("CONF:RES 1E3,(@1001);:RES:RANG 100,(@1001);:READ?"),
        "+9.90000000E+37"
    );
    talk.1.ohms = 100.0;
    assert_eq!(talk.say("CONF:RES 1E3,(@1001);:READ?"), "-9.90000000E+37");
}

#[test]
fn four_wires_take_a_channel_of_each_bank() {
    let mut talk = Talk::with(&["34924A", "34921A"], 470.0);
    talk.holds(&[
        ("CONF:FRES 1000,(@1002);:READ?", "+4.70000000E+02"),
        ("ROUT:SCAN?", "#17(@1002)"),
        ("FUNC? (@1002)", "\"FRES\""),
        ("CONF? (@1002)", "\"FRES +1.000000E+03,+3.000000E-03\""),
    ]);
    let seen: Vec<u32> = talk.1.seen.iter().map(|relay| relay.0).collect();
    assert_eq!(seen, [1002, 1037, 1911, 1922]);
    assert!(talk.1.closed.is_empty());
    assert!(talk.1.requests.iter().all(|requested| requested.four_wire));
    talk.say("CONF:FRES 1000,(@2003);:READ?");
    let seen: Vec<u32> = talk.1.seen.iter().map(|relay| relay.0).collect();
    assert_eq!(seen, [2003, 2023, 2911, 2922]);
    // channels of bank 2 can only be sensing channels
    talk.refuses("CONF:FRES 1000,(@1037)", "+308");
    talk.refuses("CONF:FRES (@1002);:ROUT:SCAN (@1002,1037)", "+306");
    // configured for two wires, a channel no longer needs its sensing partner
    talk.say("CONF:FRES (@1002);:CONF:RES (@1002,1037)");
    assert_eq!(
        talk.say("ROUT:SCAN?;:SYST:ERR?"),
        "#212(@1002,1037);+0,\"No error\""
    );
}

#[test]
fn currents_are_measured_on_current_channels_only() {
    let mut talk = Talk::with(&["34921A", "34924A"], 470.0);
    talk.holds(&[
        (
            "CONF:CURR:DC 0.1,(@1041:1042);:READ?",
            "+0.00000000E+00,+0.00000000E+00",
        ),
        (
            "FUNC? (@1041);:CURR:RANG? (@1041)",
            "\"CURR\";+1.00000000E-01",
        ),
        ("MEAS:CURR:AC? (@1044)", "+0.00000000E+00"),
        ("FORM:READ:UNIT ON;:READ?", "+0.00000000E+00 AAC"),
        ("ROUT:SCAN (@1043);:FUNC? (@1043)", "\"CURR\""),
        (
            "CURR:RANG? MIN;RANG? MAX",
            "+1.00000000E-02;+1.00000000E+00",
        ),
    ]);
    talk.refuses("CONF:CURR:DC (@1001)", "+308");
    talk.refuses("CONF:CURR:AC (@2001)", "+308");
    talk.refuses("CONF:VOLT:DC (@1041)", "+308");
    talk.refuses("CONF:RES (@1041)", "+308");
    talk.refuses("FUNC \"CURR\",(@2001)", "+308");
    talk.refuses("CONF:CURR:DC 3,(@1041)", "-222");
}

#[test]
fn what_alternates_is_read_as_volts_frequency_or_period() {
    let mut talk = Talk::with(&["34924A"], 0.0);
    talk.1.volts = 3.0;
    // a circuit with DC only reads zero
    assert_eq!(talk.say("MEAS:VOLT:AC? (@1001)"), "+0.00000000E+00");
    assert_eq!(talk.say("MEAS:FREQ? (@1001)"), "+0.00000000E+00");
    (talk.1.rms, talk.1.hertz) = (0.5, 80.0);
    talk.holds(&[
        ("MEAS:VOLT:AC? (@1001)", "+5.00000000E-01"),
        ("CONF:VOLT:AC 0.1,(@1001);:READ?", "+9.90000000E+37"),
        ("STAT:QUES?", "+1"),
        ("MEAS:FREQ? (@1001)", "+8.00000000E+01"),
        ("MEAS:PER? (@1001)", "+1.25000000E-02"),
        ("FORM:READ:UNIT ON;:READ?", "+1.25000000E-02 SEC"),
        (
            "VOLT:AC:BAND? (@1001);BAND? MIN;BAND? MAX;BAND? DEF",
            "+20;+3;+200;+20",
        ),
        ("VOLT:AC:BAND 150,(@1001);BAND? (@1001)", "+20"),
        ("FREQ:APER 0.5,(@1001);APER? (@1001)", "+1.00000000E+00"),
        ("FREQ:RANG:LOW 3,(@1001);LOW? (@1001)", "+3"),
        ("PER:VOLT:RANG 10,(@1001);RANG? (@1001)", "+1.00000000E+01"),
    ]);
    // the signal is below a tenth of the counter's range: too small to count
    assert_eq!(
        talk.say("CONF:FREQ (@1001);:FREQ:VOLT:RANG 10,(@1001);:READ?"),
        "+0.00000000E+00"
    );
    talk.refuses("CONF:FREQ 1,(@1001)", "-222");
    talk.refuses("VOLT:AC:NPLC 1,(@1001)", "-113");
    // the filter sets the delay of a scan: 7 s, 1 s, 0.12 s
    for (hertz, seconds) in [(3, 7.0), (20, 1.0), (200, 0.12)] {
        talk.say(&format!(
            "CONF:VOLT:AC (@1001);:VOLT:AC:BAND {hertz},(@1001)"
        ));
        let before = talk.2;
        talk.say("READ?");
        let took = (talk.2 - before).as_secs_f64();
        assert!(
            (seconds..seconds + 0.1).contains(&took),
            "{hertz} Hz: {took} s"
        );
    }
}

#[test]
fn temperatures_follow_from_what_transducers_give() {
    let mut talk = Talk::with(&["34921A", "34924A"], 138.5055);
    assert_eq!(talk.say("MEAS:TEMP? RTD,85,(@1001)")[..6], *"+1.000");
    assert_eq!(talk.say("MEAS:TEMP? FRTD,85,(@1001)")[..6], *"+1.000");
    talk.1.ohms = 5000.0;
    let read: f64 = talk.say("MEAS:TEMP? THER,5000,(@1001)").parse().unwrap();
    assert!((read - 25.0).abs() < 0.05, "{read}");
    let read: f64 = talk.say("UNIT:TEMP F,(@1001);:READ?").parse().unwrap();
    assert!((read - 77.0).abs() < 0.1, "{read}");
    talk.1.ohms = 0.0;
    talk.1.volts = 4.096e-3;
    let read: f64 = talk
        .say("UNIT:TEMP C,(@1001);:MEAS:TEMP? TC,K,(@1001)")
        .parse()
        .unwrap();
    assert!((read - 100.0).abs() < 0.1, "{read}");
    let read: f64 = talk
        .say("TEMP:TRAN:TC:RJUN 20,(@1001);:READ?")
        .parse()
        .unwrap();
    assert!((119.0..120.5).contains(&read), "{read}");
    talk.1.volts = 1.0;
    talk.holds(&[
        ("READ?", "+9.90000000E+37"),
        ("STAT:QUES?", "+1024"),
        ("CONF? (@1001)", "\"TEMP TC,K\""),
        (
            "TEMP:TRAN:TYPE? (@1001);TYPE THER,(@1001);TYPE? (@1001)",
            "TC;THER",
        ),
        (
            "TEMP:TRAN:RTD:RES? (@1001);RES? MIN",
            "+1.00000000E+02;+4.90000000E+01",
        ),
        ("TEMP:TRAN:TC:RJUN:TYPE INT,(@1001);TYPE? (@1001)", "INT"),
        (
            "TEMP:NPLC? DEF;:TEMP:ZERO:AUTO? (@1001)",
            "+1.00000000E+00;1",
        ),
    ]);
    talk.refuses("CONF:TEMP TC,X,(@1001)", "-224");
    talk.refuses("CONF:TEMP RTD,86,(@1001)", "-224");
    talk.refuses("CONF:TEMP RTD", "-109");
    talk.refuses("TEMP:TRAN:TC:RJUN:TYPE INT,(@2001)", "+308");
}

#[test]
fn each_function_keeps_its_own_settings() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.holds(&[
        ("VOLT:DC:NPLC 10,(@1001);:RES:NPLC 0.2,(@1001)", ""),
        (
            "VOLT:DC:NPLC? (@1001);:RES:NPLC? (@1001);:FRES:NPLC? (@1001)",
            "+1.00000000E+01;+2.00000000E-01;+2.00000000E-01",
        ),
        ("FUNC? (@1001)", "\"VOLT\""),
        (
            "FUNC \"RES\",(@1001);FUNC? (@1001);:RES:NPLC? (@1001)",
            "\"RES\";+2.00000000E-01",
        ),
        ("FUNC \"VOLTAGE:AC\",(@1001);:FUNC? (@1001)", "\"VOLT:AC\""),
        // CONF applies to one function and sets it to its defaults
        ("CONF:RES (@1001);:RES:NPLC? (@1001)", "+1.00000000E+00"),
        ("CONF? (@1001)", "\"RES AUTO\""),
        ("RES:RANG? MIN;RANG? MAX", "+1.00000000E+02;+1.00000000E+08"),
        (
            "RES:RANG 1500,(@1001);RANG? (@1001);:RES:RANG:AUTO? (@1001)",
            "+1.00000000E+04;0",
        ),
        (
            "RES:RES 0.1,(@1001);NPLC? (@1001);RES? (@1001)",
            "+2.00000000E-01;+1.00000000E-01",
        ),
        ("RES:APER 0.1,(@1001);APER:ENAB? (@1001)", "1"),
        (
            "*SAV 1;*RST;:RES:RANG? (@1001);*RCL 1;:RES:RANG? (@1001)",
            "+1.00000000E+08;+1.00000000E+04",
        ),
        // the voltmeter alone
        ("ROUT:SCAN (@);:CONF:RES 1000;:READ?", "+4.70000000E+02"),
        ("CONF?", "\"RES +1.000000E+03,+3.000000E-03\""),
        ("MEAS:VOLT:DC?", "+0.00000000E+00"),
    ]);
    talk.refuses("FUNC \"DIOD\",(@1001)", "-224");
    talk.refuses("CONF:DIOD", "-113");
    talk.refuses("FUNC VOLT", "-");
    talk.refuses("RES:RANG 1E9,(@1001)", "-222");
    talk.refuses("CONF:RES AUTO,0.1,(@1001)", "-221");
}

#[test]
fn settings_without_a_list_leave_the_channels_alone() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.holds(&[
        ("CONF:VOLT:DC 10,(@1001:1003);:VOLT:DC:NPLC 10", ""),
        (
            "VOLT:DC:NPLC? (@1001:1003);NPLC?",
            "+1.00000000E+00,+1.00000000E+00,+1.00000000E+00;+1.00000000E+01",
        ),
        ("CONF:RES 1E3;:FUNC? (@1001);FUNC?", "\"VOLT\";\"RES\""),
        ("CONF?", "\"RES +1.000000E+03,+3.000000E-03\""),
        (
            "CONF:VOLT:DC 0.1;:CONF? (@1002)",
            "\"VOLT +1.000000E+01,+3.000000E-05\"",
        ),
        // one reading of the internal voltmeter leaves the scan list unchanged
        ("MEAS:VOLT:DC?", "+0.00000000E+00"),
        ("MEAS:RES? 1E3", "+4.70000000E+02"),
        ("ROUT:SCAN:SIZE?;:DATA:POIN?", "+3;+1"),
        ("READ?", "+0.00000000E+00,+0.00000000E+00,+0.00000000E+00"),
        // a delay applies to channels only
        ("ROUT:CHAN:DEL 0.5;DEL? (@1003)", "+5.00000000E-01"),
    ]);
    let scanned = talk.1.requests.iter().filter(|one| one.channel.is_some());
    assert_eq!(scanned.count(), 3);
}

#[test]
fn commands_of_the_help_that_scripts_use_are_known() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.holds(&[
        (
            "CONF:SCAL:VOLT:DC 10,(@1001);:SENS1:VOLT:DC:RANG? (@1001)",
            "+1.00000000E+01",
        ),
        ("MEASure:SCALar:RESistance? 1E3,(@1001)", "+4.70000000E+02"),
        ("CONF:SCAL:RES 1E3,(@1001);:FUNC? (@1001)", "\"RES\""),
        ("VOLT:DC:APER:ENAB? (@1001);:VOLT:DC:APER:ENABLED?", "0;0"),
        ("CONF:RES 1E3,(@1001);:RES:ZERO:AUTO? (@1001)", "1"),
        ("RES:ZERO:AUTO ONCE,(@1001);AUTO? (@1001)", "0"),
        ("VOLT:DC:ZERO:AUTO ON,(@1001);AUTO? (@1001)", "1"),
        ("VOLT:DC:ZERO:AUTO ONCE,(@1001);AUTO? (@1001)", "0"),
    ]);
    talk.refuses("RES:ZERO:AUTO TWICE,(@1001)", "-224");
    talk.refuses("SENS2:VOLT:DC:RANG 1", "-113");
}

#[test]
fn integration_below_a_cycle_turns_autozero_off() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    for (set_up, autozero) in [
        ("CONF:VOLT:DC 10,(@1001)", "1"),
        ("CONF:VOLT:DC 10,1E-3,(@1001)", "0"),
        ("CONF:VOLT:DC 10,(@1001);:VOLT:DC:NPLC 0.2,(@1001)", "0"),
        ("CONF:VOLT:DC 10,(@1001);:VOLT:DC:NPLC 1,(@1001)", "1"),
        ("CONF:VOLT:DC 10,(@1001);:VOLT:DC:APER 0.01,(@1001)", "0"),
        ("CONF:VOLT:DC 10,(@1001);:VOLT:DC:RES 1E-3,(@1001)", "0"),
        ("CONF:RES 1E3,(@1001);:RES:NPLC 0.02,(@1001)", "0"),
        // autozero can be switched on again explicitly
        (
            "CONF:VOLT:DC 10,(@1001);:VOLT:DC:NPLC 0.2,(@1001);ZERO:AUTO ON,(@1001)",
            "1",
        ),
    ] {
        talk.say(set_up);
        assert_eq!(talk.say("VOLT:DC:ZERO:AUTO? (@1001)"), autozero, "{set_up}");
    }
    assert_eq!(talk.say("SYST:ERR?"), "+0,\"No error\"");
}

#[test]
fn selected_memory_is_recalled_at_power_on() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.say("CONF:VOLT:DC 100,(@1001:1002);:*SAV 2");
    talk.say("*RST;:MEM:STAT:REC:SEL 2");
    talk.0.power_cycle(talk.2, &mut talk.1);
    // state 2 is selected, but automatic recall is off
    talk.holds(&[("MEM:STAT:REC:SEL?;:ROUT:SCAN:SIZE?", "2;+0")]);
    talk.say("MEM:STAT:REC:AUTO ON");
    talk.0.power_cycle(talk.2, &mut talk.1);
    talk.holds(&[(
        "MEM:STAT:REC:AUTO?;:ROUT:SCAN:SIZE?;:VOLT:DC:RANG? (@1002);:SYST:ERR?",
        "1;+2;+1.00000000E+02;+0,\"No error\"",
    )]);
    talk.say("MEM:STAT:DEL 2");
    talk.0.power_cycle(talk.2, &mut talk.1);
    assert!(talk.say("SYST:ERR?").starts_with("+291"));
    talk.refuses("MEM:STAT:REC:SEL 6", "-222");
}

#[test]
fn memory_zero_is_that_of_the_power_down_state() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.refuses("*SAV 0", "-222");
    talk.refuses("*RCL 0", "+291");
    talk.say("CONF:VOLT:DC 100,(@1001:1002)");
    talk.0.power_cycle(talk.2, &mut talk.1);
    talk.holds(&[
        ("ROUT:SCAN:SIZE?", "+0"),
        (
            "*RCL 0;:ROUT:SCAN:SIZE?;:VOLT:DC:RANG? (@1002)",
            "+2;+1.00000000E+02",
        ),
    ]);
}

#[test]
fn samples_and_trigger_delay_follow_the_help() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.1.volts = 1.0;
    talk.holds(&[
        ("SAMP:COUN?;COUN? MAX;:TRIG:DEL:AUTO?", "+1;+500000;1"),
        (
            "CONF:VOLT:DC 10,(@1001:1002);:SAMP:COUN 2;:TRIG:COUN 2;:FORM:READ:CHAN ON;:READ?",
            "+1.00000000E+00,1001,+1.00000000E+00,1001,+1.00000000E+00,1002,+1.00000000E+00,1002,\
             +1.00000000E+00,1001,+1.00000000E+00,1001,+1.00000000E+00,1002,+1.00000000E+00,1002",
        ),
        // the relays of a channel close once for all its samples
        ("DIAG:REL:CYCL? (@1001)", "+2"),
        ("CONF:VOLT:DC 10;:SAMP:COUN?", "+1"),
        (
            "ROUT:SCAN (@);:SAMP:COUN 3;:TRIG:DEL 1.000001;DEL?;DEL:AUTO?",
            "+1.00000000E+00;0",
        ),
    ]);
    let before = talk.2;
    talk.say("READ?");
    // two triggers, each with its delay and three readings of two cycles of 20 ms, autozero on
    assert_eq!((talk.2 - before).as_micros(), 2 * (1_000_000 + 3 * 40_000));
    talk.holds(&[("TRIG:DEL:AUTO ON;:TRIG:DEL:AUTO?", "1")]);
    talk.refuses("SAMP:COUN 0", "-222");
    talk.refuses("TRIG:DEL 3601", "-222");
    talk.refuses("ROUT:SCAN (@1001:1070);:SAMP:COUN 500000;:READ?", "-225");
}

#[test]
fn labels_memories_and_voltmeter_follow_the_help() {
    let mut talk = Talk::with(&["34924A"], 470.0);
    talk.holds(&[
        ("ROUT:CHAN:LAB \"pressure of the pump\",(@1001,1911)", ""),
        ("ROUT:CHAN:LAB? (@1001,1002)", "\"pressure of the pu\",\"\""),
        (
            "*RST;:ROUT:CHAN:LABEL:DEFINE? USER,(@1911)",
            "\"pressure of the pu\"",
        ),
        ("MEM:STAT:VAL? 3;:MEM:NST?", "0;+6"),
        (
            "*SAV 3;:MEM:STAT:VAL? 3;:MEM:STAT:DEL 3;:MEM:STAT:VAL? 3",
            "1;0",
        ),
        ("MEM:STAT:REC:AUTO?;:MEM:STAT:REC:SEL?", "0;0"),
        ("SYST:COMM:LAN:MAC?", "\"00-30-D3-00-00-01\""),
        (
            "INST:DMM?;:INST:DMM OFF;:INST:DMM:STAT?;:INST:DMM:INST?",
            "1;0;1",
        ),
    ]);
    talk.refuses("CONF:VOLT:DC 10,(@1001)", "+305");
    talk.refuses("READ? (@1001)", "+305");
    talk.holds(&[("INST:DMM ON;:MEAS:VOLT:DC? 10,(@1001)", "+0.00000000E+00")]);
    talk.refuses("ROUT:CHAN:LAB? FACT,(@1001)", "-224");
    talk.refuses("ROUT:CHAN:LAB \"x\",(@1099)", "+112");
}
