//! Exports that replace an earlier one.

use super::refusals::left;
use crate::scene::{done, session, session_of, session_without_baseline};

#[test]
fn an_export_over_another_keeps_nothing_of_it() {
    let folder = tempfile::tempdir().unwrap();
    session_of(folder.path(), "m1", "");
    session_without_baseline(folder.path());
    let export = |session: &str| {
        let words = ["export", session, "--format", "csv", "--out", "out.csv"];
        done(folder.path(), &[&words[..], &["--force"]].concat());
        [left(folder.path()), left(&folder.path().join("out.case"))].concat()
    };
    let of_baseline = ["out.baseline.csv", "baseline.csv"];
    let of_mesh = [
        "nodes.csv",
        "elems.csv",
        "electrode_edges.csv",
        "electrodes.csv",
    ];
    let names = of_baseline.iter().chain(&of_mesh);
    let files = export("m1");
    for name in names.clone() {
        assert!(files.iter().any(|file| file == name), "{name}");
    }
    // the session has no baseline, and no configuration that names a mesh
    let files = export("bare");
    for name in names {
        assert!(!files.iter().any(|file| file == name), "{name}");
    }
}

#[test]
fn replay_without_deviations_keeps_none_of_earlier_maps() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    let replay = ["replay", "last", "--no-map", "--preset", "disc-tank"];
    let replay = [&replay[..], &["--noise-v", "2e-6", "--out", "maps.csv"]].concat();
    let deviations = folder.path().join("maps.sd.csv");
    done(folder.path(), &[&replay[..], &["--sd"]].concat());
    assert!(deviations.exists());
    done(folder.path(), &[&replay[..], &["--force"]].concat());
    assert!(!deviations.exists());
}
