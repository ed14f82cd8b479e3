//! Settings sent with a reading: ranges, delays, lists, averages, routes.

use super::*;

#[tokio::test(start_paused = true)]
async fn channel_range_is_set_in_the_scan_message_where_it_changes() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1004)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    shared.received();
    let on = |ranges: [f64; 4]| -> Vec<Sample> {
        (1001..)
            .zip(ranges)
            .map(|(relay, range)| Sample {
                relay: Relay(relay),
                range: Volts(range),
                wait: Duration::ZERO,
            })
            .collect()
    };
    // 1.001 to 1.004 V at the four channels
    let readings = meter.scan_on(&on([10.0, 0.1, 10.0, 100.0])).await.unwrap();
    assert_eq!(readings[1], Reading::Overload);
    assert!(readings[0].is_ok() && readings[2].is_ok() && readings[3].is_ok());
    assert_eq!(
        shared.received(),
        ["VOLT:DC:RANG 10,(@1001,1003);:VOLT:DC:RANG 0.1,(@1002);:READ?;:SYST:ERR?"]
    );
    meter.scan_on(&on([10.0, 10.0, 10.0, 100.0])).await.unwrap();
    assert_eq!(
        shared.received(),
        ["VOLT:DC:RANG 10,(@1002);:READ?;:SYST:ERR?"]
    );
    // The next frame finds the settings unchanged and sends none.
    meter.prepare(METER, &relays(1001..=1004)).await.unwrap();
    assert!(
        shared
            .received()
            .iter()
            .all(|line| !line.contains("RANG 1"))
    );
    assert!(matches!(
        meter.scan_on(&on([10.0, 2.0, 10.0, 100.0])).await,
        Err(RigError::VoltageOutOfRange { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn channel_delay_is_set_in_the_scan_message_where_it_changes() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let patient = MeterSettings {
        channel_delay: Duration::from_millis(1),
        ..METER
    };
    meter.prepare(patient, &relays(1001..=1003)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    shared.received();
    let on = |waits: [u64; 3]| -> Vec<Sample> {
        (1001..)
            .zip(waits)
            .map(|(relay, wait)| Sample {
                relay: Relay(relay),
                range: Volts(100.0),
                wait: Duration::from_micros(wait),
            })
            .collect()
    };
    meter.scan_on(&on([0, 0, 0])).await.unwrap();
    assert_eq!(shared.received(), ["READ?;:SYST:ERR?"]);
    let begun = Instant::now();
    meter.scan_on(&on([0, 0, 0])).await.unwrap();
    let without = begun.elapsed();
    shared.received();
    // rounded up to whole milliseconds
    let begun = Instant::now();
    meter.scan_on(&on([1500, 0, 0])).await.unwrap();
    assert_eq!(begun.elapsed() - without, Duration::from_millis(2));
    meter.scan_on(&on([1500, 0, 0])).await.unwrap();
    meter.scan_on(&on([0, 4000, 0])).await.unwrap();
    assert_eq!(
        shared.received(),
        [
            "ROUT:CHAN:DEL 0.003,(@1001);:READ?;:SYST:ERR?",
            "READ?;:SYST:ERR?",
            "ROUT:CHAN:DEL 0.001,(@1001);:ROUT:CHAN:DEL 0.005,(@1002);:READ?;:SYST:ERR?"
        ]
    );
    // read back as set
    meter.prepare(patient, &relays(1001..=1003)).await.unwrap();
    assert_eq!(shared.received().len(), 1);
    // far longer than the usual reply time
    meter.scan_on(&on([30_000_000, 0, 0])).await.unwrap();
    assert!(matches!(
        meter.scan_on(&on([60_000_000, 0, 0])).await,
        Err(RigError::Unable { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn shorter_scan_sends_its_list_and_unknown_channel_is_refused() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1006)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    shared.received();
    let of = |numbers: &[u32]| -> Vec<Sample> {
        let sample = |relay| Sample {
            relay,
            range: Volts(100.0),
            wait: Duration::ZERO,
        };
        relays(numbers.iter().copied())
            .into_iter()
            .map(sample)
            .collect()
    };
    let short = meter.scan_on(&of(&[1005, 1002])).await.unwrap();
    assert_eq!(short, [1.005, 1.002].map(|volts| Reading::Ok(Volts(volts))));
    assert_eq!(
        shared.received(),
        ["ROUT:SCAN (@1002,1005);:READ?;:SYST:ERR?"]
    );
    assert_eq!(meter.scan_on(&of(&[1005, 1002])).await.unwrap(), short);
    assert_eq!(shared.received(), ["READ?;:SYST:ERR?"]);
    assert!(matches!(
        meter.scan_on(&of(&[1007])).await,
        Err(RigError::Unable { .. })
    ));
    meter.prepare(METER, &relays(1001..=1006)).await.unwrap();
    assert_eq!(meter.scan().await.unwrap().len(), 6);
}

#[tokio::test(start_paused = true)]
async fn averages_are_one_message_and_an_overload_voids_the_mean() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let thrice = MeterSettings {
        averages: 3,
        channel_delay: Duration::from_millis(4),
        ..METER
    };
    meter.prepare(thrice, &relays(1001..=1002)).await.unwrap();
    let preparation = shared.received();
    for setting in [
        "TRIG:COUN 3;:SYST:ERR?",
        "ROUT:CHAN:DEL 0.004,(@1001,1002);:SYST:ERR?",
    ] {
        assert!(preparation.iter().any(|line| line == setting), "{setting}");
    }
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    shared.fake_reply(
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
    shared.received();
    let one = |moves: Vec<Move>, range: f64| ChainedReading {
        moves,
        range: Volts(range),
    };
    let chained = [
        one(vec![close(&[1103])], 10.0),
        one(vec![open(&[1103]), close(&[1501])], 10.0),
        one(vec![open(&[1501]), close(&[1104])], 0.1),
    ];
    assert_eq!(
        meter.chain(&chained).await.unwrap(),
        [
            Reading::Ok(Volts(1.103)),
            Reading::Ok(Volts(1.501)),
            Reading::Overload
        ]
    );
    assert_eq!(
        shared.received(),
        ["ROUT:CLOS (@1103);:VOLT:DC:RANG 10,(@);:READ?;\
          :ROUT:OPEN (@1103);:ROUT:CLOS (@1501);:READ?;\
          :ROUT:OPEN (@1501);:ROUT:CLOS (@1104);:VOLT:DC:RANG 0.1,(@);:READ?;:SYST:ERR?"]
    );
    // One reply too few: the replies cannot be assigned to queries.
    shared.fake_reply(READ, "+1.0E+00;+1.0E+00;+0,\"No error\"");
    assert!(matches!(
        meter.chain(&chained[..1]).await,
        Err(RigError::Garbled { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn settings_that_were_not_taken_are_named() {
    let (shared, mut unit) = connected(&["34924A"]).await;
    let scan = relays(1001..=1003);
    shared.fake_reply("VOLT:DC:NPLC? (@1001:1003)", "+1.0E+00,+2.0E-02,+1.0E+00");
    let fault = unit.prepare(METER, &scan).await.unwrap_err();
    assert!(
        fault.to_string().contains("integration was set to 1"),
        "{fault}"
    );
    shared.no_fake_replies();
    shared.fake_reply("ROUT:SCAN?", "#217(@1001,1002,1004)");
    assert!(matches!(
        unit.prepare(METER, &scan).await,
        Err(RigError::Mismatch { .. })
    ));
    shared.no_fake_replies();
    shared.fake_reply(
        "VOLT:DC:NPLC 1,(@1001:1003);:SYST:ERR?",
        "-221,\"Settings conflict\"",
    );
    let fault = unit.prepare(METER, &scan).await.unwrap_err();
    assert!(fault.to_string().contains("VOLT:DC:NPLC 1"), "{fault}");
    shared.no_fake_replies();
    assert!(matches!(unit.scan().await, Err(RigError::Unable { .. })));
    unit.prepare(METER, &scan).await.unwrap();
    // A setting that was changed at the front panel is detected by the next preparation.
    shared.say("VOLT:DC:RANG 1,(@1002)");
    assert!(matches!(
        unit.prepare(METER, &scan).await,
        Err(RigError::Mismatch { .. })
    ));
    unit.prepare(METER, &scan).await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn older_headers_are_sent_where_new_ones_are_undefined() {
    let scan = relays(1001..=1003);
    for (headers, sent, undefined) in [
        (
            HeaderForm::Documented,
            [
                "VOLT:DC:ZERO:AUTO OFF,(@1001:1003)",
                "VOLT:DC:IMP:AUTO ON,(@1001:1003)",
            ],
            "ZERO:AUTO? (@1001)",
        ),
        (
            HeaderForm::Of34970A,
            ["ZERO:AUTO OFF,(@1001:1003)", "INP:IMP:AUTO ON,(@1001:1003)"],
            "VOLT:DC:IMP:AUTO? (@1001)",
        ),
    ] {
        let settings = Settings34980a {
            headers,
            slots: mainframe_slots(&["34924A"]),
            ..Settings34980a::default()
        };
        let shared = Shared::of(Simulator34980a::new(settings));
        let mut unit = Keysight34980a::connect(shared.plug()).await.unwrap();
        unit.prepare(METER, &scan).await.unwrap();
        let received = shared.received();
        for message in sent {
            assert!(received.iter().any(|one| one == message), "{received:?}");
        }
        // a later preparation sends only the accepted form
        unit.prepare(MeterSettings::new(Volts(10.0), 1.0), &scan)
            .await
            .unwrap();
        let again = shared.received();
        for (form, message) in ["ZERO:AUTO OFF", "IMP:AUTO ON"].into_iter().zip(sent) {
            let accepted = again.iter().filter(|text| text.contains(form));
            assert_eq!(accepted.collect::<Vec<_>>(), [message], "{again:?}");
        }
        // the other form is undefined, and has no reply
        assert_eq!(shared.ask(undefined), None);
        assert_eq!(
            shared.ask("SYST:ERR?").as_deref(),
            Some("-113,\"Undefined header\"")
        );
    }
}
