use crate::instruments::discovery::*;

const SOURCE: &str = "KEITHLEY INSTRUMENTS INC.,MODEL 6221,1234567,D04";

#[test]
fn one_instrument_found_three_ways_is_one_line() {
    let mut all = Vec::new();
    let at = |address: &str, by: &str, name: &str| {
        found_instrument(address.to_owned(), SOURCE.to_owned(), by, name, false)
    };
    add(&mut all, at("tcp:10.0.0.7:1394", "address", ""));
    add(&mut all, at("tcp:source.local:1394", "mdns", "the source"));
    add(&mut all, at("tcp:10.0.0.7:1394", "vxi-11", ""));
    assert_eq!(all.len(), 1);
    assert_eq!(all[0].found_by, "address, mdns, vxi-11");
    assert_eq!(
        (all[0].name.as_str(), all[0].address.as_str()),
        ("the source", "tcp:10.0.0.7:1394")
    );
    let other = SOURCE.replace("1234567", "7654321");
    add(
        &mut all,
        found_instrument(
            "tcp:10.0.0.8:1394".into(),
            other,
            "mdns",
            "the other",
            false,
        ),
    );
    assert_eq!(all.len(), 2);
}

#[test]
fn a_proposal_follows_from_the_identity_alone() {
    let (lines, remark) = propose("tcp:h:1394", SOURCE);
    assert_eq!(
        (lines.as_str(), remark.as_str()),
        ("[source]\naddress = \"tcp:h:1394\"", "")
    );
    let (lines, _) = propose("tcp:h:5025", "Agilent Technologies,34980A,MY1,2.43");
    assert!(lines.starts_with("[switch]\n"), "{lines}");
    let (lines, remark) = propose("tcp:h:5025", "Somebody,Oscilloscope,1,1");
    assert!(lines.is_empty() && remark.contains("no driver"), "{remark}");
}

#[test]
fn reply_of_an_unknown_device_adds_no_line_of_configuration() {
    let hostile = "x\n[notify]\ncommand = [\"sh\"]\r\u{1b}[2J\u{202e}\u{9b}\0\"\"\"".to_owned()
        + &"long".repeat(10_000);
    let gpio = format!("T,{},1,1", gpio_mux::MODEL);
    let all = [
        found_instrument("tcp:h:1".into(), hostile.clone(), "mdns", &hostile, false),
        found_instrument(
            format!("tcp:{hostile}:1"),
            SOURCE.into(),
            "mdns",
            &hostile,
            false,
        ),
        found_instrument(format!("tcp:{hostile}:2"), gpio, "mdns", "", false),
        SeenInstrument {
            remark: hostile.clone(),
            ..found_instrument(hostile.clone(), String::new(), "mdns", "", false)
        },
    ];
    let found = Discovery {
        seen: all.to_vec(),
        notes: vec![hostile.clone()],
    };
    let text = crate::service::objects::report::found_lines(&found, false).join("\n");
    assert!(text.lines().all(|line| {
        line.starts_with('#')
            || ["[source]", "[switch]", "[wiring]", "kind = \"gpio-board\""].contains(&line)
            || line.starts_with("address = ")
    }));
    for line in crate::service::objects::report::found_lines(&found, true) {
        let value: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert!(value.is_object());
        assert!(
            line.chars()
                .all(|payload| payload.is_ascii_graphic() || payload == ' ')
        );
    }
    assert!(!text.contains(|payload: char| payload.is_control() && payload != '\n'));
    assert!(!text.contains('\u{202e}'));
    // a proposal parses to the values that were found
    let proposed: toml::Table = toml::from_str(&all[1].proposal).unwrap();
    assert_eq!(proposed.len(), 1);
    let address = proposed["source"]["address"].as_str().unwrap();
    assert_eq!(address, &*printable(&all[1].address));
}

#[tokio::test]
async fn address_without_an_answer_is_reported_without_delay() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    drop(listener);
    let search = Search {
        mdns: false,
        broadcast: false,
        addresses: vec![format!("tcp:127.0.0.1:{port}").parse().unwrap()],
        ..Search::default()
    };
    let found = discover(&search).await;
    assert_eq!(found.seen.len(), 1);
    assert!(
        found.seen[0].identity.is_empty() && !found.seen[0].remark.is_empty(),
        "{found:?}"
    );
}
