//! `tactus-lab stability`: the table, its files, and invalid case numbers.

use crate::program::{lab, words};

#[test]
fn unknown_case_number_is_refused() {
    let refused = lab(&words("stability --only 41", &[]));
    assert_eq!(refused.status.code(), Some(2));
}

#[test]
fn each_check_is_one_json_line() {
    let output = lab(&words("stability --json --only 38 --only 40", &[]));
    assert!(output.status.success());
    let lines: Vec<serde_json::Value> = String::from_utf8_lossy(&output.stdout)
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    let cases: Vec<_> = lines
        .iter()
        .map(|line| line["case"].as_u64().unwrap())
        .collect();
    let first = cases.iter().take_while(|case| **case == 38).count();
    assert!(first > 0 && cases.len() > first, "{lines:?}");
    assert!(cases[first..].iter().all(|case| *case == 40), "{lines:?}");
}

#[test]
fn table_and_plots_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("stability");
    let output = lab(&words("stability --only 27 --out {}", &[&out]));
    assert!(output.status.success());
    let table = std::fs::read_to_string(out.join("table.txt")).unwrap();
    assert_eq!(table, String::from_utf8_lossy(&output.stdout));
    assert!(table.contains("holds"), "{table}");
    for name in ["contrast", "contact", "sliver"] {
        for ending in ["png", "svg"] {
            assert!(out.join(format!("{name}.{ending}")).is_file());
        }
    }
}
