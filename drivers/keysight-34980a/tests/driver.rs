//! The driver against the simulator over a pipe: the same bytes as over TCP, in a time that a test's clock makes short.

mod stand_in;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use keysight_34980a::{Keysight34980a, Settings34980a, Simulator34980a};
use rig::{Hop, Link, LinkError, MeterSettings, Move, RigError, Sample, Switch, Voltmeter};
use scpi::Framer;
use stand_in::{Sheet, mainframe};
use survey::{Reading, Relay, Volts, Wiring};
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::time::Instant;

/// A mainframe, its sheet, and what it has heard.
struct Bench {
    unit: Simulator34980a,
    sheet: Sheet,
    heard: Vec<String>,
    /// What is answered to a message with this end, instead of the truth. An empty text stands for silence.
    lies: Vec<(&'static str, &'static str)>,
}

#[derive(Clone)]
struct Shared(Arc<Mutex<Bench>>);

impl Shared {
    fn of(unit: Simulator34980a) -> Self {
        Self(Arc::new(Mutex::new(Bench {
            unit,
            sheet: Sheet::default(),
            heard: Vec::new(),
            lies: Vec::new(),
        })))
    }

    fn lie(&self, end: &'static str, answer: &'static str) {
        self.0.lock().unwrap().lies.push((end, answer));
    }

    fn truth(&self) {
        self.0.lock().unwrap().lies.clear();
    }

    /// What was heard since the last time.
    fn heard(&self) -> Vec<String> {
        std::mem::take(&mut self.0.lock().unwrap().heard)
    }

    /// Does something to the mainframe behind the driver's back.
    fn say(&self, message: &str) {
        let bench = &mut *self.0.lock().unwrap();
        bench.unit.hear(message, Duration::ZERO, &mut bench.sheet);
    }

    fn closed(&self) -> Vec<u32> {
        let bench = self.0.lock().unwrap();
        bench.unit.closed().iter().map(|relay| relay.0).collect()
    }

    fn plug(&self) -> Link<DuplexStream> {
        let (here, mut there) = tokio::io::duplex(4096);
        let shared = self.clone();
        let start = Instant::now();
        tokio::spawn(async move {
            let mut framer = Framer::new(65536);
            let mut bytes = [0; 512];
            while let Ok(count @ 1..) = there.read(&mut bytes).await {
                framer.push(&bytes[..count]);
                for line in framer.by_ref() {
                    let line = String::from_utf8(line.unwrap()).unwrap();
                    let (text, busy) = {
                        let bench = &mut *shared.0.lock().unwrap();
                        bench.heard.push(line.clone());
                        let answer = bench.unit.hear(&line, start.elapsed(), &mut bench.sheet);
                        let lie = bench.lies.iter().find(|(end, _)| line.ends_with(end));
                        match lie {
                            Some((_, "")) => (None, answer.busy),
                            Some((_, text)) => (Some((*text).to_owned()), answer.busy),
                            None => (answer.text, answer.busy),
                        }
                    };
                    // The instrument's own time; the test's clock does not wait.
                    tokio::time::sleep(busy).await;
                    if let Some(text) = text {
                        there
                            .write_all(format!("{text}\n").as_bytes())
                            .await
                            .unwrap_or(());
                    }
                }
            }
        });
        Link::new(here, "34980A in a test", Duration::from_secs(2))
    }
}

/// The end of every message that measures.
const READ: &str = "READ?;:SYST:ERR?";

const METER: MeterSettings = MeterSettings::new(Volts(100.0), 1.0);

fn relays(numbers: impl IntoIterator<Item = u32>) -> Vec<Relay> {
    numbers.into_iter().map(Relay).collect()
}

fn close(numbers: &[u32]) -> Move {
    Move::Close(relays(numbers.iter().copied()))
}

fn open(numbers: &[u32]) -> Move {
    Move::Open(relays(numbers.iter().copied()))
}

async fn connected(modules: &[&str]) -> (Shared, Keysight34980a<DuplexStream>) {
    let shared = Shared::of(mainframe(modules));
    let unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    shared.heard();
    (shared, unit)
}

#[tokio::test(start_paused = true)]
async fn pair_wiring_costs_26_reading_messages_of_one_segment_each() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let scan = relays(1001..=1026);
    meter.prepare(METER, &scan).await.unwrap();
    let preparation = shared.heard();
    assert_eq!(preparation[0], "*RST;*CLS;:SYST:ERR?");
    assert_eq!(preparation[1], "CONF:VOLT:DC 100,(@1001:1026);:SYST:ERR?");
    for setting in [
        "VOLT:DC:NPLC 1,(@1001:1026);:SYST:ERR?",
        "ROUT:CHAN:DEL 0,(@1001:1026);:SYST:ERR?",
        "ZERO:AUTO OFF,(@1001:1026);:SYST:ERR?",
        "INP:IMP:AUTO ON,(@1001:1026);:SYST:ERR?",
        "TRIG:COUN 1;:SYST:ERR?",
        "FORM:READ:UNIT OFF;:SYST:ERR?",
        "ROUT:SCAN?",
    ] {
        assert!(preparation.iter().any(|said| said == setting), "{setting}");
    }

    switch
        .move_relays(&[close(&[1036]), open(&[])])
        .await
        .unwrap();
    assert_eq!(shared.heard(), ["ROUT:CLOS (@1036);*OPC?"]);
    assert_eq!(shared.closed(), [1036]);
    for pair in 0..26 {
        if pair > 0 {
            let moves = [close(&[1036 + pair]), open(&[1035 + pair])];
            switch.move_relays(&moves).await.unwrap();
            assert_eq!(shared.heard(), [""; 0]);
        }
        let readings = meter.scan().await.unwrap();
        let expected: Vec<Reading> = (1..=26)
            .map(|channel| f64::from(pair + 1) + f64::from(channel) * 1e-3)
            .map(|volts| format!("{volts:.8e}").parse().unwrap())
            .map(|volts| Reading::Ok(Volts(volts)))
            .collect();
        assert_eq!(readings, expected);
        let said = match pair {
            0 => "READ?;:SYST:ERR?".to_owned(),
            _ => format!(
                "ROUT:CLOS (@{});:ROUT:OPEN (@{});:READ?;:SYST:ERR?",
                1036 + pair,
                1035 + pair
            ),
        };
        assert_eq!(shared.heard(), [said]);
    }
    switch.open_verified(&relays(1036..=1061)).await.unwrap();
    assert_eq!(
        shared.heard(),
        ["ROUT:OPEN (@1036:1061);:ROUT:CLOS? (@1036:1061)"]
    );
    assert!(shared.closed().is_empty());

    // The next frame with the same settings only reads back; nothing is reset.
    meter.prepare(METER, &scan).await.unwrap();
    assert!(
        shared
            .heard()
            .iter()
            .all(|said| said.ends_with('?') || said.contains("? "))
    );
}

#[tokio::test(start_paused = true)]
async fn matrix_wiring_reads_the_bare_voltmeter_behind_the_bus_relay() {
    let (shared, mut switch) = connected(&["34932A,4x32"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &[]).await.unwrap();
    assert!(
        shared
            .heard()
            .iter()
            .any(|said| said.starts_with("CONF:VOLT:DC 100,(@)"))
    );
    switch.move_relays(&[close(&[1921])]).await.unwrap();
    switch.move_relays(&[close(&[1201])]).await.unwrap();
    switch.move_relays(&[close(&[1103])]).await.unwrap();
    shared.heard();
    assert_eq!(meter.read().await.unwrap(), Reading::Ok(Volts(1.103)));
    switch
        .move_relays(&[open(&[1103]), close(&[1501])])
        .await
        .unwrap();
    assert_eq!(meter.read().await.unwrap(), Reading::Ok(Volts(1.501)));
    assert_eq!(
        shared.heard(),
        [
            "READ?;:SYST:ERR?",
            "ROUT:OPEN (@1103);:ROUT:CLOS (@1501);:READ?;:SYST:ERR?"
        ]
    );
    assert!(matches!(meter.scan().await, Err(RigError::Unable { .. })));
}

#[tokio::test(start_paused = true)]
async fn readings_come_in_the_order_asked_for_though_the_instrument_scans_ascending() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter
        .prepare(METER, &relays([1005, 1001, 1003]))
        .await
        .unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    let expected = [1.005, 1.001, 1.003].map(|volts| Reading::Ok(Volts(volts)));
    assert_eq!(meter.scan().await.unwrap(), expected);
    assert!(
        shared
            .heard()
            .iter()
            .any(|said| said.contains("(@1001,1003,1005)"))
    );
}

#[tokio::test(start_paused = true)]
async fn an_overload_is_a_gap_and_a_wrong_count_is_no_readings_at_all() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let volts = MeterSettings {
        range: Volts(1.0),
        ..METER
    };
    meter.prepare(volts, &relays(1001..=1003)).await.unwrap();
    switch.move_relays(&[close(&[1037])]).await.unwrap();
    assert_eq!(meter.scan().await.unwrap(), [Reading::Overload; 3]);
    // not a number, and a number that no voltmeter can read on its 1 V range
    shared.lie(
        READ,
        "+1.00000000E+00,+9.91000000E+37,+5.00000000E+03;+0,\"No error\"",
    );
    assert_eq!(
        meter.scan().await.unwrap(),
        [
            Reading::Ok(Volts(1.0)),
            Reading::Overload,
            Reading::Overload
        ]
    );
    for answer in [
        "+1.00000000E+00,+1.00000000E+00",
        "+1.0E+00,+1.0E+00,+1.0E+00,+1.0E+00",
        "+1.0E+00,,+1.0E+00",
        "+1.0E+00,1.0 VDC,+1.0E+00",
        "none",
    ] {
        shared.truth();
        shared.lie(READ, answer);
        let refusal = meter.scan().await.unwrap_err();
        assert!(matches!(refusal, RigError::Garbled { .. }), "{answer}");
        shared.truth();
        let answer: &'static str = format!("{answer};+0,\"No error\"").leak();
        shared.lie(READ, answer);
        let refusal = meter.scan().await.unwrap_err();
        assert!(matches!(refusal, RigError::Garbled { .. }), "{answer}");
        assert!(refusal.to_string().contains("3 number"), "{refusal}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_long_scan_is_waited_for_and_silence_is_not() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let slow = MeterSettings {
        nplc: 10.0,
        autozero: true,
        ..METER
    };
    meter.prepare(slow, &relays(1001..=1026)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    // 26 readings of 0.4 s each are far over the link's own 2 s.
    assert_eq!(meter.scan().await.unwrap().len(), 26);
    shared.lie(READ, "");
    let begun = Instant::now();
    let fault = meter.scan().await.unwrap_err();
    assert!(matches!(fault, RigError::Link(LinkError::Timeout { .. })));
    assert!(
        begun.elapsed() < Duration::from_secs(20),
        "{:?}",
        begun.elapsed()
    );
}

#[tokio::test(start_paused = true)]
async fn another_instrument_is_refused_and_both_names_of_the_maker_are_taken() {
    let mut settings = Settings34980a {
        vendor: "Keysight Technologies".to_owned(),
        ..Settings34980a::default()
    };
    settings.slots[2] = Some("34934A,8x64".parse().unwrap());
    let shared = Shared::of(Simulator34980a::new(settings));
    let unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    assert!(unit.identity().starts_with("Keysight Technologies,34980A"));
    assert_eq!(unit.modules()[2], Some("34934A,8x64".parse().unwrap()));
    assert_eq!(unit.cards()[0], None);

    for identity in [
        "Agilent Technologies,34970A,0,1",
        "KEITHLEY INSTRUMENTS INC.,MODEL 6221,1,A",
        "Acme,34980A,0,1",
        "",
        "34980A",
    ] {
        let shared = Shared::of(mainframe(&[]));
        // A blank is no silence.
        let answer = if identity.is_empty() { " " } else { identity };
        shared.lie("*IDN?", answer);
        let refusal = Keysight34980a::connect(shared.plug()).await.unwrap_err();
        assert!(
            matches!(refusal, RigError::WrongInstrument { .. }),
            "{identity}"
        );
        assert!(refusal.to_string().contains("34980A"), "{refusal}");
    }
}

#[tokio::test(start_paused = true)]
async fn quoted_and_unknown_cards_are_read() {
    let shared = Shared::of(mainframe(&[]));
    shared.lie("SYST:CTYP? 1", "\"Agilent Technologies,34924A,0,1.0\"");
    shared.lie("SYST:CTYP? 2", "Agilent Technologies,34952A,0,1.0");
    shared.lie("SYST:CTYP? 3", "nonsense");
    assert!(matches!(
        Keysight34980a::connect(shared.plug()).await,
        Err(RigError::Garbled { .. })
    ));
    shared.0.lock().unwrap().lies.pop();
    let unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    assert_eq!(unit.modules()[0], Some("34924A".parse().unwrap()));
    assert_eq!(
        (unit.modules()[1], unit.cards()[1].as_deref()),
        (None, Some("34952A"))
    );
    let fault = unit
        .check_wiring(&Wiring::pairs_34924a(2, 26).unwrap())
        .unwrap_err();
    assert_eq!(
        fault.to_string(),
        "34980A in a test: slot 2 holds a 34952A, the wiring needs a module with channel 36: relay 2036 joins electrodes 1 \
         and 2 to the source"
    );
}

#[tokio::test(start_paused = true)]
async fn a_wiring_is_checked_against_the_modules_before_anything_moves() {
    let (shared, mut unit) = connected(&["34924A", "34932A"]).await;
    unit.check_wiring(&Wiring::pairs_34924a(1, 35).unwrap())
        .unwrap();
    unit.check_wiring(&Wiring::matrix_34932a(2, 32).unwrap())
        .unwrap();
    for wiring in [
        Wiring::pairs_34924a(2, 26).unwrap(),
        Wiring::pairs_34924a(3, 26).unwrap(),
        Wiring::matrix_34932a(1, 26).unwrap(),
        Wiring::gpio_board(26).unwrap(),
    ] {
        assert!(unit.check_wiring(&wiring).is_err(), "{}", wiring.name);
    }
    let planned = |slot: u32, module: &str| [(slot, module.parse().unwrap())].into();
    unit.check_modules(&planned(2, "34932A")).unwrap();
    for (slot, module, found) in [(1, "34922A", "a 34924A"), (3, "34924A", "no module")] {
        let fault = unit.check_modules(&planned(slot, module)).unwrap_err();
        assert_eq!(
            fault.to_string(),
            format!("34980A in a test: slot {slot} holds {found}, the wiring needs a {module}")
        );
    }
    assert!(unit.move_relays(&[close(&[1071])]).await.is_err());
    assert!(unit.prepare(METER, &relays([2101])).await.is_err());
    assert!(unit.prepare(METER, &relays([1001, 1001])).await.is_err());
    assert!(matches!(
        unit.prepare(
            MeterSettings {
                range: Volts(2.0),
                ..METER
            },
            &[]
        )
        .await,
        Err(RigError::VoltageOutOfRange { .. })
    ));
    assert!(
        unit.prepare(MeterSettings { nplc: 3.0, ..METER }, &[])
            .await
            .is_err()
    );
    assert_eq!(shared.heard(), [""; 0]);
}

#[tokio::test(start_paused = true)]
async fn relays_left_closed_are_found_so_and_opened_in_one_message() {
    let shared = Shared::of(mainframe(&["34924A"]));
    shared.say("ROUT:CLOS (@1036,1040)");
    let mut unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    let asked = relays([1036, 1037, 1040]);
    assert_eq!(unit.closed(&asked).await.unwrap(), [true, false, true]);
    shared.heard();
    // A move that is held back when things go wrong closes nothing on the way to safety.
    unit.move_relays(&[close(&[1037]), open(&[1036])])
        .await
        .unwrap();
    unit.open_verified(&asked).await.unwrap();
    assert_eq!(
        shared.heard()[0],
        "ROUT:OPEN (@1036);:ROUT:OPEN (@1036,1037,1040);:ROUT:CLOS? (@1036,1037,1040)"
    );
    assert!(shared.closed().is_empty());
    shared.lie("ROUT:CLOS? (@1036,1037,1040)", "0,0,1");
    assert!(matches!(
        unit.open_verified(&asked).await,
        Err(RigError::StillClosed { relays, .. }) if relays == [Relay(1040)]
    ));
}

#[tokio::test(start_paused = true)]
async fn a_refused_move_fails_its_own_message_and_is_named() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1026)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    // Channel 30 lies in the scanned bank.
    switch
        .move_relays(&[close(&[1030]), open(&[1036])])
        .await
        .unwrap();
    let refusal = meter.scan().await.unwrap_err();
    assert!(
        matches!(refusal, RigError::Refused { code: 301, .. }),
        "{refusal}"
    );
    let told = refusal.to_string();
    assert!(
        told.contains(
            "refused 'ROUT:CLOS (@1030)' in 'ROUT:CLOS (@1030);:ROUT:OPEN (@1036);:READ?"
        ),
        "{told}"
    );
    // The queue is empty again, and the next preparation sets everything anew.
    shared.heard();
    switch.open_verified(&relays([1030, 1036])).await.unwrap();
    assert_eq!(shared.heard().len(), 1);
    meter.prepare(METER, &relays(1001..=1026)).await.unwrap();
    assert!(shared.heard()[0].starts_with("CONF:VOLT:DC 100"));
    meter.scan().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn a_refused_reading_answers_nothing_and_is_told_by_its_error() {
    let (shared, switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1003)).await.unwrap();
    for (code, text) in [(-221, "Settings conflict; perhaps"), (723, "Strange")] {
        let answer: &'static str = format!("{code},\"{text}\"").leak();
        shared.lie(READ, answer);
        let refusal = meter.scan().await.unwrap_err();
        assert!(
            matches!(&refusal, RigError::Refused { code: told, command, .. }
                if *told == code && command == "READ?' in 'READ?;:SYST:ERR?"),
            "{refusal}"
        );
        shared.truth();
    }
}

#[tokio::test(start_paused = true)]
async fn each_channel_is_scanned_on_its_own_range_set_in_the_same_message_where_it_changes() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1004)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    shared.heard();
    let on = |ranges: [f64; 4]| -> Vec<Sample> {
        (1001..)
            .zip(ranges)
            .map(|(relay, range)| Sample {
                relay: Relay(relay),
                range: Volts(range),
            })
            .collect()
    };
    // 1.001 to 1.004 V behind the four channels
    let readings = meter.scan_on(&on([10.0, 0.1, 10.0, 100.0])).await.unwrap();
    assert_eq!(readings[1], Reading::Overload);
    assert!(readings[0].is_ok() && readings[2].is_ok() && readings[3].is_ok());
    assert_eq!(
        shared.heard(),
        ["VOLT:DC:RANG 10,(@1001,1003);:VOLT:DC:RANG 0.1,(@1002);:READ?;:SYST:ERR?"]
    );
    meter.scan_on(&on([10.0, 10.0, 10.0, 100.0])).await.unwrap();
    assert_eq!(
        shared.heard(),
        ["VOLT:DC:RANG 10,(@1002);:READ?;:SYST:ERR?"]
    );
    // The next frame finds them as they were left, and says so to nobody.
    meter.prepare(METER, &relays(1001..=1004)).await.unwrap();
    assert!(shared.heard().iter().all(|said| !said.contains("RANG 1")));
    assert!(matches!(
        meter.scan_on(&on([10.0, 2.0, 10.0, 100.0])).await,
        Err(RigError::VoltageOutOfRange { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn a_shorter_scan_has_its_list_in_the_same_message_and_a_stranger_is_refused() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1006)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    shared.heard();
    let of = |numbers: &[u32]| -> Vec<Sample> {
        let sample = |relay| Sample {
            relay,
            range: Volts(100.0),
        };
        relays(numbers.iter().copied())
            .into_iter()
            .map(sample)
            .collect()
    };
    let short = meter.scan_on(&of(&[1005, 1002])).await.unwrap();
    assert_eq!(short, [1.005, 1.002].map(|volts| Reading::Ok(Volts(volts))));
    assert_eq!(shared.heard(), ["ROUT:SCAN (@1002,1005);:READ?;:SYST:ERR?"]);
    assert_eq!(meter.scan_on(&of(&[1005, 1002])).await.unwrap(), short);
    assert_eq!(shared.heard(), ["READ?;:SYST:ERR?"]);
    assert!(matches!(
        meter.scan_on(&of(&[1007])).await,
        Err(RigError::Unable { .. })
    ));
    meter.prepare(METER, &relays(1001..=1006)).await.unwrap();
    assert_eq!(meter.scan().await.unwrap().len(), 6);
}

#[tokio::test(start_paused = true)]
async fn averages_are_sweeps_of_one_message_and_one_overload_voids_its_mean() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let thrice = MeterSettings {
        averages: 3,
        channel_delay: Duration::from_millis(4),
        ..METER
    };
    meter.prepare(thrice, &relays(1001..=1002)).await.unwrap();
    let preparation = shared.heard();
    for setting in [
        "TRIG:COUN 3;:SYST:ERR?",
        "ROUT:CHAN:DEL 0.004,(@1001,1002);:SYST:ERR?",
    ] {
        assert!(preparation.iter().any(|said| said == setting), "{setting}");
    }
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    shared.lie(
        READ,
        "+1.0E+00,+4.0E+00,+2.0E+00,+9.9E+37,+6.0E+00,+4.0E+00;+0,\"No error\"",
    );
    assert_eq!(
        meter.scan().await.unwrap(),
        [Reading::Ok(Volts(3.0)), Reading::Overload]
    );
    for averages in [0, 50_001] {
        let refused = MeterSettings { averages, ..METER };
        assert!(meter.prepare(refused, &[]).await.is_err());
    }
}

#[tokio::test(start_paused = true)]
async fn a_chain_of_routes_is_one_message_with_an_answer_each() {
    let (shared, mut switch) = connected(&["34932A,4x32"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &[]).await.unwrap();
    switch.move_relays(&[close(&[1921])]).await.unwrap();
    switch.move_relays(&[close(&[1201])]).await.unwrap();
    shared.heard();
    let hop = |moves: Vec<Move>, range: f64| Hop {
        moves,
        range: Volts(range),
    };
    let hops = [
        hop(vec![close(&[1103])], 10.0),
        hop(vec![open(&[1103]), close(&[1501])], 10.0),
        hop(vec![open(&[1501]), close(&[1104])], 0.1),
    ];
    assert_eq!(
        meter.chain(&hops).await.unwrap(),
        [
            Reading::Ok(Volts(1.103)),
            Reading::Ok(Volts(1.501)),
            Reading::Overload
        ]
    );
    assert_eq!(
        shared.heard(),
        ["ROUT:CLOS (@1103);:VOLT:DC:RANG 10,(@);:READ?;\
          :ROUT:OPEN (@1103);:ROUT:CLOS (@1501);:READ?;\
          :ROUT:OPEN (@1501);:ROUT:CLOS (@1104);:VOLT:DC:RANG 0.1,(@);:READ?;:SYST:ERR?"]
    );
    // One answer too few: nobody knows whose is missing.
    shared.lie(READ, "+1.0E+00;+1.0E+00;+0,\"No error\"");
    assert!(matches!(
        meter.chain(&hops[..1]).await,
        Err(RigError::Garbled { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn settings_that_do_not_hold_are_told_by_name() {
    let (shared, mut unit) = connected(&["34924A"]).await;
    let scan = relays(1001..=1003);
    shared.lie("VOLT:DC:NPLC? (@1001:1003)", "+1.0E+00,+2.0E-02,+1.0E+00");
    let fault = unit.prepare(METER, &scan).await.unwrap_err();
    assert!(
        fault.to_string().contains("integration was set to 1"),
        "{fault}"
    );
    shared.truth();
    shared.lie("ROUT:SCAN?", "#217(@1001,1002,1004)");
    assert!(matches!(
        unit.prepare(METER, &scan).await,
        Err(RigError::Mismatch { .. })
    ));
    shared.truth();
    shared.lie(
        "ZERO:AUTO OFF,(@1001:1003);:SYST:ERR?",
        "-113,\"Undefined header\"",
    );
    let fault = unit.prepare(METER, &scan).await.unwrap_err();
    assert!(fault.to_string().contains("ZERO:AUTO OFF"), "{fault}");
    shared.truth();
    assert!(matches!(unit.scan().await, Err(RigError::Unable { .. })));
    unit.prepare(METER, &scan).await.unwrap();
    // Somebody changes a setting at the front panel: the next preparation sees it.
    shared.say("VOLT:DC:RANG 1,(@1002)");
    assert!(matches!(
        unit.prepare(METER, &scan).await,
        Err(RigError::Mismatch { .. })
    ));
    unit.prepare(METER, &scan).await.unwrap();
}
