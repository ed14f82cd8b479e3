//! `tactus-lab paper`: what is made once is not made again, and what others made is named.

use std::path::Path;
use std::process::{Command, Output};

fn figure(number: &str, out: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tactus-lab"))
        .args(["paper", "--quick", "--figure", number, "--out"])
        .arg(out)
        .output()
        .unwrap()
}

#[test]
fn the_mesh_is_drawn_once_and_made_again_only_by_other_words() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("paper");
    let first = figure("3", &out);
    assert!(
        first.status.success(),
        "{}",
        String::from_utf8_lossy(&first.stderr)
    );
    for file in [
        "figure-3.png",
        "figure-3.svg",
        "settings.json",
        "case/nodes.csv",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    // the same words made it: it is taken as it lies there, and a fault in it is named
    let nodes = out.join("case/nodes.csv");
    let whole = std::fs::read_to_string(&nodes).unwrap();
    std::fs::write(&nodes, "x_m,y_m\n0,zero\n").unwrap();
    let spoiled = figure("3", &out);
    assert!(!spoiled.status.success());
    let said = String::from_utf8_lossy(&spoiled.stderr).into_owned();
    assert!(said.contains("nodes.csv"), "{said}");
    // other words made it: it is made again
    std::fs::write(out.join("case.command"), "mesh --preset disc-tank\n").unwrap();
    let again = figure("3", &out);
    assert!(
        again.status.success(),
        "{}",
        String::from_utf8_lossy(&again.stderr)
    );
    assert_eq!(std::fs::read_to_string(&nodes).unwrap(), whole);
}

#[test]
fn a_figure_that_the_paper_does_not_have_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = figure("8", folder.path());
    assert_eq!(refused.status.code(), Some(2));
}
