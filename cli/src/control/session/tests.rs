use clap::Parser;

use crate::args::{Arguments, Command};
use crate::control::session::*;

fn options(words: &[&str]) -> Result<SessionOptions, Failure> {
    let words = ["tactus", "start"].iter().chain(words);
    let Command::Start(start) = Arguments::try_parse_from(words).unwrap().command else {
        panic!()
    };
    start_options(&start)
}

#[test]
fn a_schedule_becomes_options_of_the_contract() {
    let options = options(&[
        "--every",
        "10s",
        "--count",
        "3",
        "--for",
        "1m",
        "--baseline",
        "b1",
        "--model",
        "one-step",
        "--note",
        "n",
        "--averages",
        "4",
        "--reversal",
        "--autozero=false",
        "--settle",
        "2ms",
        "--ranges",
        "planned",
    ])
    .unwrap();
    let expected = SessionOptions {
        every_s: Some(10.0),
        count: Some(3),
        for_s: Some(60.0),
        baseline: Some("b1".to_owned()),
        model: Some("one-step".to_owned()),
        note: Some("n".to_owned()),
        averages: Some(4),
        reversal: Some(true),
        autozero: Some(false),
        settle_ms: Some(2.0),
        ranges: Some("planned".to_owned()),
        ..SessionOptions::default()
    };
    assert_eq!(options, expected);
}

#[test]
fn no_arguments_give_no_options() {
    assert_eq!(options(&[]).unwrap(), SessionOptions::default());
    assert_eq!(options(&["--step"]).unwrap().step, Some(true));
}

#[test]
fn a_model_that_is_not_there_is_named() {
    let failure = options(&["--model", "no/such.model"]).unwrap_err();
    assert_eq!(failure.code(), 78);
    assert!(failure.to_string().contains("no/such.model"), "{failure}");
}

#[test]
fn the_golden_lines() {
    let line = |line| serde_json::to_string(&line).unwrap();
    assert_eq!(
        line(SessionLine::Started {
            session: "m1".into(),
            kind: "measurement".into(),
            path: "/r/m1.tactus".into(),
            simulated: true,
        }),
        r#"{"event":"started","session":"m1","kind":"measurement","path":"/r/m1.tactus","simulated":true}"#
    );
    assert_eq!(
        line(SessionLine::Ended {
            session: "m1".into(),
            reason: "count reached".into(),
            frames: 3,
            path: "/r/m1.tactus".into(),
        }),
        r#"{"event":"ended","session":"m1","reason":"count reached","frames":3,"path":"/r/m1.tactus"}"#
    );
    assert_eq!(
        line(SessionLine::Stepped {
            session: "m1".into(),
            sequence: 2
        }),
        r#"{"event":"stepped","session":"m1","sequence":2}"#
    );
    assert_eq!(
        line(SessionLine::Warning {
            session: "b1".into(),
            text: "noise".into()
        }),
        r#"{"event":"warning","session":"b1","text":"noise"}"#
    );
}
