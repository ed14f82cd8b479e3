//! Rows of quantities in the file next to their session.

use std::collections::BTreeMap;
use std::path::Path;

use logbook::{LogbookError, StateKind};
use serde::{Deserialize, Serialize};

use super::QuantifierState;
use super::minutes::QuantityRow;
use super::quantity::{LoadUnit, Quantity};
use crate::tracking::{keep_as, kept_as};

/// Length of the stored time spans, s.
pub const STORED_S: u32 = 60;

/// One line of the file: a time span of all regions.
#[derive(Debug, Serialize, Deserialize)]
struct StoredSpan {
    begin_s: i64,
    of: LoadUnit,
    regions: Vec<StoredRegion>,
}

#[derive(Debug, Serialize, Deserialize)]
struct StoredRegion {
    name: String,
    /// Smallest, mean and largest value; number of frames with a value, and number of known ones among them.
    values: BTreeMap<Quantity, (f32, f32, f32, u64, u64)>,
}

/// Appends the rows of one span to those of a session.
///
/// # Errors
/// A disk error.
pub fn store(folder: &Path, session: &str, rows: &[QuantityRow]) -> Result<(), LogbookError> {
    let Some(first) = rows.first() else {
        return Ok(());
    };
    let regions = rows
        .chunk_by(|a, b| a.region == b.region)
        .map(|rows| StoredRegion {
            name: rows[0].region.clone(),
            values: rows
                .iter()
                .map(|row| {
                    let short = (row.min as f32, row.mean as f32, row.max as f32);
                    (
                        row.quantity,
                        (short.0, short.1, short.2, row.frames, row.known),
                    )
                })
                .collect(),
        })
        .collect();
    let span = StoredSpan {
        begin_s: first.begin_s,
        of: first.of,
        regions,
    };
    // a struct of numbers and strings can always be serialised
    let json = serde_json::to_string(&span).unwrap_or_default();
    logbook::append_quantities(folder, session, &json)
}

/// The rows stored with a session, in order of time, with values of seven digits; `None` if it has none. The second
/// value is the number of damaged lines.
///
/// # Errors
/// A file that cannot be read.
pub fn stored(
    folder: &Path,
    session: &str,
) -> Result<Option<(Vec<QuantityRow>, usize)>, LogbookError> {
    let Some(found) = logbook::quantity_lines(folder, session)? else {
        return Ok(None);
    };
    let mut damaged = found.damaged;
    let mut rows = Vec::new();
    for line in found.lines {
        // a later version may have written quantities that this version does not have
        let Ok(span) = serde_json::from_str::<StoredSpan>(&line.json) else {
            damaged += 1;
            continue;
        };
        for region in span.regions {
            for (quantity, (min, mean, max, frames, known)) in region.values {
                rows.push(QuantityRow {
                    begin_s: span.begin_s,
                    region: region.name.clone(),
                    quantity,
                    of: span.of,
                    min: f64::from(min),
                    mean: f64::from(mean),
                    max: f64::from(max),
                    frames,
                    known,
                });
            }
        }
    }
    Ok(Some((rows, damaged)))
}

/// The state of a session's quantities over time after a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptCourse {
    /// The frame.
    pub sequence: u64,
    /// The state after it.
    pub state: QuantifierState,
}

/// Stores the state next to the session, in place of an earlier one.
///
/// # Errors
/// A disk error; the earlier state remains.
pub fn keep_course(folder: &Path, session: &str, kept: &KeptCourse) -> Result<(), LogbookError> {
    keep_as(folder, session, StateKind::Course, kept)
}

/// The state stored next to a session; `None` if there is none.
///
/// # Errors
/// A file that cannot be read or is damaged.
pub fn kept_course(folder: &Path, session: &str) -> Result<Option<KeptCourse>, LogbookError> {
    kept_as(folder, session, StateKind::Course)
}

/// Removes the rows in another unit than that of the last row, and returns their number. A session has two units if its
/// model was calibrated during the recording.
pub fn keep_newest_unit(rows: &mut Vec<QuantityRow>) -> usize {
    let all = rows.len();
    if let Some(unit) = rows.last().map(|row| row.of) {
        rows.retain(|row| row.of == unit);
    }
    all - rows.len()
}

/// Joins rows of one unit to spans of `span_s`, s, a multiple of their own length. The result is in order of time, even
/// if the clock was set back.
pub fn joined(rows: &[QuantityRow], span_s: u32) -> Vec<QuantityRow> {
    let span_s = i64::from(span_s.max(1));
    let mut rows: Vec<&QuantityRow> = rows.iter().collect();
    rows.sort_by_key(|row| row.begin_s);
    let mut joined: Vec<QuantityRow> = Vec::new();
    let mut from = 0;
    for row in rows {
        let begin_s = row.begin_s.div_euclid(span_s) * span_s;
        if joined
            .get(from)
            .is_some_and(|first| first.begin_s != begin_s)
        {
            from = joined.len();
        }
        let same = |other: &&mut QuantityRow| {
            (other.quantity, other.of) == (row.quantity, row.of) && other.region == row.region
        };
        match joined[from..].iter_mut().find(same) {
            None => joined.push(QuantityRow {
                begin_s,
                ..row.clone()
            }),
            Some(sum) => {
                sum.min = sum.min.min(row.min);
                sum.max = sum.max.max(row.max);
                sum.frames += row.frames;
                sum.known += row.known;
                sum.mean += (row.mean - sum.mean) * row.frames as f64 / sum.frames as f64;
            }
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(begin_s: i64, mean: f64, frames: u64) -> QuantityRow {
        QuantityRow {
            begin_s,
            region: "sheet".into(),
            quantity: Quantity::Load,
            of: LoadUnit::Pressure,
            min: mean - 0.5,
            mean,
            max: mean + 0.5,
            frames,
            known: 1,
        }
    }

    #[test]
    fn stored_rows_are_read_again_and_joined() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(stored(folder.path(), "m1").unwrap(), None);
        for row in [row(0, 2.0, 30), row(60, 5.0, 10), row(120, 1.0, 60)] {
            store(folder.path(), "m1", &[row]).unwrap();
        }
        let (rows, damaged) = stored(folder.path(), "m1").unwrap().unwrap();
        assert_eq!((rows.len(), damaged), (3, 0));
        assert_eq!(rows[2], row(120, 1.0, 60));
        let joined = joined(&rows, 120);
        // joined from 30 frames of mean 2 and 10 of mean 5
        let first = QuantityRow {
            min: 1.5,
            max: 5.5,
            known: 2,
            ..row(0, 2.75, 40)
        };
        assert_eq!(joined, [first, row(120, 1.0, 60)]);
    }

    #[test]
    fn rows_of_two_units_and_a_repeated_minute_are_joined_apart() {
        let relative = |begin_s, mean, frames| QuantityRow {
            of: LoadUnit::RelativeLoss,
            ..row(begin_s, mean, frames)
        };
        // the clock was set back by two minutes, then the model was calibrated
        let mut rows = vec![
            relative(0, 2.0, 10),
            relative(120, 4.0, 10),
            relative(0, 6.0, 10),
            row(60, 1.0, 30),
        ];
        let minutes = joined(&rows, 60);
        let begins: Vec<i64> = minutes.iter().map(|row| row.begin_s).collect();
        assert_eq!(begins, [0, 60, 120]);
        assert_eq!((minutes[0].mean, minutes[0].frames), (4.0, 20));
        let spans = joined(&rows, 120);
        assert_eq!(spans.len(), 3);
        assert_eq!((spans[0].of, spans[0].mean), (LoadUnit::RelativeLoss, 4.0));
        assert_eq!((spans[1].of, spans[1].mean), (LoadUnit::Pressure, 1.0));
        assert_eq!(keep_newest_unit(&mut rows), 3);
        assert_eq!(rows, [row(60, 1.0, 30)]);
    }
}
