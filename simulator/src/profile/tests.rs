use super::*;
use crate::instrument::Headers;

#[test]
fn every_shipped_profile_can_be_read() {
    for name in Profile::names() {
        assert!(Profile::shipped(name).is_some(), "{name}");
    }
    assert_eq!(Profile::default().slots[0], "34924A".parse().ok());
    assert!(Profile::shipped("gpio-board").unwrap().board.is_some());
    let older = Profile::parse("p.toml", "[mainframe]\nheaders = \"34970A\"").unwrap();
    assert_eq!(older.mainframe.headers, Headers::Of34970A);
    assert_eq!(Profile::default().mainframe.headers, Headers::Documented);
}

#[test]
fn a_slot_that_the_option_gives_twice_is_refused() {
    let given = ["1=34924A", "2=34932A", "1=34934A"].map(|text| slot(text).unwrap());
    let mut slots = Profile::default().slots;
    assert_eq!(
        fill(&mut slots, &given),
        Err("--slot gives slot 1 twice; leave one out".to_owned())
    );
    assert_eq!(fill(&mut slots, &given[1..]), Ok(()));
    assert_eq!(
        slots[..2],
        ["34934A", "34932A"].map(|text| text.parse().ok())
    );
}

#[test]
fn what_is_wrong_is_named_with_its_place() {
    for (text, reported) in [
        ("time = \"soon\"", "p.toml:1:8: unknown time 'soon'"),
        (
            "time = \"scaled\"",
            "p.toml:1:8: scaled time needs a 'speed'",
        ),
        ("[slots]\n9 = \"34924A\"", "p.toml:2:1: slots are 1 to 8"),
        ("[slots]\n1 = \"34999A\"", "p.toml:2:5: no module '34999A'"),
        (
            "[slots]\n1 = \"34924A\"\n01 = \"34932A\"",
            "p.toml:3:1: the key '01' gives slot 1 a second time; delete one of them",
        ),
        (
            "[slots]\n01 = \"34924A\"\n1 = \"34932A\"",
            "p.toml:3:1: the key '1' gives slot 1 a second time",
        ),
        ("colour = 3", "p.toml:1:1: unknown field `colour`"),
        (
            "[mainframe]\nheaders = \"2000\"",
            "p.toml:2:11: unknown variant `2000`, expected `34980A` or `34970A`",
        ),
        ("line_hz = 400", "p.toml:1:11: line_hz is 50 or 60"),
        ("speed = -1\ntime = \"scaled\"", "p.toml:1:9: speed must be"),
        (
            "[source]\ncommand_ms = -3",
            "p.toml:2:1: command_ms of [source]",
        ),
        (
            "# command_ms is 5\n[source]\ncommand_ms = 5\n[mainframe]\nserial = \"command_ms\"\n  command_ms = 60001",
            "p.toml:6:3: command_ms of [mainframe] is 0 to 60000",
        ),
        (
            "mainframe.serial = \"slot_hold_s\"\nsource = { slot_hold_s = 3601 }",
            "p.toml:2:12: slot_hold_s is 0 to 3600",
        ),
        ("time = ", "p.toml:1:"),
        ("load = \"mesh\"", "p.toml:1:8: 'mesh' is not a load"),
        (
            "[source]\nslot_hold_s = -1",
            "p.toml:2:1: slot_hold_s is 0 to 3600",
        ),
        (
            "[[fault]]\nat_s = 1\nwhat = \"wire 6221\"",
            "p.toml:3:8: 'wire 6221' is not a fault: it is written wire INSTRUMENT",
        ),
        (
            "[[fault]]\nat_s = -1\nwhat = \"none\"",
            "p.toml:2:8: -1 is not a time",
        ),
        (
            "[[fault]]\nat_s = 1\nfor_s = 2\nwhat = \"drop 6221\"",
            "p.toml:4:8: 'drop 6221' is not a fault: it ends by itself",
        ),
    ] {
        let refusal = Profile::parse("p.toml", text).unwrap_err().to_string();
        assert!(refusal.starts_with(reported), "{text}: {refusal}");
    }
    let missing = Profile::load("/nowhere/mine.toml").unwrap_err().to_string();
    assert!(missing.contains("/nowhere/mine.toml"), "{missing}");
}
