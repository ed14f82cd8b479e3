//! Maps recomputed from records.

use crate::scene::{PRESSED, done, lines, refused, session, session_in_parts, session_of};

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
    }
    let keys: Vec<_> = from_session[0].as_object().unwrap().keys().collect();
    assert_eq!(
        keys,
        [
            "frame",
            "label",
            "wall",
            "method",
            "found_mm",
            "largest_loss",
            "significant",
            "noise",
            "masked",
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
}

#[test]
fn pictures_say_that_they_are_simulated() {
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
    // The first frame is the baseline: no change by any method.
    assert!(otherwise[1..].iter().all(|line| line["verified"] == false));
    assert_eq!(otherwise[0]["method"], "one-step tikhonov");
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
    // An explicit option takes precedence.
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
    // A later part alone, and the last frame of all.
    assert_eq!(outcome(rolled.path(), "m1_p3").0, of_whole.0[2..]);
    let picture = ["export", "m1", "--format", "svg", "--out", "map.svg"];
    let message = done(
        rolled.path(),
        &[&picture[..], &["--preset", "disc-tank", "--json"]].concat(),
    );
    assert_eq!(lines(&message)[0]["frame"], 3);
    // All parts are marked as exported.
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
