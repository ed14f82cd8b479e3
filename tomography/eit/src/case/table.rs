//! Tables of numbers in the format of case folders: header, labels, line numbers.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use super::CaseError;

/// Units of columns, and units that are mistaken for them.
const OTHER_UNITS: [(&str, &[&str]); 2] = [
    ("_m", &["_mm", "_cm", "_um", "_inch"]),
    ("_A", &["_mA", "_uA"]),
];

/// A table of numbers as read from a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    path: PathBuf,
    /// Names of the columns of numbers, if there was a header.
    pub header: Option<Vec<String>>,
    /// Labels of the rows, if the first column was text.
    pub labels: Option<Vec<String>>,
    /// Line of each row.
    pub(super) lines: Vec<usize>,
    /// The numbers; an empty field or `nan` is `None`.
    pub rows: Vec<Vec<Option<f64>>>,
}

impl Table {
    /// Reads a file by the rule at the top of this module. Empty lines are skipped.
    ///
    /// # Errors
    /// A file that cannot be read or is of another format, a field that is not a number, or a line with another number of columns than the
    /// first.
    pub fn read(path: &Path) -> Result<Self, CaseError> {
        let bytes = std::fs::read(path).map_err(|cause| CaseError::Io {
            path: path.to_owned(),
            cause,
        })?;
        if let Some([what, remedy]) = super::foreign::format(&bytes) {
            return Err(CaseError::NotCsv {
                path: path.to_owned(),
                what,
                remedy,
            });
        }
        // text in UTF-8, or it would be of another format
        let text = String::from_utf8_lossy(&bytes);
        let mut lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.trim().trim_start_matches('\u{feff}')))
            .filter(|(_, line)| !line.is_empty())
            .map(|(line, text)| (line, text.split(',').map(str::trim).collect::<Vec<_>>()))
            .peekable();
        let is_text = |field: &&str| !field.is_empty() && field.parse::<f64>().is_err();
        // if the only text of the first line is its first field and the second line looks the same, it is a labelled
        // row
        let all: Vec<(usize, Vec<&str>)> = lines.by_ref().collect();
        let first_is_header = match all.first() {
            None => false,
            Some((_, fields)) => {
                let texts = fields.iter().filter(|field| is_text(field)).count();
                let only_label = texts == 1 && is_text(&fields[0]) && fields.len() > 1;
                texts > 0 && !only_label
            }
        };
        let (head, body) = all.split_at(usize::from(first_is_header));
        let labelled = body
            .first()
            .is_some_and(|(_, fields)| fields.len() > 1 && is_text(&fields[0]));
        let skip = usize::from(labelled);
        let width = head
            .first()
            .or(body.first())
            .map_or(0, |(_, fields)| fields.len());
        let mut table = Self {
            path: path.to_owned(),
            header: head.first().map(|(_, fields)| {
                fields
                    .iter()
                    .skip(skip)
                    .map(|field| (*field).to_owned())
                    .collect()
            }),
            labels: labelled.then(Vec::new),
            lines: Vec::new(),
            rows: Vec::new(),
        };
        for (line, fields) in body {
            let line = *line;
            if fields.len() != width {
                return Err(table.wrong_columns(line, fields.len(), width));
            }
            if let Some(labels) = &mut table.labels {
                labels.push(fields[0].to_owned());
            }
            let numbers = fields
                .iter()
                .enumerate()
                .skip(skip)
                .map(|(column, field)| {
                    if field.is_empty() {
                        return Ok(None);
                    }
                    field
                        .parse::<f64>()
                        .map(|value| Some(value).filter(|value| value.is_finite()))
                        .map_err(|_| {
                            let column = column + 1;
                            let fault =
                                format!("column {column} is '{field}', which is not a number");
                            CaseError::refused(path, line, fault)
                        })
                })
                .collect::<Result<_, _>>()?;
            table.lines.push(line);
            table.rows.push(numbers);
        }
        Ok(table)
    }

    /// Number of columns of numbers.
    pub fn width(&self) -> usize {
        self.rows.first().map_or(0, Vec::len)
    }

    /// The table, if its header names none of these columns in another unit, e.g. `x_mm` for `x_m`. Other names are
    /// ignored.
    pub(super) fn in_units(&self, columns: &[&str]) -> Result<&Self, CaseError> {
        for (has, wants) in self.header.iter().flatten().zip(columns) {
            for (unit, others) in OTHER_UNITS {
                let quantity = wants.strip_suffix(unit);
                let other = quantity.and_then(|quantity| has.strip_prefix(quantity));
                if other.is_some_and(|other| others.contains(&other)) {
                    let fault =
                        format!("column '{has}' is not '{wants}': give the values in that unit");
                    return Err(self.refused(1, fault));
                }
            }
        }
        Ok(self)
    }

    /// All rows with the number of columns in the range, every field a number.
    pub(super) fn numbers(
        &self,
        least: usize,
        most: usize,
    ) -> Result<Vec<(usize, Vec<f64>)>, CaseError> {
        self.lines
            .iter()
            .zip(&self.rows)
            .map(|(&line, row)| {
                if !(least..=most).contains(&row.len()) {
                    let wants = if least == most {
                        least.to_string()
                    } else {
                        format!("{least} to {most}")
                    };
                    return Err(self.wrong_columns(line, row.len(), wants));
                }
                let numbers = row
                    .iter()
                    .enumerate()
                    .map(|(column, value)| {
                        value.ok_or_else(|| {
                            // of the file, where labels are the first
                            let column = column + 1 + usize::from(self.labels.is_some());
                            let fault = format!("column {column} is empty or not a finite number");
                            self.refused(line, fault)
                        })
                    })
                    .collect::<Result<_, _>>()?;
                Ok((line, numbers))
            })
            .collect()
    }

    /// The error of a line of this table.
    pub(super) fn refused(&self, line: usize, fault: String) -> CaseError {
        CaseError::refused(&self.path, line, fault)
    }

    /// The error of a line with too few or too many fields.
    pub(super) fn wrong_columns(&self, line: usize, has: usize, wants: impl Display) -> CaseError {
        let beside = if self.labels.is_some() {
            " beside the labels"
        } else {
            ""
        };
        self.refused(line, format!("{has} columns{beside}, {wants} are needed"))
    }

    pub(super) fn index(&self, line: usize, what: &str, value: f64) -> Result<usize, CaseError> {
        if value >= 0.0 && value.fract() == 0.0 && value < 1e15 {
            Ok(value as usize)
        } else {
            let fault = format!("{what} is {value}, which is not an index (0, 1, 2, ...)");
            Err(self.refused(line, fault))
        }
    }

    pub(super) fn below(
        &self,
        line: usize,
        what: &str,
        value: f64,
        count: usize,
    ) -> Result<usize, CaseError> {
        let value = self.index(line, what, value)?;
        if value < count {
            Ok(value)
        } else {
            let fault = format!("{what} {value} does not exist; there are {count}");
            Err(self.refused(line, fault))
        }
    }
}
