//! The hard cases by number: each keeps its bound, and the naive form beside it breaks it or is said not to.

mod workshop;

use serde_json::Value;
use workshop::{lab, words};

/// Lines of the table for one case.
fn found(number: u8) -> Vec<Value> {
    let output = lab(&words(&format!("stability --json --only {number}"), &[]));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{said}");
    let lines = said
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    lines
}

fn holds(number: u8) {
    let lines = found(number);
    assert!(!lines.is_empty());
    for line in lines {
        assert_eq!(line["case"], number);
        assert_eq!(line["verdict"], "holds", "{line}");
        let figure = |key: &str| line[key].as_f64();
        let (ours, bound) = (figure("ours").unwrap(), figure("bound").unwrap());
        let within = |figure: f64| match line["side"].as_str() {
            Some("at most") => figure <= bound,
            Some("at least") => figure >= bound,
            side => panic!("{side:?}"),
        };
        assert!(within(ours), "{line}");
        match (line["naive_breaks"].as_bool(), figure("naive")) {
            (Some(true), Some(naive)) => assert!(!within(naive), "{line}"),
            // it has no number: what it does instead is said
            (Some(true), None) => assert!(line["naive"].is_string(), "{line}"),
            (Some(false), _) => assert_ne!(line["note"], "", "{line}"),
            (None, _) => panic!("{line}"),
        }
    }
}

macro_rules! cases {
    ($($name:ident $number:literal)*) => { $(
        #[test]
        fn $name() {
            holds($number);
        }
    )* };
}

cases! {
    case_01_no_conductance 1
    case_02_insulating_contrast 2
    case_03_conductive_contrast 3
    case_04_single_precision 4
    case_05_vanishing_contact 5
    case_06_open_contact 6
    case_07_floating_potential 7
    case_08_units 8
    case_09_slivers 9
    case_10_narrow_electrode 10
    case_11_electrode_edge_singularity 11
    case_12_absolute_and_difference_error 12
    case_13_sensitivity 13
}
