//! Tables of known presses, a line each: its frame, position, diameter, and its mass or loss.

use std::path::{Path, PathBuf};

use imaging::recorded::{FrameTable, LabelledReadings};
use studies::Failure;
use survey::Bounds;

/// A line of a table of presses.
pub(crate) struct Press {
    /// Line of the file, from 1.
    pub(crate) line: usize,
    /// Label or number of its frame.
    pub(crate) frame: String,
    /// Position of the centre, m.
    pub(crate) centre: [f64; 2],
    /// Diameter, m.
    pub(crate) diameter: f64,
    /// Mass on the press, kg.
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
    /// Reads a table. Lengths are in m or mm, depending on the names of their columns. `mass_kg` and `loss` may be
    /// missing, or blank if they are not known.
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
        // a column of lengths, with the factor from its unit to m
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
                let optional = |column: Option<usize>, bounds| {
                    let known = column.filter(|column| fields.get(*column) != Some(&""));
                    known.map(|column| within(column, bounds)).transpose()
                };
                Ok(Press {
                    line: index + 1,
                    frame: fields.get(frames).copied().unwrap_or("").to_owned(),
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

    /// An error about one press, with file and line.
    pub(crate) fn wrong(&self, press: &Press, why: &str) -> Failure {
        Failure::because(format!("{}:{}: {why}", self.file.display(), press.line))
    }

    /// The row of a press among the frames: that of the frame with its label, otherwise with its number.
    ///
    /// # Errors
    /// No such frame; the message lists the existing ones.
    pub(crate) fn row(&self, press: &Press, table: &FrameTable) -> Result<usize, Failure> {
        let (frames, numbers) = (&table.frames, &table.numbers);
        let labelled = frames.iter().position(|(label, _)| *label == press.frame);
        // spreadsheets write whole numbers as 3.0
        let number: Option<f64> = press.frame.parse().ok();
        let numbered = || numbers.iter().position(|own| Some(*own as f64) == number);
        labelled.or_else(numbered).ok_or_else(|| {
            let number = |end: Option<&u64>| end.copied().unwrap_or(1);
            let label = |end: Option<&LabelledReadings>| end.map_or("", |(label, _)| label).to_owned();
            let why = format!(
                "frame {} does not exist; there are {} frames, numbered {} to {}, with the labels '{}' to '{}'",
                press.frame,
                numbers.len(),
                number(numbers.first()),
                number(numbers.last()),
                label(frames.first()),
                label(frames.last()),
            );
            self.wrong(press, &why)
        })
    }
}
