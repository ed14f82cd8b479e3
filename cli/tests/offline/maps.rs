//! Maps recomputed from records.

use imaging::quantities::{LoadUnit, Quantity, QuantityRow, store};

use crate::scene::{
    PRESSED, calibration, done, lines, refused, session, session_in_parts, session_of,
    session_released, session_with_damaged_end, session_without_readings, tactus,
};

#[test]
fn replay_of_session_and_of_its_case_folder_finds_the_load() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let from_session = lines(&done(
        folder.path(),
        &[
            "replay",
            "m20270115_1",
            "--preset",
            "disc-tank",
            "--noise-v",
            "2e-6",
            "--json",
            "--out",
            "maps.csv",
            "--png",
            "maps",
        ],
    ));
    assert_eq!(from_session.len(), 3);
    for (line, masked) in from_session[1..].iter().zip([1, 0]) {
        let found = &line["found_mm"];
        let missed = (found[0].as_f64().unwrap() - PRESSED[0])
            .hypot(found[1].as_f64().unwrap() - PRESSED[1]);
        assert!(missed < 8.0, "{missed} mm beside: {line}");
        assert_eq!(line["masked"], masked);
        assert_eq!(line["simulated"], true);
        assert!(line["largest_loss"].as_f64().unwrap() > 0.05);
        // the readings have no noise, although 2 uV are configured
        assert_eq!(line["quality"]["verdict"], "doubtful", "{line}");
        assert_eq!(line["quality"]["reasons"][0]["kind"], "noise", "{line}");
    }
    let keys: Vec<_> = from_session[0].as_object().unwrap().keys().collect();
    assert_eq!(
        keys,
        [
            "frame",
            "label",
            "method",
            "found_mm",
            "largest_loss",
            "significant",
            "noise",
            "unit",
            "newtons",
            "largest_kpa",
            "masked",
            "evidence",
            "map_sd",
            "quality",
            "tracked",
            "no_map",
            "wall",
            "map_hash",
            "verified",
            "simulated",
            "png"
        ]
    );
    let png = std::fs::read(folder.path().join(from_session[2]["png"].as_str().unwrap())).unwrap();
    assert!(png.starts_with(b"\x89PNG"));
    let maps = std::fs::read_to_string(folder.path().join("maps.csv")).unwrap();
    assert_eq!(maps.lines().count(), 4, "a header and three frames");

    done(
        folder.path(),
        &[
            "export",
            "m20270115_1",
            "--format",
            "csv",
            "--out",
            "out.csv",
        ],
    );
    let from_folder = lines(&done(
        folder.path(),
        &[
            "replay",
            "out.case",
            "--frames",
            "frames.csv",
            "--baseline",
            "out.case/baseline.csv",
            "--preset",
            "disc-tank",
            "--noise-v",
            "2e-6",
            "--json",
        ],
    ));
    for (one, other) in from_session.iter().zip(&from_folder) {
        assert_eq!(
            one["map_hash"], other["map_hash"],
            "the same voltages give the same map"
        );
    }
    assert_eq!(from_folder[2]["label"], "f3");

    let each = [
        "quantities",
        "m20270115_1",
        "--each-frame",
        "--preset",
        "disc-tank",
    ];
    let text = done(folder.path(), &each);
    assert!(
        text.contains("known yes") && !text.contains("known 1"),
        "{text}"
    );

    // a frame without readings has no map, and the other frames have theirs
    let frames = std::fs::read_to_string(folder.path().join("out.case/frames.csv")).unwrap();
    let mut rows: Vec<String> = frames.lines().map(str::to_owned).collect();
    rows[2] = format!("f2{}", ",".repeat(rows[0].matches(',').count()));
    std::fs::write(folder.path().join("holes.csv"), rows.join("\n")).unwrap();
    let replay = ["replay", "out.case", "--frames", "holes.csv", "--json"];
    let options = [
        "--preset",
        "disc-tank",
        "--noise-v",
        "2e-6",
        "--out",
        "holes-maps.csv",
    ];
    let output = tactus(folder.path(), &[&replay[..], &options].concat());
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("1 of 3 frames have no map"), "{message}");
    let without = lines(&String::from_utf8(output.stdout).unwrap());
    assert!(
        without[1]["no_map"].as_str().unwrap().contains("missing"),
        "{}",
        without[1]
    );
    assert_eq!(without[2]["map_hash"], from_folder[2]["map_hash"]);
    let maps = std::fs::read_to_string(folder.path().join("holes-maps.csv")).unwrap();
    assert_eq!(maps.lines().filter(|row| row.contains(",nan,")).count(), 1);
}

#[test]
fn pictures_are_marked_as_simulated() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let line = lines(&done(
        folder.path(),
        &[
            "export",
            "m20270115_1",
            "--format",
            "svg",
            "--out",
            "map.svg",
            "--preset",
            "disc-tank",
            "--json",
        ],
    ));
    assert_eq!(line[0]["frame"], 3);
    let svg = std::fs::read_to_string(folder.path().join("map.svg")).unwrap();
    assert!(svg.contains("<svg") && svg.to_lowercase().contains("simulated"));
    done(
        folder.path(),
        &[
            "export",
            "m20270115_1",
            "--format",
            "png",
            "--out",
            "map.png",
            "--preset",
            "disc-tank",
            "--frame",
            "2",
        ],
    );
    assert!(
        std::fs::read(folder.path().join("map.png"))
            .unwrap()
            .starts_with(b"\x89PNG")
    );
    assert!(!folder.path().join("map.png.part").exists());
}

#[test]
fn a_session_is_replayed_as_its_daemon_made_it_and_verified() {
    let folder = tempfile::tempdir().unwrap();
    session_of(folder.path(), "m1", "[model]\nnoise_uv = 3.0\n");
    let made_again = lines(&done(folder.path(), &["replay", "m1", "--json"]));
    assert_eq!(made_again.len(), 3);
    assert!(
        made_again.iter().all(|line| line["verified"] == true),
        "{made_again:?}"
    );
    let otherwise = lines(&done(
        folder.path(),
        &["replay", "m1", "--json", "--prior", "tikhonov"],
    ));
    // the first frame is the baseline, so that no method finds a change
    assert!(otherwise[1..].iter().all(|line| line["verified"] == false));
    assert_eq!(otherwise[0]["method"], "one-step tikhonov");
}

#[test]
fn a_calibration_holds_in_replay_export_and_session_alike() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let model = format!(
        "[model]\nnoise_uv = 3.0\ncalibration = '{}'\n",
        at("sheet.toml")
    );
    session_of(folder.path(), "m1", &model);
    // the calibration file is missing: maps stay in relative loss, and a scale in kPa is refused
    let replay = ["replay", "m1", "--json", "--png", "pictures", "--force"];
    let bare = lines(&done(folder.path(), &replay));
    assert_eq!(bare[2]["unit"], "relative loss of conductance");
    assert!(bare[2]["newtons"].is_null());
    let kpa = ["--scale", "0,50kPa"];
    let message = refused(folder.path(), &[&replay[..], &kpa].concat(), 2);
    assert!(message.contains("calibration"), "{message}");
    let text = done(folder.path(), &["replay", "m1", "--no-map"]);
    assert!(
        text.contains("sheet.toml") && text.contains("--calibration"),
        "{text}"
    );
    let calibration = calibration(&bare[2]["method"]);
    std::fs::write(at("other.toml"), &calibration).unwrap();
    let named = ["--calibration", "other.toml", "--out", "maps.csv"];
    let made = lines(&done(folder.path(), &[&replay[..], &kpa, &named].concat()));
    assert_eq!(made[2]["unit"], "kPa");
    let (loss, pressure) = (&made[2]["largest_loss"], &made[2]["largest_kpa"]);
    let difference = pressure.as_f64().unwrap() - 100.0 * loss.as_f64().unwrap();
    assert!(difference.abs() < 1e-9, "{pressure} for {loss}");
    assert!(made[2]["newtons"].as_f64().unwrap() > 0.0);
    assert_eq!(
        made[2]["map_hash"], bare[2]["map_hash"],
        "the map is the same"
    );
    let maps = eit::Table::read(&folder.path().join("maps.csv")).unwrap();
    let most = maps.rows[2]
        .iter()
        .flatten()
        .fold(0.0_f64, |most, value| most.max(*value));
    assert_eq!(Some(most), pressure.as_f64(), "the table is in kPa");
    // a calibration of another method, named by an option, is refused
    let other = ["--prior", "tikhonov", "--calibration", "other.toml"];
    let message = refused(folder.path(), &[&replay[..], &other].concat(), 78);
    assert!(message.contains("tikhonov"), "{message}");
    // the calibration of the session's configuration applies without an option
    std::fs::write(at("sheet.toml"), &calibration).unwrap();
    let made = lines(&done(folder.path(), &replay));
    assert_eq!(made[2]["unit"], "kPa");
    let picture = [
        "export", "m1", "--format", "svg", "--out", "map.svg", "--scale", "0,20", "--json",
    ];
    let written = lines(&done(folder.path(), &picture));
    assert_eq!(written[0]["unit"], "kPa");
    let svg = std::fs::read_to_string(at("map.svg")).unwrap();
    assert!(
        svg.contains("kPa") && svg.lines().any(|line| line.trim() == "20"),
        "the axis ends at 20 kPa"
    );
    let raster = [
        "export",
        "m1",
        "--format",
        "raster",
        "--raster",
        "16",
        "--out",
        "raster.csv",
    ];
    done(folder.path(), &raster);
    let pixels = eit::Table::read(&folder.path().join("raster.csv")).unwrap();
    assert_eq!((pixels.rows.len(), pixels.width()), (16, 16));
    assert_eq!(pixels.rows[0][0], None, "a corner is outside of the disc");
    // the press is at the upper right: its pixel has more pressure than the mirrored one at the lower left
    assert!(pixels.rows[6][11] > pixels.rows[9][4], "{pixels:?}");
    // the calibration error adds to the deviation of the load, not to that of its position
    let relative_sd = |rms: &str| {
        std::fs::write(at("sheet.toml"), calibration.replace("rms = 0.01", rms)).unwrap();
        let asked = ["quantities", "m1", "--each-frame", "--json"];
        let frames = lines(&done(folder.path(), &asked));
        let sheet = frames[2]["regions"][0].clone();
        ["load", "centre-x"].map(|quantity| {
            let of = |what: &str| sheet[what][quantity].as_f64().unwrap();
            of("deviations") / of("values").abs()
        })
    };
    let (exact, rough) = (relative_sd("rms = 0.0"), relative_sd("rms = 0.3"));
    // 6 presses, one level: 0.3 sqrt(6/5 (1 + 1/6)) = 0.355, known to 18 % from 16 draws
    let of_gain = (rough[0].powi(2) - exact[0].powi(2)).sqrt();
    assert!((0.2..0.55).contains(&of_gain), "{exact:?} {rough:?}");
    assert!(
        (rough[1] / exact[1] - 1.0).abs() < 0.3,
        "{exact:?} {rough:?}"
    );
    std::fs::write(at("sheet.toml"), &calibration).unwrap();
    let shown = &lines(&done(folder.path(), &["sessions", "show", "m1", "--json"]))[0];
    assert_eq!(shown["calibration"], at("sheet.toml"));
    assert_eq!(shown["method"], bare[2]["method"]);
    assert_eq!(shown["baseline"]["id"], "b20270115_1");
    assert_eq!(shown["settings"]["current_a"], 1e-3);
    assert_eq!(shown["duration_s"], 4.0);
    assert!(shown["bytes"].as_u64().unwrap() > 1000);
    let page = done(folder.path(), &["sessions", "show", "m1"]);
    for line in [
        "(SIMULATED)",
        "duration",
        "4s",
        "sheet.toml",
        "noise of a reading 2.00 uV",
    ] {
        assert!(page.contains(line), "no '{line}' in {page}");
    }
}

#[test]
fn a_calibration_is_not_known_where_its_config_is_unread() {
    let folder = tempfile::tempdir().unwrap();
    session_released(folder.path(), "m1", "[model]\ngap = \"small\"\n");
    let shown = &lines(&done(folder.path(), &["sessions", "show", "m1", "--json"]))[0];
    assert!(shown["calibration"].is_null() && shown["method"].is_null());
    let why = shown["unread"]["configuration"].as_str().unwrap();
    assert!(why.contains("small"), "{why}");
    let page = done(folder.path(), &["sessions", "show", "m1"]);
    let not_known = "not known: the stored configuration cannot be read";
    assert_eq!(page.matches(not_known).count(), 2, "{page}");
    assert!(page.contains("small") && !page.contains("relative loss"));
}

#[test]
fn a_geometry_that_is_not_the_one_recorded_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    session_of(
        folder.path(),
        "m1",
        "[geometry.disc-tank]\nradius_mm = 100.0\n",
    );
    let message = refused(folder.path(), &["replay", "m1"], 78);
    assert!(message.contains("was recorded on geometry"), "{message}");
    // an option takes precedence over the session
    done(
        folder.path(),
        &[
            "replay",
            "m1",
            "--preset",
            "disc-tank",
            "--diameter-mm",
            "300",
        ],
    );
}

#[test]
fn a_session_that_was_rolled_over_is_one() {
    let [whole, rolled] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    session(whole.path());
    session_in_parts(rolled.path());
    let outcome = |folder: &std::path::Path, id: &str| {
        let geometry = ["--preset", "disc-tank", "--noise-v", "2e-6", "--json"];
        let maps: Vec<_> = lines(&done(folder, &[&["replay", id], &geometry[..]].concat()))
            .into_iter()
            .map(|line| (line["frame"].clone(), line["map_hash"].clone()))
            .collect();
        done(
            folder,
            &[
                "export", id, "--format", "csv", "--force", "--out", "out.csv",
            ],
        );
        let files = ["out.csv", "out.baseline.csv", "out.case/frames.csv"];
        let texts = files.map(|file| std::fs::read_to_string(folder.join(file)).unwrap());
        (maps, texts)
    };
    let (of_whole, of_rolled) = (
        outcome(whole.path(), "m20270115_1"),
        outcome(rolled.path(), "m1"),
    );
    assert_eq!(of_whole.0, of_rolled.0);
    assert_eq!(of_rolled.0.len(), 3);
    for (whole, rolled) in of_whole.1.iter().zip(&of_rolled.1) {
        assert!(
            whole == rolled,
            "{} and {} bytes",
            whole.len(),
            rolled.len()
        );
    }
    // a later part alone, and the last frame of all parts
    assert_eq!(outcome(rolled.path(), "m1_p3").0, of_whole.0[2..]);
    let picture = ["export", "m1", "--format", "svg", "--out", "map.svg"];
    let message = done(
        rolled.path(),
        &[&picture[..], &["--preset", "disc-tank", "--json"]].concat(),
    );
    assert_eq!(lines(&message)[0]["frame"], 3);
    // all parts are marked as exported
    let pruning = [
        "sessions",
        "prune",
        "--exported-only",
        "--dry-run",
        "--json",
    ];
    let message = lines(&done(rolled.path(), &pruning));
    let ids: Vec<_> = message
        .iter()
        .filter(|line| line["what"] == "would_remove")
        .map(|line| line["id"].as_str().unwrap())
        .collect();
    assert_eq!(ids.len(), 4, "{message:?}");
}

#[test]
fn the_session_that_was_started_last_is_called_last() {
    let folder = tempfile::tempdir().unwrap();
    session_in_parts(folder.path());
    let requested = ["replay", "last", "--preset", "disc-tank", "--json"];
    assert_eq!(
        lines(&done(folder.path(), &requested)).len(),
        3,
        "the frames of all its parts"
    );
    let empty = tempfile::tempdir().unwrap();
    let text = refused(empty.path(), &requested, 3);
    assert!(text.contains("no session in"), "{text}");
}

#[test]
fn replay_takes_the_frames_between_two_places() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let frames = |words: &[&str]| -> Vec<u64> {
        let mut command = vec!["replay", "last", "--preset", "disc-tank", "--json"];
        command.extend(["--method", "one-step", "--noise-v", "2e-6"]);
        command.extend(words);
        let sequence = |line: &serde_json::Value| line["frame"].as_u64().unwrap();
        let printed = done(folder.path(), &command);
        lines(&printed).iter().map(sequence).collect()
    };
    assert_eq!(frames(&[]), [1, 2, 3]);
    assert_eq!(frames(&["--from", "2"]), [2, 3]);
    assert_eq!(frames(&["--to", "1s"]), [1, 2]);
    assert_eq!(frames(&["--every", "2"]), [1, 3]);
    assert_eq!(frames(&["--from", "2", "--every", "2"]), [2]);
    assert_eq!(frames(&["--from", "2", "--count", "1"]), [2]);
    assert_eq!(
        frames(&[
            "--from",
            "2027-01-15T09:00:02+01:00",
            "--to",
            "2027-01-15T08:00:02Z"
        ]),
        [2]
    );
    let message = refused(folder.path(), &["replay", "last", "--from", "9"], 2);
    assert!(
        message.contains("no frame of") && message.contains("it has 3 frames"),
        "{message}"
    );
    let message = refused(folder.path(), &["replay", "last", "--from", "noon"], 2);
    assert!(message.contains("time since the first frame"), "{message}");
}

#[test]
fn damaged_frames_are_named_where_they_may_be_selected() {
    let replay = ["replay", "last", "--preset", "disc-tank", "--json"];
    let replay = [&replay[..], &["--method", "one-step", "--noise-v", "2e-6"]].concat();
    // of three frames, at 0, 1 and 2 s: how many are damaged at the end, printed, and left out
    for (damaged, end, printed, left_out) in [
        (1, &[][..], 2, 1),
        (1, &["--to", "2"], 2, 0),
        (1, &["--to", "1s"], 2, 1),
        (1, &["--to", "500ms"], 1, 0),
        (1, &["--count", "2"], 2, 0),
        (2, &["--to", "2"], 1, 1),
        (2, &["--to", "500ms"], 1, 2),
    ] {
        let folder = tempfile::tempdir().unwrap();
        session_with_damaged_end(folder.path(), damaged);
        let output = tactus(folder.path(), &[&replay[..], end].concat());
        let message = String::from_utf8(output.stderr).unwrap();
        let code = Some(i32::from(left_out > 0));
        assert_eq!(output.status.code(), code, "{damaged} {end:?}: {message}");
        let named = message.matches("a frame is left out").count();
        assert_eq!(named, left_out, "{damaged} {end:?}: {message}");
        let maps = lines(&String::from_utf8(output.stdout).unwrap());
        assert_eq!(maps.len(), printed, "{damaged} {end:?}");
    }
}

#[test]
fn a_span_of_quantities_is_whole_seconds() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    for span in ["500ms", "90500ms"] {
        let message = refused(folder.path(), &["quantities", "last", "--every", span], 2);
        assert!(message.contains(span), "{message}");
        assert!(message.contains("whole number of seconds"), "{message}");
    }
    let seconds = ["quantities", "last", "--every", "1000ms", "--json"];
    let method = ["--preset", "disc-tank", "--noise-v", "2e-6"];
    let rows = lines(&done(folder.path(), &[&seconds[..], &method].concat()));
    let begins: std::collections::BTreeSet<_> = rows
        .iter()
        .map(|row| row["begin"].as_str().unwrap())
        .collect();
    assert_eq!(begins.len(), 3, "a row for each frame: {begins:?}");
}

#[test]
fn frames_of_a_file_are_refused_for_a_session_with_rows() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let row = QuantityRow {
        begin_s: 1_800_000_000,
        region: "sheet".into(),
        quantity: Quantity::Load,
        of: LoadUnit::RelativeLoss,
        min: 1.0,
        mean: 2.0,
        max: 3.0,
        frames: 3,
        known: 3,
    };
    store(folder.path(), "m20270115_1", &[row]).unwrap();
    done(folder.path(), &["quantities", "last"]);
    let asked = ["quantities", "last", "--frames", "other.csv"];
    let message = refused(folder.path(), &asked, 2);
    assert!(message.contains("--frames other.csv belongs"), "{message}");
}

#[test]
fn quantities_of_frames_without_a_map_are_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    session_without_readings(folder.path());
    let method = ["--preset", "disc-tank", "--noise-v", "2e-6"];
    for more in [&[][..], &["--each-frame"], &["--csv"], &["--json"]] {
        let quantities = [&["quantities", "last"], &method[..], more].concat();
        let message = refused(folder.path(), &quantities, 1);
        for words in [
            "no frame of m20270115_1 has a map that can be used; frame 1: ",
            "readings are missing",
            "`tactus replay`",
        ] {
            assert!(message.contains(words), "{words}: {message}");
        }
    }
}

#[test]
fn stored_quantities_without_a_value_are_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let row = |quantity| QuantityRow {
        begin_s: 1_800_000_000,
        region: "sheet".into(),
        quantity,
        of: LoadUnit::RelativeLoss,
        min: 0.0,
        mean: 0.0,
        max: 0.0,
        frames: 3,
        known: 0,
    };
    let quantities = ["quantities", "last"];
    // a truncated minute
    let file = folder.path().join("m20270115_1.quantities");
    std::fs::write(&file, "0123").unwrap();
    let message = refused(folder.path(), &quantities, 1);
    assert!(
        message.contains("no stored minute of last can be read (1 are damaged)"),
        "{message}"
    );
    std::fs::remove_file(&file).unwrap();
    store(folder.path(), "m20270115_1", &[row(Quantity::Known)]).unwrap();
    let message = refused(folder.path(), &quantities, 1);
    assert!(
        message.contains("no stored minute of last has a map that could be used; "),
        "{message}"
    );
    assert!(message.contains("--recompute"), "{message}");
    // a load of zero is a value, and not a missing one
    store(folder.path(), "m20270115_1", &[row(Quantity::Load)]).unwrap();
    done(folder.path(), &quantities);
}

#[test]
fn rows_in_another_unit_have_a_heading_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let row = |minute: i64, of| QuantityRow {
        begin_s: 1_800_000_000 + 60 * minute,
        region: "sheet".into(),
        quantity: Quantity::Load,
        of,
        min: 1.0,
        mean: 2.0,
        max: 3.0,
        frames: 60,
        known: 60,
    };
    let units = [
        LoadUnit::RelativeLoss,
        LoadUnit::RelativeLoss,
        LoadUnit::Pressure,
    ];
    for (minute, of) in (0..).zip(units) {
        store(folder.path(), "m20270115_1", &[row(minute, of)]).unwrap();
    }
    let table = done(folder.path(), &["quantities", "last", "--quantity", "load"]);
    let columns = table.lines().map(|line| line.rsplit("  ").next());
    let columns: Vec<_> = columns.flatten().map(str::trim).collect();
    let wanted = ["load, mm2 lost", "2.00", "2.00", "load, N", "2.00"];
    assert_eq!(columns, wanted, "{table}");
}
