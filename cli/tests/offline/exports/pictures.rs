//! Pictures of one instant, named by frame, time or event.

use std::path::Path;

use super::refusals::left;
use crate::scene::{done, refused, session_with_alarms};

const METHOD: [&str; 4] = ["--preset", "disc-tank", "--noise-v", "2e-6"];

fn picture(folder: &Path, format: &str, which: &[&str]) -> Vec<u8> {
    let export = [
        "export", "last", "--force", "--format", format, "--out", "out.x",
    ];
    done(folder, &[&export[..], &METHOD, which].concat());
    std::fs::read(folder.join("out.x")).unwrap()
}

#[test]
fn an_instant_is_the_last_frame_that_had_begun() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    let of = |which: &[&str]| picture(folder.path(), "png", which);
    let frames = ["1", "2", "3"].map(|number| of(&["--frame", number]));
    assert!(frames[0] != frames[1] && frames[1] != frames[2]);
    for (instant, frame) in [
        ("2", 2),
        ("1s", 2),
        ("1500ms", 2),
        ("2027-01-15T08:00:02.9Z", 2),
        ("2027-01-15T08:00:03Z", 3),
        ("2027-01-15T08:00:00Z", 1),
        ("2027-01-15T08:00:30Z", 3),
        ("alarm-active", 2),
        ("alarm-active:2", 3),
        ("event:2", 3),
    ] {
        assert!(of(&["--at", instant]) == frames[frame - 1], "{instant}");
    }
}

#[test]
fn a_picture_marks_and_explains_hot_spots() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    let words = |svg: Vec<u8>| {
        let svg = String::from_utf8(svg).unwrap();
        let texts = svg.split("<text").skip(1);
        let inside = |text: &str| {
            text.split_once('>')
                .unwrap()
                .1
                .split('<')
                .next()
                .unwrap()
                .trim()
                .to_owned()
        };
        texts.map(inside).collect::<Vec<_>>()
    };
    // the frame without a load has no hot spot, but the same legend
    for (which, spots) in [("1", 0), ("3", 1)] {
        let words = words(picture(folder.path(), "svg", &["--at", which]));
        let count = |text: &str| words.iter().filter(|word| *word == text).count();
        assert_eq!(count("hot spot: area at half of its peak or more"), 1);
        // the labels of electrode 1 and of the hot spot
        assert_eq!(count("1"), 1 + spots, "{which}: {words:?}");
        assert!(words.iter().any(|word| word.contains("2027")), "{words:?}");
        assert_eq!(count("SIMULATED"), 1);
    }
}

#[test]
fn instants_outside_of_the_session_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    let before = left(folder.path());
    let at = |instant: &str, format: &str, code| {
        let export = [
            "export", "last", "--format", format, "--out", "out.x", "--at", instant,
        ];
        let message = refused(folder.path(), &[&export[..], &METHOD].concat(), code);
        assert_eq!(left(folder.path()), before, "{instant}");
        message
    };
    for instant in ["2027-01-15T07:58:00Z", "2027-01-15T09:00:00Z", "2h"] {
        let message = at(instant, "png", 2);
        assert!(message.contains("name a time between"), "{message}");
    }
    let message = at("alarm-active:3", "png", 2);
    assert!(message.contains("has 2 such events"), "{message}");
    let message = at("disk-full", "svg", 2);
    assert!(message.contains("of the kinds alarm-active"), "{message}");
    let message = at("Noon", "png", 2);
    assert!(message.contains("not an instant"), "{message}");
    let message = at("9", "png", 2);
    assert!(message.contains("no frame 9"), "{message}");
    let message = at("2", "csv", 2);
    assert!(message.contains("--format png"), "{message}");
}
