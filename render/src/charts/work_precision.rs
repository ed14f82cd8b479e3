//! Accuracy against time: a panel per test set, a point per method.

use plotters::prelude::*;

use crate::PictureError;
use crate::drawing::canvas::{COLOURS, Drawing, FINER, GRID, PALE};
use crate::drawing::pen::{Anchor, INK, Pen};

/// One method on one set.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkPoint {
    /// The set: points of the same set share a panel.
    pub panel: String,
    /// The method.
    pub name: String,
    /// Time per frame, ms.
    pub ms: f64,
    /// The accuracy, 0 to 1, upwards.
    pub value: f64,
    /// Additional text for the label.
    pub words: String,
}

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 330.0;

/// A PNG with two panels per row; `marks` are times (ms) drawn as vertical lines with their names.
///
/// # Errors
/// No point, a value that is not finite or a time that is not positive; or a drawing that fails.
pub fn work_precision_png(
    title: &str,
    points: &[WorkPoint],
    marks: &[(&str, f64)],
) -> Result<Vec<u8>, PictureError> {
    let sound = |p: &&WorkPoint| p.value.is_finite() && p.ms > 0.0 && p.ms.is_finite();
    if points.is_empty() || points.iter().filter(sound).count() < points.len() {
        return Err(PictureError::EmptyGrid);
    }
    let mut panels: Vec<&str> = Vec::new();
    for point in points {
        if !panels.contains(&point.panel.as_str()) {
            panels.push(&point.panel);
        }
    }
    let times = points.iter().map(|p| p.ms).chain(marks.iter().map(|m| m.1));
    let low = times.clone().fold(f64::INFINITY, f64::min).log10().floor();
    let high = times.fold(0.0, f64::max).log10().ceil().max(low + 1.0);
    let plot = Plot {
        title,
        points,
        marks,
        panels,
        ends: [low, high],
    };
    plot.png()
}

/// Panels row by row, and the range of their axis in powers of ten.
struct Plot<'a> {
    title: &'a str,
    points: &'a [WorkPoint],
    marks: &'a [(&'a str, f64)],
    panels: Vec<&'a str>,
    ends: [f64; 2],
}

impl Plot<'_> {
    fn columns(&self) -> usize {
        self.panels.len().min(2)
    }
}

impl Drawing for Plot<'_> {
    fn size(&self) -> [f64; 2] {
        let columns = self.columns();
        let rows = self.panels.len().div_ceil(columns);
        [WIDTH * columns as f64 + 20.0, HEIGHT * rows as f64 + 44.0]
    }

    fn draw<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        let middle = self.size()[0] / 2.0;
        pen.bold(self.title, [middle, 22.0], 15.0, INK, Anchor::Centre)?;
        for (k, name) in self.panels.iter().enumerate() {
            let (row, column) = (k / self.columns(), k % self.columns());
            let corner = [WIDTH * column as f64 + 10.0, HEIGHT * row as f64 + 40.0];
            panel(pen, corner, name, self.points, self.marks, self.ends)?;
        }
        Ok(())
    }
}

fn panel<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    corner: [f64; 2],
    name: &str,
    points: &[WorkPoint],
    marks: &[(&str, f64)],
    [low, high]: [f64; 2],
) -> Result<(), PictureError> {
    let (left, top) = (corner[0] + 44.0, corner[1] + 26.0);
    let (wide, tall) = (WIDTH - 70.0, HEIGHT - 80.0);
    let x = |ms: f64| left + (ms.log10() - low) / (high - low) * wide;
    let y = |value: f64| top + (1.0 - value.clamp(0.0, 1.0)) * tall;
    pen.bold(
        name,
        [left + wide / 2.0, corner[1] + 10.0],
        13.0,
        INK,
        Anchor::Centre,
    )?;
    for decade in low as i32..=high as i32 {
        let at = left + (f64::from(decade) - low) / (high - low) * wide;
        pen.line([[at, top], [at, top + tall]], GRID, 0.5)?;
        let words = if decade < 0 {
            format!("{:.*}", decade.unsigned_abs() as usize, 10_f64.powi(decade))
        } else {
            format!("{:.0}", 10_f64.powi(decade))
        };
        pen.text(&words, [at, top + tall + 11.0], 10.0, INK, Anchor::Centre)?;
    }
    for k in 0..=5 {
        let value = f64::from(k) / 5.0;
        pen.line([[left, y(value)], [left + wide, y(value)]], GRID, 0.5)?;
        pen.text(
            &format!("{value:.1}"),
            [left - 6.0, y(value)],
            10.0,
            INK,
            Anchor::Right,
        )?;
    }
    pen.text(
        "ms a frame",
        [left + wide / 2.0, top + tall + 26.0],
        10.0,
        INK,
        Anchor::Centre,
    )?;
    for (k, (words, ms)) in marks.iter().enumerate() {
        pen.line([[x(*ms), top], [x(*ms), top + tall]], PALE, 1.5)?;
        let at = [x(*ms) + 3.0, top + tall - 8.0 - 12.0 * k as f64];
        pen.text(words, at, 9.0, RGBColor(90, 90, 96), Anchor::Left)?;
    }
    // overlapping labels move down
    let mut taken: Vec<[f64; 2]> = Vec::new();
    let here: Vec<&WorkPoint> = points.iter().filter(|p| p.panel == name).collect();
    for (k, point) in here.iter().enumerate() {
        let colour = COLOURS[k % COLOURS.len()];
        let at = [x(point.ms), y(point.value)];
        pen.draw(Circle::new(
            pen.pixel(at),
            (4.0 * FINER as f64) as i32,
            colour.filled(),
        ))?;
        let right = at[0] < left + 0.62 * wide;
        let mut place = [at[0] + if right { 8.0 } else { -8.0 }, at[1]];
        while taken
            .iter()
            .any(|t| (t[1] - place[1]).abs() < 11.0 && (t[0] - place[0]).abs() < 150.0)
        {
            place[1] += 11.0;
        }
        taken.push(place);
        let words = if point.words.is_empty() {
            point.name.clone()
        } else {
            format!("{}, {}", point.name, point.words)
        };
        let anchor = if right { Anchor::Left } else { Anchor::Right };
        pen.text(&words, place, 10.0, colour, anchor)?;
    }
    Ok(())
}
