//! The report of a session: one page without scripts, written completely or not at all.

use std::path::Path;

use crate::scene::{
    baseline_session, calibration, done, lines, refused, session_of, session_paused,
    session_released, session_with_alarm_not_judged, session_with_alarms, session_with_damaged_end,
    session_with_unread_end, session_without_baseline, session_without_load,
    session_without_readings,
};

const METHOD: [&str; 4] = ["--preset", "disc-tank", "--noise-v", "2e-6"];

fn report(folder: &Path, session: &str) -> (String, serde_json::Value) {
    let command = ["report", session, "--json", "--out", "out"];
    let printed = done(folder, &[&command[..], &METHOD].concat());
    let names = std::fs::read_dir(folder.join("out")).unwrap();
    let names: Vec<_> = names.map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(names, ["index.html"]);
    let page = std::fs::read_to_string(folder.join("out/index.html")).unwrap();
    (page, lines(&printed)[0].clone())
}

/// The names of the files in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let names = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = names
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_report_is_one_page_that_loads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    let (page, line) = report(folder.path(), "last");
    assert_eq!(line["simulated"], true);
    assert_eq!(
        (&line["frames"], &line["events"], &line["gaps"]),
        (&3.into(), &2.into(), &0.into())
    );
    // the frame with an overload has the largest value of every quantity, so the report has one map
    assert_eq!(line["maps"], 1);
    for words in [
        "SIMULATED",
        "not a medical device",
        "<h2>Summary</h2>",
        "<h2>Worst moments</h2>",
        "<h2>Course</h2>",
        "<h2>Alarms and events</h2>",
        "<h2>Gaps</h2>",
        "<h2>Health</h2>",
        "<h2>Settings and origin</h2>",
        "three frames",
        "1 mA, range",
        "readings over range</td><td>1 (33.33 %)",
        "load of frame 3 &lt;is&gt; above 3 &amp; stays",
        "b20270115_1",
        "the session has no calibration",
    ] {
        assert!(page.contains(words), "{words}");
    }
    for foreign in [
        "<script", "src=", "href=", "url(", "@import", "<link", "onload",
    ] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    // the maps, and a chart for each quantity that has values
    assert!(page.matches("<svg").count() >= 5);
    let [open, closed] = ["<svg", "</svg>"].map(|tag| page.matches(tag).count());
    assert_eq!(open, closed);
}

#[test]
fn numbers_of_a_report_are_those_of_quantities() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    let (page, _) = report(folder.path(), "last");
    let quantities = ["quantities", "last", "--json"];
    let rows = lines(&done(folder.path(), &[&quantities[..], &METHOD].concat()));
    for (quantity, words) in [
        ("ppi", "largest peak pressure index"),
        ("load", "largest load"),
    ] {
        let row = rows
            .iter()
            .find(|row| row["quantity"] == quantity && row["region"] == "sheet");
        let row = row.unwrap();
        let largest = row["max"].as_f64().unwrap();
        let rounded = match largest {
            100.0.. => format!("{largest:.0}"),
            10.0.. => format!("{largest:.1}"),
            1.0.. => format!("{largest:.2}"),
            _ => format!("{largest:.3}"),
        };
        let unit = row["unit"].as_str().unwrap();
        let shown = format!("{words}: {rounded} {unit}");
        assert!(page.contains(&shown), "{shown}");
    }
}

#[test]
fn a_report_without_frames_has_no_share_of_them() {
    let folder = tempfile::tempdir().unwrap();
    baseline_session(folder.path());
    let (page, line) = report(folder.path(), "b2027");
    assert_eq!(line["frames"], 0);
    assert!(page.contains("has no readable frame") && !page.contains("frames without a fault"));
}

#[test]
fn a_last_frame_that_cannot_be_read_is_stated() {
    let folder = tempfile::tempdir().unwrap();
    session_with_damaged_end(folder.path(), 1);
    let (page, line) = report(folder.path(), "last");
    assert_eq!(line["frames"], 2);
    let frames = "<td>frames</td><td>2 that can be read, from 2027-01-1";
    assert!(page.contains(frames), "{frames}");
    let unread = "not known: the last frame cannot be read: ";
    let settings = format!("<td>settings</td><td>{unread}");
    assert!(page.contains(&settings), "{settings}");
    let show = ["sessions", "show", "last", "--json"];
    let shown = &lines(&done(folder.path(), &show))[0];
    assert!(shown["settings"].is_null() && shown["last_frame"].is_null());
    let why = shown["unread"]["last_frame"].as_str().unwrap();
    assert!(why.contains("frame 3"), "{why}");
}

#[test]
fn frames_without_a_map_are_not_known_in_a_report() {
    let folder = tempfile::tempdir().unwrap();
    session_with_unread_end(folder.path());
    let (page, _) = report(folder.path(), "last");
    let quantities = ["quantities", "last", "--json", "--quantity", "known"];
    let rows = lines(&done(folder.path(), &[&quantities[..], &METHOD].concat()));
    assert_eq!(rows[0]["frames"], 3);
    let share = rows[0]["mean"].as_f64().unwrap();
    assert!(share < 1.0, "{share}");
    let shown = format!("in {:.1} % of the frames", 100.0 * share);
    assert!(page.contains(&shown), "{shown}");
    assert!(page.contains("1 more have no map"));
}

#[test]
fn an_alarm_that_cannot_be_judged_is_not_none() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarm_not_judged(folder.path());
    let (page, _) = report(folder.path(), "last");
    assert!(!page.contains("none in this session"));
    let shown = "<td>alarms</td><td>0 times; an alarm could not be judged 1 times";
    assert!(page.contains(shown), "{shown}");
    assert!(page.contains("pressed cannot be judged"));
}

#[test]
fn a_gap_is_shown_with_its_explanation() {
    let folder = tempfile::tempdir().unwrap();
    session_paused(folder.path());
    let (page, line) = report(folder.path(), "last");
    assert_eq!(
        (&line["gaps"], &line["unexplained"]),
        (&1.into(), &0.into())
    );
    let (_, gaps) = page.split_once("<h2>Gaps</h2>").unwrap();
    let (gaps, _) = gaps.split_once("<h2>").unwrap();
    assert!(gaps.contains("<td>10.0 min</td>"), "{gaps}");
    assert!(gaps.contains("the disk was slow"), "{gaps}");
}

#[test]
fn a_session_that_has_no_maps_has_a_report() {
    let folder = tempfile::tempdir().unwrap();
    session_without_baseline(folder.path());
    let (page, line) = report(folder.path(), "bare");
    assert_eq!(line["maps"], 0);
    assert!(page.contains("has no baseline"));
    assert!(page.contains("<h2>Health</h2>") && !page.contains("<h2>Course</h2>"));
}

#[test]
fn frames_without_a_map_are_no_maps_without_a_load() {
    let above = "No map shows a load above its noise.";
    let folders = [(); 3].map(|()| tempfile::tempdir().unwrap());
    let [unread, unloaded, part] = &folders;
    session_without_readings(unread.path());
    let (page, line) = report(unread.path(), "last");
    assert_eq!(line["maps"], 0);
    let none = "no frame of m20270115_1 has a map that can be used; frame 1: ";
    assert_eq!(page.matches(none).count(), 2, "summary and worst moments");
    assert!(page.contains("readings are missing"));
    assert!(!page.contains("above its noise"));
    // a session in whose maps nothing is above the noise
    session_without_load(unloaded.path(), false);
    let (page, line) = report(unloaded.path(), "last");
    assert_eq!(line["maps"], 0);
    assert!(page.contains(above) && !page.contains("can be used"));
    session_without_load(part.path(), true);
    let (page, _) = report(part.path(), "last");
    assert!(!page.contains(above) && page.contains("1 of 3 frames have none."));
}

#[test]
fn a_calibration_that_is_not_there_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("sheet.toml");
    let model = format!(
        "[model]\nnoise_uv = 3.0\ncalibration = '{}'\n",
        file.display()
    );
    session_of(folder.path(), "m1", &model);
    done(folder.path(), &["report", "m1", "--out", "out"]);
    let page = std::fs::read_to_string(folder.path().join("out/index.html")).unwrap();
    assert!(!page.contains("the session has no calibration"));
    let unused = format!("calibration {} is not used", file.display());
    assert!(page.contains(&unused), "{unused}");
}

#[test]
fn maps_of_another_unit_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("sheet.toml");
    let model = format!(
        "[model]\nmethod = \"best\"\nnoise_uv = 3.0\ncalibration = '{}'\n",
        file.display()
    );
    session_released(folder.path(), "m1", &model);
    let maps = lines(&done(folder.path(), &["replay", "m1", "--json"]));
    let methods: Vec<_> = maps.iter().map(|map| &map["method"]).collect();
    assert!(
        methods[0] == methods[1] && methods[1] != methods[2],
        "{methods:?}"
    );
    std::fs::write(&file, calibration(methods[0])).unwrap();
    let printed = done(folder.path(), &["report", "m1", "--json", "--out", "out"]);
    assert!(lines(&printed)[0]["maps"].as_u64() > Some(0), "{printed}");
    let page = std::fs::read_to_string(folder.path().join("out/index.html")).unwrap();
    let left_out =
        "Left out: 1 of 3 frames examined; the first: the calibration does not belong to this map.";
    assert!(page.contains(left_out), "{left_out}");
    // the longest unrelieved time is one of the worst moments
    assert!(page.contains("kPa") && page.contains("longest unrelieved time: "));
}

#[test]
fn a_report_that_cannot_be_written_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    std::fs::create_dir(folder.path().join("full")).unwrap();
    std::fs::write(folder.path().join("full/mine"), "mine").unwrap();
    std::fs::write(folder.path().join("file"), "mine").unwrap();
    let before = names(folder.path());
    let of = |out: &str, more: &[&str], code| {
        let command = ["report", "last", "--out", out];
        let message = refused(folder.path(), &[&command[..], more].concat(), code);
        assert_eq!(names(folder.path()), before);
        message
    };
    let message = of("full", &METHOD, 1);
    assert!(message.contains("full is not empty"), "{message}");
    let message = of("file", &METHOD, 1);
    assert!(message.contains("file is not a folder"), "{message}");
    let message = of("no/out", &METHOD, 1);
    assert!(message.contains("no/out"), "{message}");
    // a wrong option is refused; a missing geometry would only leave out the maps
    let message = of("new", &["--preset", "disc-tank", "--electrodes", "8"], 78);
    assert!(message.contains('8'), "{message}");
    // an existing empty folder is accepted
    std::fs::create_dir(folder.path().join("out")).unwrap();
    report(folder.path(), "last");
}
