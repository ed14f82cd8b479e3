//! Parquet files, read by pandas.

use imaging::quantities::{LoadUnit, Quantity, QuantityRow, store};

use super::refusals::left;
use super::{BEFORE_VOLTAGES, Cells, bits, python, read, tables};
use crate::scene::{
    done, lines, refused, session, session_in_parts, session_with_alarms, session_without_baseline,
};

#[test]
fn parquet_has_the_bits_of_the_tables() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session_with_alarms(folder.path());
    let (frames, _) = tables(folder.path(), "last");
    let export = [
        "export",
        "last",
        "--json",
        "--format",
        "parquet",
        "--out",
        "all.parquet",
    ];
    let written = lines(&done(folder.path(), &export));
    let what: Vec<&str> = written
        .iter()
        .map(|line| line["what"].as_str().unwrap())
        .collect();
    assert_eq!(what, ["frames", "events"], "no quantities are stored");
    let read_file = |name: &str| read(&python, "read_parquet.py", &folder.path().join(name));
    let data = read_file("all.parquet");
    let voltages: Vec<f64> = (0..3)
        .flat_map(|row| (0..208).map(move |reading| (row, reading)))
        .map(|(row, reading)| data[&format!("m{reading}_V")].numbers()[row])
        .collect();
    assert_eq!(bits(voltages), bits(frames.block(BEFORE_VOLTAGES)));
    assert!(data["m7_V"].numbers()[1].is_nan());
    for name in ["sequence", "monotonic_s", "duration_s", "current_A"] {
        assert_eq!(data[name].numbers(), frames.numbers(name), "{name}");
    }
    assert_eq!(data["missing"].values, ["", "m7:overload", ""]);
    assert_eq!(data["missing"].values, frames.column("missing"));
    let times = [1, 2, 3].map(|second| 1e6 * (1_800_000_000.0 + f64::from(second)));
    assert_eq!(data["wall_utc"].numbers(), times);
    assert!(data["wall_utc:dtype"].values[0].contains("UTC"));
    assert_eq!(data[":session"].values, ["m20270115_1"]);
    assert!(data[":source"].values[0].contains("SIMULATED"));
    let events = read_file("all.events.parquet");
    assert_eq!(events["kind"].values, ["alarm-active"; 2]);
    let text = &events["text"].values[1];
    assert_eq!(text, "pressed: load of frame 3 <is> above 3 & stays");
    assert_eq!(
        events["at_utc"].numbers(),
        [1.800_000_002_5e15, 1.800_000_003_5e15]
    );
}

#[test]
fn parquet_quantities_are_those_of_the_command() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    for (minute, mean) in [(0, 0.1), (1, 12.3)] {
        let row = |region: &str, quantity| QuantityRow {
            begin_s: 1_800_000_000 + 60 * minute,
            region: region.into(),
            quantity,
            of: LoadUnit::Pressure,
            min: mean / 3.0,
            mean,
            max: mean * 1.7,
            frames: 60,
            known: 59,
        };
        let rows = [row("sheet", Quantity::Load), row("heel", Quantity::Ppi)];
        store(folder.path(), "m20270115_1", &rows).unwrap();
    }
    let table = done(folder.path(), &["quantities", "last", "--csv"]);
    std::fs::write(folder.path().join("table.csv"), table).unwrap();
    let table = Cells::read(&folder.path().join("table.csv"));
    let export = [
        "export",
        "last",
        "--format",
        "parquet",
        "--out",
        "all.parquet",
    ];
    done(folder.path(), &export);
    let file = folder.path().join("all.quantities.parquet");
    let data = read(&python, "read_parquet.py", &file);
    for name in ["region", "quantity", "unit"] {
        assert_eq!(data[name].values, table.column(name), "{name}");
    }
    for name in ["min", "mean", "max", "frames", "known"] {
        assert_eq!(data[name].bits(), bits(table.numbers(name)), "{name}");
    }
    assert_eq!(data["begin_utc"].numbers()[3], 1.800_000_06e15);
}

#[test]
fn parquet_without_quantities_keeps_none_of_an_earlier_export() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    session_without_baseline(folder.path());
    let row = QuantityRow {
        begin_s: 1_800_000_000,
        region: "sheet".into(),
        quantity: Quantity::Load,
        of: LoadUnit::Pressure,
        min: 1.0,
        mean: 2.0,
        max: 3.0,
        frames: 60,
        known: 60,
    };
    store(folder.path(), "m20270115_1", &[row]).unwrap();
    let export = |session: &str| {
        let words = ["export", session, "--format", "parquet", "--force"];
        done(
            folder.path(),
            &[&words[..], &["--out", "all.parquet"]].concat(),
        );
        folder.path().join("all.quantities.parquet").exists()
    };
    assert!(export("m20270115_1"));
    assert!(!export("bare"));
}

#[test]
fn parquet_of_parts_is_that_of_the_whole() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    session_in_parts(folder.path());
    let export = [
        "export",
        "last",
        "--format",
        "parquet",
        "--out",
        "all.parquet",
    ];
    done(folder.path(), &export);
    let data = read(
        &python,
        "read_parquet.py",
        &folder.path().join("all.parquet"),
    );
    assert_eq!(data["sequence"].numbers(), [1.0, 2.0, 3.0]);
    assert_eq!(data["groups"].values, ["1"]);
}

#[test]
fn parquet_leaves_nothing_half_written() {
    let folder = tempfile::tempdir().unwrap();
    session(folder.path());
    std::fs::write(folder.path().join("all.events.parquet"), "mine").unwrap();
    let export = ["export", "last", "--format", "parquet", "--out"];
    let message = refused(folder.path(), &[&export[..], &["all.parquet"]].concat(), 1);
    assert!(
        message.contains("all.events.parquet exists already"),
        "{message}"
    );
    let message = refused(folder.path(), &[&export[..], &["/dev/stdout"]].concat(), 2);
    assert!(message.contains("several files"), "{message}");
    assert_eq!(left(folder.path()), ["all.events.parquet"]);
}
