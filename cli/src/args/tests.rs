use clap::CommandFactory;

use super::*;
use crate::options::choices::{BaselineRule, PresetName, Scale};

fn parse(words: &[&str]) -> Result<Arguments, clap::Error> {
    Arguments::try_parse_from(std::iter::once("tactus").chain(words.iter().copied()))
}

#[test]
fn the_command_line_is_consistent() {
    Arguments::command().debug_assert();
}

#[test]
fn a_schedule_is_read() {
    let arguments = parse(&[
        "start", "--every", "10s", "--count", "16", "--for", "2h", "--json",
    ])
    .unwrap();
    assert!(arguments.global.json);
    let Command::Start(start) = arguments.command else {
        panic!()
    };
    assert_eq!(start.every, Some(Duration::from_secs(10)));
    assert_eq!(start.count, Some(16));
    assert_eq!(start.duration, Some(Duration::from_secs(7200)));
    assert!(!start.wait);
}

#[test]
fn global_options_stand_before_or_after() {
    for words in [
        ["--bus", "unix:/run/x", "status"],
        ["status", "--bus", "unix:/run/x"],
    ] {
        assert_eq!(
            parse(&words).unwrap().global.bus.as_deref(),
            Some("unix:/run/x")
        );
    }
}

#[test]
fn the_recording_of_the_story_is_read() {
    let arguments = parse(&[
        "replay",
        "data",
        "--frames",
        "replay.csv",
        "--baseline",
        "first:16",
        "--negate",
        "--preset",
        "disc-tank",
    ])
    .unwrap();
    let Command::Replay(replay) = arguments.command else {
        panic!()
    };
    assert_eq!(replay.from.baseline, Some(BaselineRule::First(16)));
    assert_eq!(replay.asked.geometry.preset, Some(PresetName::DiscTank));
    assert!(replay.from.negate);
    assert_eq!(replay.asked.method.prior, None);
}

#[test]
fn what_cannot_be_is_refused() {
    for (words, says) in [
        (&["start", "--every", "10"][..], "time unit needed"),
        (&["start", "--count", "0"][..], "0"),
        (&["start", "--within", "5s"][..], "--wait"),
        (&["start", "--speed", "-1"][..], "own rate"),
        (&["replay", "d", "--baseline", "first:0"][..], "first:16"),
        (
            &["replay", "d", "--model", "m", "--lambda", "1"][..],
            "--model",
        ),
        (&["replay", "d", "--noise-v", "-1"][..], "above 0"),
        (&["replay", "d", "--noise-v", "0"][..], "above 0"),
        (&["replay", "d", "--lambda", "-1"][..], "above 0"),
        (&["replay", "d", "--scale", "1,0"][..], "two numbers"),
        (&["export", "s", "--out", "x"][..], "--format"),
        (&["frobnicate"][..], "frobnicate"),
    ] {
        let refusal = parse(words).unwrap_err();
        assert_eq!(refusal.exit_code(), 2, "{words:?}");
        assert!(refusal.to_string().contains(says), "{words:?}: {refusal}");
    }
}

#[test]
fn a_fixed_scale_may_be_negative() {
    let arguments = parse(&["replay", "d", "--scale", "-5,50"]).unwrap();
    let Command::Replay(replay) = arguments.command else {
        panic!()
    };
    assert_eq!(
        replay.scale,
        Scale::Fixed {
            low: -5.0,
            high: 50.0,
            unit: None
        }
    );
}
