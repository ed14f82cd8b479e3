//! Readings of a frame for each wiring, and replies that are not readings.

use super::*;

#[tokio::test(start_paused = true)]
async fn pair_wiring_costs_26_reading_messages_of_one_segment_each() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let scan = relays(1001..=1026);
    meter.prepare(METER, &scan).await.unwrap();
    let preparation = shared.received();
    assert_eq!(preparation[0], "*RST;*CLS;:SYST:ERR?");
    assert_eq!(preparation[1], "CONF:VOLT:DC 100,(@1001:1026);:SYST:ERR?");
    for setting in [
        "VOLT:DC:NPLC 1,(@1001:1026);:SYST:ERR?",
        "ROUT:CHAN:DEL 0,(@1001:1026);:SYST:ERR?",
        "VOLT:DC:ZERO:AUTO OFF,(@1001:1026)",
        "VOLT:DC:IMP:AUTO ON,(@1001:1026)",
        "TRIG:COUN 1;:SYST:ERR?",
        "FORM:READ:UNIT OFF;:SYST:ERR?",
    ] {
        assert!(preparation.iter().any(|line| line == setting), "{setting}");
    }
    let read_back = preparation.last().unwrap();
    assert!(read_back.starts_with("VOLT:DC:RANG? (@1001:1026);"));
    assert!(read_back.ends_with("ROUT:SCAN?;:SYST:ERR?"));

    switch
        .move_relays(&[close(&[1036]), open(&[])])
        .await
        .unwrap();
    assert_eq!(shared.received(), ["ROUT:CLOS (@1036);*OPC?"]);
    assert_eq!(shared.closed(), [1036]);
    for pair in 0..26 {
        if pair > 0 {
            let moves = [close(&[1036 + pair]), open(&[1035 + pair])];
            switch.move_relays(&moves).await.unwrap();
            assert_eq!(shared.received(), [""; 0]);
        }
        let readings = meter.scan().await.unwrap();
        let expected: Vec<Reading> = (1..=26)
            .map(|channel| f64::from(pair + 1) + f64::from(channel) * 1e-3)
            .map(|volts| format!("{volts:.8e}").parse().unwrap())
            .map(|volts| Reading::Ok(Volts(volts)))
            .collect();
        assert_eq!(readings, expected);
        let expected = match pair {
            0 => "READ?;:SYST:ERR?".to_owned(),
            _ => format!(
                "ROUT:CLOS (@{});:ROUT:OPEN (@{});:READ?;:SYST:ERR?",
                1036 + pair,
                1035 + pair
            ),
        };
        assert_eq!(shared.received(), [expected]);
    }
    let (driven, all) = (relays(1060..=1061), relays(1036..=1061));
    assert_eq!(
        switch.closed_before_opening(&driven, &all).await.unwrap(),
        [false, true]
    );
    switch.open_verified(&all).await.unwrap();
    assert_eq!(
        shared.received(),
        [
            "ROUT:CLOS? (@1060,1061);:ROUT:OPEN (@1036:1061);:ROUT:CLOS? (@1036:1061);:SYST:ERR?",
            "ROUT:OPEN (@1036:1061);:ROUT:CLOS? (@1036:1061);:SYST:ERR?"
        ]
    );
    assert!(shared.closed().is_empty());

    // The next frame with the same settings only reads back; nothing is reset.
    meter.prepare(METER, &scan).await.unwrap();
    assert_eq!(shared.received(), [read_back.as_str()]);
}

#[tokio::test(start_paused = true)]
async fn matrix_wiring_reads_the_bare_voltmeter_behind_the_bus_relay() {
    let (shared, mut switch) = connected(&["34932A,4x32"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &[]).await.unwrap();
    assert!(
        shared
            .received()
            .iter()
            .any(|line| line.starts_with("CONF:VOLT:DC 100,(@)"))
    );
    switch.move_relays(&[close(&[1921])]).await.unwrap();
    switch.move_relays(&[close(&[1201])]).await.unwrap();
    switch.move_relays(&[close(&[1103])]).await.unwrap();
    shared.received();
    assert_eq!(meter.read().await.unwrap(), Reading::Ok(Volts(1.103)));
    switch
        .move_relays(&[open(&[1103]), close(&[1501])])
        .await
        .unwrap();
    assert_eq!(meter.read().await.unwrap(), Reading::Ok(Volts(1.501)));
    assert_eq!(
        shared.received(),
        [
            "READ?;:SYST:ERR?",
            "ROUT:OPEN (@1103);:ROUT:CLOS (@1501);:READ?;:SYST:ERR?"
        ]
    );
    assert!(matches!(meter.scan().await, Err(RigError::Unable { .. })));
}

#[tokio::test(start_paused = true)]
async fn readings_keep_requested_order_though_scan_is_ascending() {
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
            .received()
            .iter()
            .any(|line| line.contains("(@1001,1003,1005)"))
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
    // not a number, and a number that no voltmeter can return on its 1 V range
    shared.fake_reply(
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
        shared.no_fake_replies();
        shared.fake_reply(READ, answer);
        let refusal = meter.scan().await.unwrap_err();
        assert!(matches!(refusal, RigError::Garbled { .. }), "{answer}");
        shared.no_fake_replies();
        let answer: &'static str = format!("{answer};+0,\"No error\"").leak();
        shared.fake_reply(READ, answer);
        let refusal = meter.scan().await.unwrap_err();
        assert!(matches!(refusal, RigError::Garbled { .. }), "{answer}");
        assert!(refusal.to_string().contains("3 number"), "{refusal}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_long_scan_is_awaited_and_a_missing_reply_is_not() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    let slow = MeterSettings {
        nplc: 10.0,
        autozero: true,
        ..METER
    };
    meter.prepare(slow, &relays(1001..=1026)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    // 26 readings of 0.4 s each take far longer than the link's own timeout of 2 s.
    assert_eq!(meter.scan().await.unwrap().len(), 26);
    shared.fake_reply(READ, "");
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
async fn a_refused_reading_has_no_reply_and_is_named_by_its_error() {
    let (shared, switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1003)).await.unwrap();
    for (code, text) in [(-221, "Settings conflict; perhaps"), (723, "Strange")] {
        let answer: &'static str = format!("{code},\"{text}\"").leak();
        shared.fake_reply(READ, answer);
        let refusal = meter.scan().await.unwrap_err();
        assert!(
            matches!(&refusal, RigError::Refused { code: refused, command, .. }
                if *refused == code && command == "READ?' in 'READ?;:SYST:ERR?"),
            "{refusal}"
        );
        shared.no_fake_replies();
    }
}
