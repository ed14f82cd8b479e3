//! Presses are found while the sheet drifts. Data from the phantom's finer mesh.

use studies::months::{self, Family, Locator, LongScene, Report, Settings};

fn settings() -> Settings {
    Settings {
        seed: 77,
        families: vec![Family::GainContacts],
        sheets: 1,
        presses: 1,
        scenes: Vec::new(),
        days: 0.0,
        load_days: 0.0,
    }
}

fn worst(report: &Report, locator: Locator) -> f64 {
    let rows = report.single.iter().filter(|row| row.locator == locator);
    rows.map(|row| row.p95_mm).fold(0.0, f64::max)
}

#[test]
fn presses_are_found_with_a_baseline_of_ninety_days() {
    let report = months::run(&settings()).unwrap();
    println!("{}", report.text());
    let disc = worst(&report, Locator::EvidenceDisc);
    assert!(disc < 1.5, "{disc} mm");
    assert!(worst(&report, Locator::OneStep) > 10.0);
    for row in &report.sheets {
        assert!(row.misfit_percent < row.nominal_misfit_percent, "{row:?}");
        assert!(row.misfit_percent < 1.0, "{row:?}");
    }
}

#[test]
fn tracked_baseline_finds_presses_and_no_false_load() {
    let settings = Settings {
        families: Vec::new(),
        sheets: 0,
        scenes: vec![LongScene::Month],
        days: 1.5,
        ..settings()
    };
    let report = months::run(&settings).unwrap();
    println!("{}", report.text());
    for row in &report.presses {
        assert_eq!(row.missed, 0, "{row:?}");
        assert!(row.mean_mm < 1.5, "{row:?}");
    }
    for row in &report.frames {
        assert_eq!(
            (row.false_loads, row.missed_nights, row.faults),
            (0, 0, 0),
            "{row:?}"
        );
        assert!(row.zero_percent < 1.0, "{row:?}");
    }
}
