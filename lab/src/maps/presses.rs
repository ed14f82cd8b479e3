//! Tables of known presses, a line each: which frame, where, how wide, under which mass or with which loss.

use std::path::{Path, PathBuf};

use studies::Failure;
use survey::Bounds;

/// A line of a table of presses.
pub(crate) struct Press {
    /// Line of the file, from 1.
    pub(crate) line: usize,
    /// Number of its frame.
    pub(crate) frame: u64,
    /// m.
    pub(crate) centre: [f64; 2],
    /// m.
    pub(crate) diameter: f64,
    /// kg.
    pub(crate) mass: Option<f64>,
    /// Relative loss of conductance under it, 0 to 1.
    pub(crate) loss: Option<f64>,
}

/// A table of presses.
pub(crate) struct Presses {
    pub(crate) file: PathBuf,
    pub(crate) all: Vec<Press>,
}

/// The columns, for messages.
const COLUMNS: &str = "frame, x_m, y_m, diameter_m (or x_mm, y_mm, diameter_mm), mass_kg and loss";

impl Presses {
    /// Reads a table. Lengths are in m or mm, as the names of their columns say; `mass_kg` and `loss` may be missing.
    ///
    /// # Errors
    /// File, line, column and value of the first fault.
    pub(crate) fn read(path: &Path) -> Result<Self, Failure> {
        let text = std::fs::read_to_string(path)
            .map_err(|cause| Failure::of(&format!("cannot read {}", path.display()), &cause))?;
        let mut lines = text
            .lines()
            .enumerate()
            .filter(|(_, line)| !line.trim().is_empty());
        let wrong = |line: usize, why: String| {
            Failure::because(format!("{}:{line}: {why}", path.display()))
        };
        let header: Vec<&str> = lines.next().map_or(Vec::new(), |(_, line)| {
            line.split(',').map(str::trim).collect()
        });
        let column = |name: &str| header.iter().position(|found| *found == name);
        let needed = |name: &str| {
            column(name).ok_or_else(|| {
                wrong(
                    1,
                    format!("column '{name}' is missing; known are {COLUMNS}"),
                )
            })
        };
        // a column of lengths, and its unit in m
        let length = |name: &str| match column(&format!("{name}_mm")) {
            Some(column) => Ok((column, 1e-3)),
            None => needed(&format!("{name}_m")).map(|column| (column, 1.0)),
        };
        let frames = needed("frame")?;
        let lengths = [length("x")?, length("y")?, length("diameter")?];
        let (masses, losses) = (column("mass_kg"), column("loss"));
        let all = lines
            .map(|(index, line)| {
                let fields: Vec<&str> = line.split(',').map(str::trim).collect();
                let within = |column: usize, bounds: Bounds| -> Result<f64, Failure> {
                    let text = fields.get(column).copied().unwrap_or("");
                    bounds.parse(text).map_err(|why| {
                        wrong(index + 1, format!("{} is '{text}': {why}", header[column]))
                    })
                };
                let any = Bounds::Within(-1e9, 1e9);
                let above_zero = Bounds::Between(0.0, 1e9);
                let [x, y, diameter] = lengths;
                let frame = within(frames, Bounds::Within(1.0, 1e15))?;
                if frame.fract() != 0.0 {
                    return Err(wrong(
                        index + 1,
                        format!("frame is {frame}, frames are numbered 1, 2, 3"),
                    ));
                }
                let optional = |column: Option<usize>, bounds| {
                    column.map(|column| within(column, bounds)).transpose()
                };
                Ok(Press {
                    line: index + 1,
                    frame: frame as u64,
                    centre: [x.1 * within(x.0, any)?, y.1 * within(y.0, any)?],
                    diameter: diameter.1 * within(diameter.0, above_zero)?,
                    mass: optional(masses, Bounds::Within(0.0, 1e9))?,
                    loss: optional(losses, Bounds::Within(0.0, 1.0))?,
                })
            })
            .collect::<Result<Vec<_>, Failure>>()?;
        Ok(Self {
            file: path.to_owned(),
            all,
        })
    }

    /// A failure of one press.
    pub(crate) fn wrong(&self, press: &Press, why: &str) -> Failure {
        Failure::because(format!("{}:{}: {why}", self.file.display(), press.line))
    }

    /// The row of a press among frames with these numbers.
    ///
    /// # Errors
    /// No such frame; the message says which there are.
    pub(crate) fn row(&self, press: &Press, numbers: &[u64]) -> Result<usize, Failure> {
        let row = numbers.iter().position(|number| *number == press.frame);
        row.ok_or_else(|| {
            let (first, last) = (numbers.first().unwrap_or(&1), numbers.last().unwrap_or(&1));
            let why = format!(
                "frame {} is not there; there are {}, numbered {first} to {last}",
                press.frame,
                numbers.len()
            );
            self.wrong(press, &why)
        })
    }
}
