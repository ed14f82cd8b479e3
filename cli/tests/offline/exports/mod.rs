//! Files for other programs, read back by the libraries that those programs use.

mod films;
mod mat;
mod netcdf;
#[cfg(feature = "parquet")]
mod parquet;
mod pictures;
mod refusals;
mod replaced;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::scene::done;

/// Packages that read the files, in the newest versions of late 2026.
const PACKAGES: [&str; 5] = [
    "numpy==2.4.6",
    "scipy==1.17.1",
    "xarray==2026.9.0",
    "pandas==3.1.1",
    "pyarrow==26.0.1",
];

fn python() -> Option<PathBuf> {
    needs::python(Path::new(env!("CARGO_TARGET_TMPDIR")), "exports", &PACKAGES)
}

/// An array that a script printed: shape and elements, the last dimension varying fastest.
#[derive(Debug, Clone, PartialEq)]
struct Array {
    shape: Vec<usize>,
    values: Vec<String>,
}

impl Array {
    fn numbers(&self) -> Vec<f64> {
        self.values
            .iter()
            .map(|value| value.parse().unwrap())
            .collect()
    }

    /// The bits of the numbers; every NaN has the same bits.
    fn bits(&self) -> Vec<u64> {
        bits(self.numbers())
    }
}

fn bits(numbers: impl IntoIterator<Item = f64>) -> Vec<u64> {
    let bits = |number: f64| if number.is_nan() { 0 } else { number.to_bits() };
    numbers.into_iter().map(bits).collect()
}

/// Runs a script of this folder with a file, and returns the arrays that it printed (name, shape and elements,
/// separated by tabs).
fn read(python: &Path, script: &str, file: &Path) -> BTreeMap<String, Array> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/offline/exports")
        .join(script);
    let printed = needs::run(Command::new(python).arg(script).arg(file)).unwrap();
    let arrays = printed.lines().map(|line| {
        let mut cells = line.split('\t');
        let name = cells.next().unwrap().to_owned();
        let shape = cells.next().unwrap().split('x').filter(|n| !n.is_empty());
        let array = Array {
            shape: shape.map(|n| n.parse().unwrap()).collect(),
            values: cells.map(str::to_owned).collect(),
        };
        (name, array)
    });
    arrays.collect()
}

/// A table of `--format csv`, with cells as text.
struct Cells {
    heading: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Cells {
    fn read(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).unwrap();
        let split = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let mut lines = text.lines().map(split);
        Self {
            heading: lines.next().unwrap(),
            rows: lines.collect(),
        }
    }

    fn column(&self, name: &str) -> Vec<&str> {
        let place = self.heading.iter().position(|cell| cell == name);
        let place = place.unwrap_or_else(|| panic!("no column {name}"));
        self.rows.iter().map(|row| row[place].as_str()).collect()
    }

    /// A column of numbers; an empty cell is NaN.
    fn numbers(&self, name: &str) -> Vec<f64> {
        self.column(name).into_iter().map(number).collect()
    }

    /// The numbers of all rows, from a column on.
    fn block(&self, from: usize) -> Vec<f64> {
        let cells = self.rows.iter().flat_map(|row| &row[from..]);
        cells.map(|cell| number(cell)).collect()
    }
}

fn number(cell: &str) -> f64 {
    match cell {
        "" => f64::NAN,
        cell => cell.parse().unwrap(),
    }
}

/// The tables of the session: frames and baseline.
fn tables(folder: &Path, session: &str) -> (Cells, Cells) {
    done(
        folder,
        &["export", session, "--format", "csv", "--out", "out.csv"],
    );
    (
        Cells::read(&folder.join("out.csv")),
        Cells::read(&folder.join("out.baseline.csv")),
    )
}

/// Number of columns of the table of frames before the voltages.
const BEFORE_VOLTAGES: usize = 10;
