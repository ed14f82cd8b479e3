//! An export that is impossible is refused with the reason, and leaves no file.

use std::path::Path;

use crate::scene::{
    baseline_session, refused, session, session_without_baseline, session_without_readings,
};

/// The files of a folder other than sessions, sorted.
pub(super) fn left(folder: &Path) -> Vec<String> {
    let names = std::fs::read_dir(folder).unwrap();
    let names = names.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| !name.contains(".tactus")).collect();
    names.sort();
    names
}

const FORMATS: [&str; 2] = ["nc", "mat"];

#[test]
fn a_session_without_frames_is_not_exported() {
    let folder = tempfile::tempdir().unwrap();
    baseline_session(folder.path());
    let before = left(folder.path());
    for format in FORMATS {
        let export = ["export", "b2027", "--format", format, "--out", "out.x"];
        let message = refused(folder.path(), &export, 1);
        assert!(message.contains("has no readable frame"), "{message}");
        assert_eq!(left(folder.path()), before, "{format}");
    }
}

#[test]
fn outputs_that_cannot_be_written_are_named() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    std::fs::write(folder.path().join("there.x"), "mine").unwrap();
    let before = left(folder.path());
    for format in FORMATS {
        let export = ["export", "last", "--format", format, "--out"];
        let message = refused(folder.path(), &[&export[..], &["no/out.x"]].concat(), 1);
        assert!(message.contains("no/out.x"), "{message}");
        let message = refused(folder.path(), &[&export[..], &["there.x"]].concat(), 1);
        assert!(message.contains("there.x exists already"), "{message}");
        assert_eq!(left(folder.path()), before, "{format}");
    }
    let kept = std::fs::read_to_string(folder.path().join("there.x")).unwrap();
    assert_eq!(kept, "mine");
}

#[test]
fn netcdf_is_not_written_to_a_pipe() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let export = ["export", "last", "--format", "nc", "--out", "/dev/stdout"];
    let message = refused(folder.path(), &export, 2);
    assert!(message.contains("name a file"), "{message}");
}

#[test]
fn maps_need_a_baseline_and_the_format() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    session_without_baseline(folder.path());
    let before = left(folder.path());
    let maps = ["--maps", "--preset", "disc-tank", "--out", "out.nc"];
    let bare = ["export", "bare", "--format", "nc"];
    let message = refused(folder.path(), &[&bare[..], &maps].concat(), 1);
    assert!(message.contains("has no baseline"), "{message}");
    let csv = ["export", "m2027", "--format", "csv"];
    let message = refused(folder.path(), &[&csv[..], &maps].concat(), 2);
    assert!(message.contains("--format nc"), "{message}");
    // a geometry that does not fit
    let unknown = [
        "export", "m2027", "--format", "nc", "--maps", "-o", "out.nc",
    ];
    let message = refused(folder.path(), &unknown, 78);
    assert!(message.contains("the mesh has 26"), "{message}");
    assert_eq!(left(folder.path()), before);
}

#[test]
fn options_that_the_format_would_ignore_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let before = left(folder.path());
    for (options, formats) in [
        (
            &["--frame", "1"][..],
            &["csv", "nc", "mat", "parquet", "apng"][..],
        ),
        (
            &["--raster", "16"],
            &["csv", "nc", "mat", "parquet", "apng", "png", "svg"],
        ),
        (&["--scale", "0,50"], &["csv", "nc", "mat", "parquet"]),
        (
            &["--calibration", "sheet.toml"],
            &["csv", "nc", "mat", "parquet"],
        ),
        (&["--method", "tv"], &["csv", "nc", "mat", "parquet"]),
        (&["--tracked"], &["csv", "nc", "mat", "parquet"]),
        (&["--preset", "disc-tank"], &["nc", "parquet"]),
    ] {
        for format in formats {
            let export = ["export", "last", "--format", format, "--out", "out.x"];
            let message = refused(folder.path(), &[&export[..], options].concat(), 2);
            let named = message.contains(options[0]) && message.contains("to --format ");
            assert!(named, "{options:?}: {message}");
            assert_eq!(left(folder.path()), before, "{options:?} {format}");
        }
    }
}

#[test]
fn requested_maps_of_which_none_is_made_are_a_failure() {
    let folder = tempfile::tempdir().unwrap();
    session_without_readings(folder.path());
    let export = ["export", "last", "--format", "nc", "--out", "out.nc"];
    let maps = ["--maps", "--preset", "disc-tank", "--noise-v", "2e-6"];
    let message = refused(folder.path(), &[&export[..], &maps].concat(), 1);
    assert!(
        message.contains("no frame of session m20270115_1 has a map"),
        "{message}"
    );
    let mark = folder.path().join("m20270115_1.exported.json");
    let mark = std::fs::read_to_string(mark).unwrap();
    assert!(mark.contains(r#""format":"nc""#), "{mark}");
    // the readings of this frame are exported nevertheless
    assert_eq!(left(folder.path()), ["m20270115_1.exported.json", "out.nc"]);
}

#[test]
fn a_script_that_exists_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    std::fs::write(folder.path().join("out.m"), "mine").unwrap();
    let export = ["export", "last", "--format", "mat", "--out", "out.mat"];
    let message = refused(folder.path(), &export, 1);
    assert!(message.contains("out.m exists already"), "{message}");
    let export = ["export", "last", "--format", "mat", "--out", "new.m"];
    let message = refused(folder.path(), &export, 2);
    assert!(message.contains("ends in .mat"), "{message}");
    assert_eq!(left(folder.path()), ["out.m"]);
}
