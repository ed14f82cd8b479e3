//! Errors of case folders.

use std::fmt;
use std::path::PathBuf;

use survey::ProtocolError;

use crate::MeshError;

/// Reasons for refusing a case folder or one of its files. Lines are counted from 1.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// A file cannot be written, or exists and must not be replaced.
    #[error(transparent)]
    Unwritten(#[from] outfile::OutFileError),
    /// The file cannot be read.
    #[error("{}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        #[source]
        cause: std::io::Error,
    },
    /// A file of another format.
    #[error("{} is {what}, not a CSV file: {remedy}", .path.display())]
    NotCsv {
        /// The file.
        path: PathBuf,
        /// The detected format.
        what: String,
        /// How to convert it to a CSV file.
        remedy: String,
    },
    /// A column is in another unit.
    #[error("{}:1: column '{has}' is not '{wants}': give the values in that unit", .path.display())]
    Unit {
        /// The file.
        path: PathBuf,
        /// The column's name in the file.
        has: String,
        /// The required name, which includes the unit.
        wants: String,
    },
    /// The extents of the sheet are implausibly large.
    #[error(
        "{}: the sheet is {:.0} m x {:.0} m, and at most {most} m are possible. If the values are in mm, it is {:.0} mm x {:.0} mm: divide them \
         by 1000, x_m and y_m are in m",
        .path.display(), .size_m[0], .size_m[1], .size_m[0], .size_m[1]
    )]
    Large {
        /// The file.
        path: PathBuf,
        /// Extents along x and y, m.
        size_m: [f64; 2],
        /// The largest allowed extent, m.
        most: f64,
    },
    /// A field that should be a number is not.
    #[error("{}:{line}: column {column} is '{text}', which is not a number", .path.display())]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The column, from 1.
        column: usize,
        /// The text found.
        text: String,
    },
    /// A field that is empty, NaN or infinite.
    #[error("{}:{line}: column {column} is empty or not a finite number", .path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The column, from 1.
        column: usize,
    },
    /// A conductance below zero.
    #[error("{}:{line}: conductance {value} S is negative", .path.display())]
    Negative {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The value found.
        value: f64,
    },
    /// A contact impedance below zero.
    #[error("{}:{line}: contact impedance {value} ohm m is negative", .path.display())]
    Contact {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The value found.
        value: f64,
    },
    /// A number that should be an index is not one.
    #[error("{}:{line}: {what} is {value}, which is not an index (0, 1, 2, ...)", .path.display())]
    NotAnIndex {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// Name of the column.
        what: &'static str,
        /// The value found.
        value: f64,
    },
    /// A line with too few or too many fields.
    #[error("{}:{line}: {has} columns, {wants} are needed", .path.display())]
    Columns {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// Number of fields found.
        has: usize,
        /// What is needed, in words.
        wants: String,
    },
    /// A file with too few or too many lines.
    #[error("{}: {has} rows, {wants} are needed", .path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// Number of lines found.
        has: usize,
        /// What is needed, in words.
        wants: String,
    },
    /// Electrode numbers are not consecutive.
    #[error("{}:{line}: electrode {has} where electrode {wants} is expected (numbered from 0, in order)", .path.display())]
    ElectrodeOrder {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The number found.
        has: usize,
        /// The number expected.
        wants: usize,
    },
    /// An electrode or element that does not exist.
    #[error("{}:{line}: {what} {value} does not exist; there are {count}", .path.display())]
    NoSuch {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// `electrode`, `node` or `element`.
        what: &'static str,
        /// The index given.
        value: usize,
        /// How many there are.
        count: usize,
    },
    /// A conductance that does not exist.
    #[error("no conductance '{name}': it is neither a file nor one of {}", .known.join(", "))]
    NoSigma {
        /// The name given.
        name: String,
        /// The names in the case.
        known: Vec<String>,
    },
    /// The mesh is faulty.
    #[error("{}: the mesh is refused", Place(.path, .line))]
    Mesh {
        /// The file.
        path: PathBuf,
        /// The line, if known.
        line: Option<usize>,
        /// Why.
        #[source]
        cause: MeshError,
    },
    /// The protocol is faulty.
    #[error("{}: the protocol is refused", .path.display())]
    Protocol {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        cause: ProtocolError,
    },
}

/// A file, and the line if known.
struct Place<'a>(&'a PathBuf, &'a Option<usize>);

impl fmt::Display for Place<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.display())?;
        self.1.map_or(Ok(()), |line| write!(f, ":{line}"))
    }
}
