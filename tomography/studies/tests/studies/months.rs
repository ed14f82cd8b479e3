//! Presses are located while the sheet drifts. Frames are simulated on the phantom's finer mesh.

use imaging::DriftRule;
use studies::honesty::MapMethod;
use studies::months::{self, Family, LoadKind, Locator, LongScene, MapSettings, Report, Settings};

fn settings() -> Settings {
    Settings {
        seed: 77,
        families: vec![Family::GainContacts],
        sheets: 1,
        presses: 1,
        scenes: Vec::new(),
        days: 0.0,
        maps: MapSettings::default(),
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
fn removed_drift_leaves_a_map_of_the_load() {
    let settings = Settings {
        presses: 0,
        maps: MapSettings {
            loads: 1,
            methods: vec![MapMethod::OneStep],
            models: Vec::new(),
        },
        ..settings()
    };
    let report = months::run(&settings).unwrap();
    println!("{}", report.text());
    let worst = |drift: DriftRule, load: LoadKind| {
        let of = |row: &&months::MapRow| (row.drift, row.load) == (drift, load);
        let rows = report.maps.iter().filter(of);
        rows.filter_map(|row| row.p95_mm).fold(0.0, f64::max)
    };
    assert!(worst(DriftRule::Frame, LoadKind::Press10) < 5.0);
    assert!(worst(DriftRule::Off, LoadKind::Press10) > 20.0);
    assert!(worst(DriftRule::Frame, LoadKind::Press30) < 1.5);
    assert!(worst(DriftRule::Off, LoadKind::Press30) > 1.5);
    for row in &report.maps {
        assert!((0.2..=1.0).contains(&row.resolved), "{row:?}");
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
