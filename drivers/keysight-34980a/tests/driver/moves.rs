//! Identity, checks of the wiring, and relay moves that succeed or fail.

use super::*;

#[tokio::test(start_paused = true)]
async fn relays_left_closed_are_found_so_and_opened_in_one_message() {
    let shared = Shared::of(mainframe(&["34924A"]));
    shared.say("ROUT:CLOS (@1036,1040)");
    let mut unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    let requested = relays([1036, 1037, 1040]);
    assert_eq!(unit.closed(&requested).await.unwrap(), [true, false, true]);
    shared.received();
    // After a fault, the relays are opened without the closures of the deferred move.
    unit.move_relays(&[close(&[1037]), open(&[1036])])
        .await
        .unwrap();
    unit.open_verified(&requested).await.unwrap();
    assert_eq!(
        shared.received()[0],
        "ROUT:OPEN (@1036);:ROUT:OPEN (@1036,1037,1040);:ROUT:CLOS? (@1036,1037,1040);:SYST:ERR?"
    );
    assert!(shared.closed().is_empty());
    shared.fake_reply("ROUT:CLOS? (@1036,1037,1040)", "0,0,1");
    assert!(matches!(
        unit.open_verified(&requested).await,
        Err(RigError::StillClosed { relays, .. }) if relays == [Relay(1040)]
    ));
}

#[tokio::test(start_paused = true)]
async fn a_refused_move_fails_its_own_message_and_is_named() {
    let (shared, mut switch) = connected(&["34924A"]).await;
    let mut meter = switch.clone();
    meter.prepare(METER, &relays(1001..=1026)).await.unwrap();
    switch.move_relays(&[close(&[1036])]).await.unwrap();
    // Channel 30 is in the scanned bank.
    switch
        .move_relays(&[close(&[1030]), open(&[1036])])
        .await
        .unwrap();
    let refusal = meter.scan().await.unwrap_err();
    assert!(
        matches!(refusal, RigError::Refused { code: 301, .. }),
        "{refusal}"
    );
    let text = refusal.to_string();
    assert!(
        text.contains(
            "refused 'ROUT:CLOS (@1030)' in 'ROUT:CLOS (@1030);:ROUT:OPEN (@1036);:READ?"
        ),
        "{text}"
    );
    // The queue is empty again, and the next preparation sends all settings again.
    shared.received();
    switch.open_verified(&relays([1030, 1036])).await.unwrap();
    assert_eq!(shared.received().len(), 1);
    meter.prepare(METER, &relays(1001..=1026)).await.unwrap();
    assert!(shared.received()[0].starts_with("CONF:VOLT:DC 100"));
    meter.scan().await.unwrap();
}

#[tokio::test(start_paused = true)]
async fn other_models_are_refused_and_both_maker_names_accepted() {
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
        // a faked reply of "" would mean no reply, so that an empty identity is sent as a blank
        let answer = if identity.is_empty() { " " } else { identity };
        shared.fake_reply("*IDN?", answer);
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
    shared.fake_reply("SYST:CTYP? 1", "\"Agilent Technologies,34924A,0,1.0\"");
    shared.fake_reply("SYST:CTYP? 2", "Agilent Technologies,34952A,0,1.0");
    shared.fake_reply("SYST:CTYP? 3", "nonsense");
    assert!(matches!(
        Keysight34980a::connect(shared.plug()).await,
        Err(RigError::Garbled { .. })
    ));
    shared.0.lock().unwrap().fake_replies.pop();
    let unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    assert_eq!(unit.modules()[0], Some("34924A".parse().unwrap()));
    assert_eq!(
        (unit.modules()[1], unit.cards()[1].as_deref()),
        (None, Some("34952A"))
    );
    let fault = unit
        .check_wiring(&keysight_34980a::pairs_34924a(2, 26).unwrap())
        .unwrap_err();
    assert_eq!(
        fault.to_string(),
        "34980A in a test: slot 2 holds a 34952A, the wiring needs a module with channel 36: relay 2036 joins electrodes 1 \
         and 2 to the source"
    );
}

#[tokio::test(start_paused = true)]
async fn unknown_module_is_named_when_its_relay_is_to_move() {
    let shared = Shared::of(mainframe(&[]));
    shared.fake_reply("SYST:CTYP? 2", "Agilent Technologies,34952A,0,1.0");
    let mut unit = Keysight34980a::connect(shared.plug()).await.unwrap();
    for (relay, found) in [(2036, "a 34952A"), (3036, "no module")] {
        let fault = unit.move_relays(&[close(&[relay])]).await.unwrap_err();
        assert_eq!(
            fault.to_string(),
            format!(
                "34980A in a test: slot {} holds {found}, the wiring needs a module with channel 36",
                relay / 1000
            )
        );
    }
}

#[tokio::test(start_paused = true)]
async fn wiring_is_checked_against_modules_before_any_relay_moves() {
    let (shared, mut unit) = connected(&["34924A", "34932A"]).await;
    unit.check_wiring(&keysight_34980a::pairs_34924a(1, 35).unwrap())
        .unwrap();
    // relay numbers of another kind of switch
    let mut strange = keysight_34980a::pairs_34924a(1, 26).unwrap();
    strange.inject[0].1 = vec![Relay(101), Relay(202)];
    unit.check_wiring(&keysight_34980a::matrix_34932a(2, 32).unwrap())
        .unwrap();
    for wiring in [
        keysight_34980a::pairs_34924a(2, 26).unwrap(),
        keysight_34980a::pairs_34924a(3, 26).unwrap(),
        keysight_34980a::matrix_34932a(1, 26).unwrap(),
        strange,
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
    assert_eq!(shared.received(), [""; 0]);
}
