//! Charts of a figure against a varied parameter; a curve per method, with error bars.

use plotters::prelude::*;

use crate::PictureError;
use crate::chart::page_title;
use crate::drawing::canvas::{COLOURS, Drawing, GRID, PALE, colour_of};
use crate::drawing::pen::{Anchor, INK, Pen, on_circle, rectangle};
use crate::drawing::scale::step;

const SIZE: [f64; 2] = [720.0, 400.0];
const LEFT: f64 = 66.0;
const TOP: f64 = 52.0;
const RIGHT: f64 = 200.0;
const BOTTOM: f64 = 52.0;
/// Space to the right of the curves for the marks of the legend, and for each letter of its names, points.
const LEGEND: f64 = 50.0;
const LETTER: f64 = 7.0;

/// One line of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Its name.
    pub name: String,
    /// Abscissa, ordinate, and half the length of the error bar (0: none), in the order of connection.
    pub points: Vec<[f64; 3]>,
}

/// Kind of axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Equal steps.
    Linear,
    /// Equal factors; values are positive.
    Log,
}

/// A chart with its texts.
#[derive(Debug, Clone, PartialEq)]
pub struct Curves<'a> {
    /// First line.
    pub title: &'a str,
    /// Label of the abscissa, with its unit.
    pub across: &'a str,
    /// Label of the ordinate, with its unit.
    pub up: &'a str,
    /// Kinds of the axes: across, up.
    pub axes: [Axis; 2],
    /// Vertical lines with their names.
    pub marks: Vec<(f64, &'a str)>,
    /// The curves.
    pub curves: Vec<Curve>,
    /// Points marked by a ring and connected by a dashed line: the Pareto front.
    pub front: Vec<[f64; 2]>,
}

/// A chart as a PNG, 720 points wide, more if a name is long.
///
/// # Errors
/// No point; a value that is not finite, or not positive on a logarithmic axis.
pub fn curves_png(curves: &Curves<'_>) -> Result<Vec<u8>, PictureError> {
    Plot::new(curves)?.png()
}

/// A chart as an SVG.
///
/// # Errors
/// As [`curves_png`].
pub fn curves_svg(curves: &Curves<'_>) -> Result<String, PictureError> {
    Plot::new(curves)?.svg()
}

/// Ranges of the axes, in axis units.
struct Plot<'a> {
    curves: &'a Curves<'a>,
    low: [f64; 2],
    high: [f64; 2],
}

impl<'a> Plot<'a> {
    fn new(curves: &'a Curves<'a>) -> Result<Self, PictureError> {
        let sound = |axis: usize, value: f64| {
            value.is_finite() && (curves.axes[axis] == Axis::Linear || value > 0.0)
        };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in curves.curves.iter().flat_map(|curve| &curve.points) {
            if !(sound(0, point[0]) && sound(1, point[1]) && point[2].is_finite()) {
                return Err(PictureError::Point {
                    across: point[0],
                    up: point[1],
                });
            }
            for axis in 0..2 {
                let value = counted(curves.axes[axis], point[axis]);
                low[axis] = low[axis].min(value);
                high[axis] = high[axis].max(value);
            }
            if curves.axes[1] == Axis::Linear {
                low[1] = low[1].min(point[1] - point[2]);
                high[1] = high[1].max(point[1] + point[2]);
            }
        }
        if low[0] > high[0] {
            return Err(PictureError::EmptyGrid);
        }
        for axis in 0..2 {
            match curves.axes[axis] {
                // ordinates include zero
                Axis::Linear if axis == 1 => {
                    low[1] = low[1].min(0.0);
                    high[1] = high[1].max(low[1] + f64::MIN_POSITIVE);
                    high[1] += 0.05 * (high[1] - low[1]);
                }
                Axis::Linear => {}
                Axis::Log => {
                    low[axis] = low[axis].floor();
                    high[axis] = high[axis].ceil();
                }
            }
            if high[axis] - low[axis] <= 0.0 {
                high[axis] = low[axis] + 1.0;
            }
        }
        Ok(Self { curves, low, high })
    }

    fn place(&self, point: [f64; 2]) -> [f64; 2] {
        let part = |axis: usize| {
            let value = counted(self.curves.axes[axis], point[axis]);
            ((value - self.low[axis]) / (self.high[axis] - self.low[axis])).clamp(0.0, 1.0)
        };
        [
            LEFT + part(0) * (SIZE[0] - LEFT - RIGHT),
            SIZE[1] - BOTTOM - part(1) * (SIZE[1] - TOP - BOTTOM),
        ]
    }

    /// Positions and labels of the ticks of an axis (0: across, 1: up).
    fn ticks(&self, axis: usize) -> Vec<(f64, String)> {
        match self.curves.axes[axis] {
            Axis::Linear => {
                let (step, decimals) = step(self.high[axis] - self.low[axis], 8);
                let first = (self.low[axis] / step - 1e-9).ceil() as i64;
                let last = (self.high[axis] / step + 1e-9).floor() as i64;
                (first..=last)
                    .map(|k| k as f64 * step)
                    .map(|value| (value, format!("{value:.decimals$}")))
                    .collect()
            }
            Axis::Log => (self.low[axis] as i32..=self.high[axis] as i32)
                .step_by(self.decades_a_tick(axis))
                .map(|decade| {
                    let decimals = decade.min(0).unsigned_abs() as usize;
                    let value = 10.0_f64.powi(decade);
                    let words = match decade {
                        -3..=4 => format!("{value:.decimals$}"),
                        _ => format!("1e{decade}"),
                    };
                    (value, words)
                })
                .collect(),
        }
    }

    /// Number of decades between labelled ticks, by the available space.
    fn decades_a_tick(&self, axis: usize) -> usize {
        let available = [9.0, 18.0][axis];
        ((self.high[axis] - self.low[axis]) / available)
            .ceil()
            .max(1.0) as usize
    }

    /// The lower end of an axis as a value.
    fn shown_low(&self, axis: usize) -> f64 {
        match self.curves.axes[axis] {
            Axis::Linear => self.low[axis],
            Axis::Log => 10.0_f64.powf(self.low[axis]),
        }
    }
}

impl Drawing for Plot<'_> {
    fn size(&self) -> [f64; 2] {
        let names = self
            .curves
            .curves
            .iter()
            .map(|curve| curve.name.chars().count());
        let longest = names.max().unwrap_or(0) as f64;
        [
            SIZE[0] + (LEGEND + LETTER * longest - RIGHT).max(0.0),
            SIZE[1],
        ]
    }

    fn draw<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        let curves = self.curves;
        let [right, bottom] = [SIZE[0] - RIGHT, SIZE[1] - BOTTOM];
        page_title(pen, curves.title, [16.0, 15.0, 14.0], self.size()[0] - 32.0)?;
        for (value, words) in self.ticks(0) {
            let [x, _] = self.place([value, self.shown_low(1)]);
            pen.line([[x, TOP], [x, bottom]], GRID, 0.6)?;
            pen.text(&words, [x, bottom + 13.0], 12.0, INK, Anchor::Centre)?;
        }
        for (value, words) in self.ticks(1) {
            let [_, y] = self.place([self.shown_low(0), value]);
            pen.line([[LEFT, y], [right, y]], GRID, 0.6)?;
            pen.text(&words, [LEFT - 7.0, y], 12.0, INK, Anchor::Right)?;
        }
        let middle = [(LEFT + right) / 2.0, (TOP + bottom) / 2.0];
        pen.text(
            curves.across,
            [middle[0], SIZE[1] - 16.0],
            13.0,
            INK,
            Anchor::Centre,
        )?;
        pen.upright(curves.up, [16.0, middle[1]], 13.0)?;
        for (value, words) in &curves.marks {
            let [x, _] = self.place([*value, self.shown_low(1)]);
            pen.line([[x, TOP], [x, bottom]], PALE, 1.4)?;
            pen.text(words, [x, TOP - 9.0], 11.0, INK, Anchor::Centre)?;
        }
        let front: Vec<_> = curves.front.iter().map(|at| self.place(*at)).collect();
        for pair in front.windows(2) {
            let dash = |part: f64| {
                [0, 1].map(|axis| pair[0][axis] + part * (pair[1][axis] - pair[0][axis]))
            };
            let count = ((pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]) / 7.0).ceil();
            for k in 0..count as usize {
                let from = k as f64 / count;
                pen.line([dash(from), dash(from + 0.55 / count)], INK, 0.8)?;
            }
        }
        for at in &front {
            let mut ring = round(*at, 6.5);
            ring.push(ring[0]);
            pen.line(ring, INK, 1.2)?;
        }
        for (k, curve) in curves.curves.iter().enumerate() {
            let colour = colour_of(&curve.name, k);
            let places: Vec<_> = curve
                .points
                .iter()
                .map(|p| self.place([p[0], p[1]]))
                .collect();
            pen.line(places.iter().copied(), colour, 1.6)?;
            for (point, at) in curve.points.iter().zip(&places) {
                if point[2] > 0.0 {
                    let least = match curves.axes[1] {
                        Axis::Log => point[1] * 1e-3,
                        Axis::Linear => f64::NEG_INFINITY,
                    };
                    let end = |value: f64| self.place([point[0], value.max(least)]);
                    pen.line(
                        [end(point[1] - point[2]), end(point[1] + point[2])],
                        colour,
                        1.0,
                    )?;
                }
                mark(pen, k, *at, colour)?;
            }
            let y = TOP + 10.0 + 18.0 * k as f64;
            pen.line([[right + 14.0, y], [right + 36.0, y]], colour, 1.6)?;
            mark(pen, k, [right + 25.0, y], colour)?;
            pen.text(&curve.name, [right + 42.0, y], 12.0, INK, Anchor::Left)?;
        }
        Ok(())
    }
}

/// The mark of a curve: a disc, square, triangle or cross.
fn mark<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    curve: usize,
    [x, y]: [f64; 2],
    colour: RGBColor,
) -> Result<(), PictureError> {
    let r = 3.6;
    // a ninth curve has the first one's colour, but a different mark
    match (curve + curve / COLOURS.len()) % 4 {
        0 => pen.area(&round([x, y], r), colour),
        1 => pen.area(&rectangle([x - r, y - r], [x + r, y + r]), colour),
        2 => pen.area(
            &[[x, y - 1.2 * r], [x + 1.1 * r, y + r], [x - 1.1 * r, y + r]],
            colour,
        ),
        _ => {
            pen.line([[x - r, y - r], [x + r, y + r]], colour, 1.6)?;
            pen.line([[x - r, y + r], [x + r, y - r]], colour, 1.6)
        }
    }
}

fn round(centre: [f64; 2], radius: f64) -> Vec<[f64; 2]> {
    (0..16)
        .map(|k| on_circle(centre, radius, f64::from(k) / 16.0))
        .collect()
}

fn counted(axis: Axis, value: f64) -> f64 {
    match axis {
        Axis::Linear => value,
        Axis::Log => value.log10(),
    }
}
