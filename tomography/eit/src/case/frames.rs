//! Frames of measured voltages, in rows or columns.

use std::path::Path;

use super::text::{digits, line};
use super::{CaseError, Table};

/// Value that an instrument sends for an overload (SCPI's infinity); values at or above it are missing readings.
const OVERLOAD: f64 = 9.9e37;

/// Heading of the labels of frames.
const LABEL: &str = "frame";

/// Frames of measured voltages, V: a row or a column per frame, whichever fits the number of readings. An empty field,
/// one that is not finite, and an overload (9.9e37) are missing readings.
///
/// # Errors
/// A file that cannot be read, or whose rows and columns both do not match the number of readings; the line is named.
pub fn read_frames(path: &Path, readings: usize) -> Result<Vec<Vec<Option<f64>>>, CaseError> {
    Ok(read_named_frames(path, readings)?
        .into_iter()
        .map(|(_, frame)| frame)
        .collect())
}

/// A frame's label and its readings, V.
pub type NamedFrame = (String, Vec<Option<f64>>);

/// Like [`read_frames`], with the label of each frame: its row's label or its column's name, else its number from 1.
///
/// # Errors
/// As [`read_frames`].
pub fn read_named_frames(path: &Path, readings: usize) -> Result<Vec<NamedFrame>, CaseError> {
    let mut table = Table::read(path)?;
    for value in table.rows.iter_mut().flatten() {
        *value = value.filter(|volts| volts.abs() < OVERLOAD);
    }
    // a numeric label is not a reading if its column is named as labels
    let first = table.header.iter().flatten().next();
    if table.labels.is_none()
        && table.width() == readings + 1
        && first.is_some_and(|name| name == LABEL)
    {
        let label =
            |row: &mut Vec<Option<f64>>| row.remove(0).map_or_else(String::new, |n| n.to_string());
        table.labels = Some(table.rows.iter_mut().map(label).collect());
    }
    let frames = table.rows.len();
    if table.width() == readings && frames > 0 {
        let labels = table
            .labels
            .unwrap_or_else(|| (1..=frames).map(|frame| frame.to_string()).collect());
        return Ok(labels.into_iter().zip(table.rows).collect());
    }
    if frames == readings && table.width() > 0 {
        let names = table
            .header
            .unwrap_or_else(|| (1..=table.rows[0].len()).map(|k| k.to_string()).collect());
        return Ok(names
            .into_iter()
            .enumerate()
            .map(|(k, name)| (name, table.rows.iter().map(|row| row[k]).collect()))
            .collect());
    }
    let wants = format!(
        "{readings} (one row per frame, optionally with a first column '{LABEL}' of labels; or {readings} rows and one column per \
         frame; the file has {frames} rows)"
    );
    Err(table.wrong_columns(
        table.lines.first().copied().unwrap_or(1),
        table.width(),
        wants,
    ))
}

/// Frames as the text of a file: header `m0,m1,...`, a row per frame.
pub fn frames_text(frames: &[Vec<Option<f64>>]) -> String {
    let mut text = String::new();
    if let Some(first) = frames.first() {
        let names: Vec<String> = (0..first.len()).map(|k| format!("m{k}")).collect();
        line(&mut text, &names);
    }
    for frame in frames {
        let fields: Vec<String> = frame
            .iter()
            .map(|value| value.map_or_else(|| "nan".to_owned(), digits))
            .collect();
        line(&mut text, &fields);
    }
    text
}
