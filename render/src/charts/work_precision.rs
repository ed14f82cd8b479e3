//! Accuracy against time: a panel per test set, a point per method.

use plotters::prelude::*;

use crate::PictureError;
use crate::drawing::canvas::{Drawing, FINER, GRID, PALE, colour_of};
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
    /// The accuracy, 0 to 1, drawn upwards.
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
    for (_, ms) in marks {
        pen.line([[x(*ms), top], [x(*ms), top + tall]], PALE, 1.5)?;
    }
    let here: Vec<&WorkPoint> = points.iter().filter(|p| p.panel == name).collect();
    let mut labels = Labels {
        inside: Area {
            low: [left, top - 8.0],
            high: [left + wide + 16.0, top + tall],
        },
        taken: here
            .iter()
            .map(|point| Area::around([x(point.ms), y(point.value)], [5.0, 5.0]))
            .collect(),
    };
    let of_marks = marks.iter().enumerate().map(|(k, (words, ms))| Label {
        words: (*words).to_owned(),
        at: [x(*ms), top + tall - 8.0 - 12.0 * k as f64],
        size: 9.0,
        colour: RGBColor(90, 90, 96),
    });
    let of_points = here.iter().enumerate().map(|(k, point)| Label {
        words: match point.words.as_str() {
            "" => point.name.clone(),
            words => format!("{}, {words}", point.name),
        },
        at: [x(point.ms), y(point.value)],
        size: 10.0,
        colour: colour_of(&point.name, k),
    });
    let mut placed = Vec::new();
    for label in of_marks.chain(of_points) {
        let area = labels.place(pen, &label)?;
        let end = label.at[0].clamp(area.low[0], area.high[0]);
        if (area.middle()[1] - label.at[1]).abs() > 8.0 {
            pen.line([label.at, [end, area.middle()[1]]], label.colour, 0.6)?;
        }
        placed.push((label, area));
    }
    for (label, area) in placed {
        let Area { low, high } = area;
        pen.area(&[low, [high[0], low[1]], high, [low[0], high[1]]], WHITE)?;
        let middle = area.middle();
        pen.text(
            &label.words,
            middle,
            label.size,
            label.colour,
            Anchor::Centre,
        )?;
    }
    for (k, point) in here.iter().enumerate() {
        pen.draw(Circle::new(
            pen.pixel([x(point.ms), y(point.value)]),
            (4.0 * FINER as f64) as i32,
            colour_of(&point.name, k).filled(),
        ))?;
    }
    Ok(())
}

/// A rectangle, in points.
#[derive(Debug, Clone, Copy)]
struct Area {
    low: [f64; 2],
    high: [f64; 2],
}

impl Area {
    fn around(at: [f64; 2], half: [f64; 2]) -> Self {
        Self {
            low: [at[0] - half[0], at[1] - half[1]],
            high: [at[0] + half[0], at[1] + half[1]],
        }
    }

    fn middle(&self) -> [f64; 2] {
        [0, 1].map(|i| (self.low[i] + self.high[i]) / 2.0)
    }

    fn overlaps(&self, other: &Self) -> bool {
        (0..2).all(|i| self.low[i] < other.high[i] && other.low[i] < self.high[i])
    }

    fn contains(&self, other: &Self) -> bool {
        (0..2).all(|i| self.low[i] <= other.low[i] && other.high[i] <= self.high[i])
    }
}

/// A text that belongs to a point.
struct Label {
    words: String,
    at: [f64; 2],
    size: f64,
    colour: RGBColor,
}

/// Labels of a panel that overlap neither each other nor a point, and stay inside.
struct Labels {
    inside: Area,
    taken: Vec<Area>,
}

impl Labels {
    /// Finds the place of a label at the point it belongs to.
    fn place<DB: DrawingBackend>(
        &mut self,
        pen: &Pen<'_, DB>,
        label: &Label,
    ) -> Result<Area, PictureError> {
        let half = [
            pen.text_width(&label.words, label.size)? / 2.0 + 1.0,
            0.6 * label.size,
        ];
        let area = self.free(label.at, half);
        self.taken.push(area);
        Ok(area)
    }

    /// The nearest free place to the right or left of a point; beside it if all are taken.
    fn free(&self, at: [f64; 2], half: [f64; 2]) -> Area {
        let beside = |side: f64, down: f64| {
            Area::around([at[0] + side * (half[0] + 8.0), at[1] + down], half)
        };
        let middle = (self.inside.low[0] + self.inside.high[0]) / 2.0;
        let first = if at[0] < middle { 1.0 } else { -1.0 };
        (0..20)
            .flat_map(|step| [1.0, -1.0].map(|sign| sign * 6.0 * f64::from(step)))
            .flat_map(|down| [first, -first].map(|side| beside(side, down)))
            .find(|area| {
                self.inside.contains(area) && !self.taken.iter().any(|taken| taken.overlaps(area))
            })
            .unwrap_or_else(|| beside(first, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_overlap_neither_points_nor_each_other() {
        let mut labels = Labels {
            inside: Area {
                low: [0.0; 2],
                high: [400.0, 250.0],
            },
            taken: Vec::new(),
        };
        let points = [[50.0, 100.0], [52.0, 101.0], [51.0, 99.0], [390.0, 249.0]];
        labels.taken = points.map(|at| Area::around(at, [5.0; 2])).to_vec();
        for at in points {
            let area = labels.free(at, [60.0, 6.0]);
            assert!(labels.inside.contains(&area), "{area:?}");
            assert!(
                !labels.taken.iter().any(|taken| taken.overlaps(&area)),
                "{area:?}"
            );
            let away = (area.low[1] + area.high[1]) / 2.0 - at[1];
            assert!(away.abs() < 40.0, "{area:?} is far from {at:?}");
            labels.taken.push(area);
        }
    }
}
