//! `merit`: figures of merit of raster images, by command lines.

use std::path::Path;

use crate::program::{lab, words};

fn refused(line: &str, paths: &[&Path]) -> String {
    let output = lab(&words(line, paths));
    assert!(!output.status.success());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn images_get_their_figures_with_all_digits() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("one.csv"), "NaN,0,0\n0,4,1\n0,-1,NaN\n").unwrap();
    std::fs::write(at("targets.csv"), "image,x,y\none,0.6,0.8\n").unwrap();
    let output = lab(&words("merit --images {} --json", &[folder.path()]));
    assert!(output.status.success());
    let figures: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for (name, value) in [
        ("amplitude", 4.0),
        ("position_error", 0.5),
        ("resolution", (2.0_f64 / 7.0).sqrt()),
        ("ringing", 0.2),
        // q, the pixels from a quarter of the largest value, has two at a distance of 1; r^2 = 8 / 9 / pi > 1/4
        ("shape_deformation", 0.0),
    ] {
        assert!(
            (figures[name].as_f64().unwrap() - value).abs() < 1e-12,
            "{name}"
        );
    }
    let message = refused(
        "merit --images {} --negate --truth {}",
        &[folder.path(), &at("none")],
    );
    assert!(message.contains("none"), "{message}");
}

#[test]
fn likeness_without_a_true_load_is_left_blank() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [images, truth] = ["images", "truth"].map(at);
    for (folder, image) in [
        (&images, "NaN,0,0\n0,4,1\n0,-1,NaN\n"),
        (&truth, "NaN,0,0\n0,0,0\n0,0,NaN\n"),
    ] {
        std::fs::create_dir(folder).unwrap();
        std::fs::write(folder.join("one.csv"), image).unwrap();
    }
    let merit = |option: &str| {
        let line = format!("merit --images {{}} --truth {{}}{option}");
        let output = lab(&words(&line, &[&images, &truth]));
        String::from_utf8(output.stdout).unwrap()
    };
    let table = merit("");
    let fields: Vec<&str> = table.lines().nth(1).unwrap().split(',').collect();
    assert_eq!((fields[7], fields[8], fields[10]), ("", "", ""), "{table}");
    for folder in [&images, &truth] {
        std::fs::rename(folder.join("one.csv"), folder.join("a \"load\", big.csv")).unwrap();
    }
    let table = merit("");
    let row = table.lines().nth(1).unwrap();
    assert!(row.starts_with("\"a \"\"load\"\", big\","), "{table}");
    let figures: serde_json::Value = serde_json::from_str(&merit(" --json")).unwrap();
    for name in ["correlation", "relative_error", "dice"] {
        assert!(figures[name].is_null(), "{name}: {figures}");
    }
}
