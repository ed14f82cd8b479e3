//! Charts of a quantity against time: smallest, mean and largest value of each span, gaps and marked instants.

use plotters::prelude::*;

use crate::PictureError;
use crate::chart::ALARM;
use crate::drawing::canvas::{COLOURS, Drawing, GRID, PALE};
use crate::drawing::pen::{Anchor, INK, Pen, rectangle};
use crate::drawing::scale::step;

const SIZE: [f64; 2] = [720.0, 190.0];
const LEFT: f64 = 66.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 30.0;
/// Space to the right of the curves, without and with the names of several lines.
const RIGHT: [f64; 2] = [16.0, 150.0];
/// Colour of spans in which nothing was recorded.
const GAP: RGBColor = RGBColor(228, 228, 232);

/// A quantity of one region in time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CourseLine {
    /// Its name.
    pub name: String,
    /// Begin of a span, s; smallest, mean and largest value in it; ascending.
    pub points: Vec<[f64; 4]>,
}

/// A chart with its texts. Times are in seconds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Course<'a> {
    /// Title, with the unit.
    pub title: &'a str,
    /// First and last instant.
    pub span: [f64; 2],
    /// Labelled instants.
    pub ticks: Vec<(f64, String)>,
    /// The lines; points further apart than `apart` are not connected.
    pub lines: Vec<CourseLine>,
    /// Longest time between connected points.
    pub apart: f64,
    /// Grey spans: begin and end.
    pub gaps: Vec<[f64; 2]>,
    /// Marked instants.
    pub marks: Vec<f64>,
}

/// The chart as an SVG, 720 points wide.
///
/// # Errors
/// A value that is not finite.
pub fn course_svg(course: &Course<'_>) -> Result<String, PictureError> {
    Plot::new(course)?.svg()
}

struct Plot<'a> {
    course: &'a Course<'a>,
    low: f64,
    high: f64,
}

impl<'a> Plot<'a> {
    fn new(course: &'a Course<'a>) -> Result<Self, PictureError> {
        let (mut low, mut high) = (0.0_f64, 0.0_f64);
        for point in course.lines.iter().flat_map(|line| &line.points) {
            if let Some(wrong) = point.iter().find(|value| !value.is_finite()) {
                return Err(PictureError::Point {
                    across: point[0],
                    up: *wrong,
                });
            }
            low = low.min(point[1]);
            high = high.max(point[3]);
        }
        if high - low <= 0.0 {
            high = low + 1.0;
        }
        Ok(Self { course, low, high })
    }

    fn right(&self) -> f64 {
        SIZE[0] - RIGHT[usize::from(self.course.lines.len() > 1)]
    }

    fn across(&self, at: f64) -> f64 {
        let [first, last] = self.course.span;
        let part = ((at - first) / (last - first).max(1e-9)).clamp(0.0, 1.0);
        LEFT + part * (self.right() - LEFT)
    }

    fn up(&self, value: f64) -> f64 {
        let part = (value - self.low) / (self.high - self.low);
        SIZE[1] - BOTTOM - part * (SIZE[1] - TOP - BOTTOM)
    }

    fn line<DB: DrawingBackend>(
        &self,
        pen: &Pen<'_, DB>,
        line: &CourseLine,
        colour: RGBColor,
    ) -> Result<(), PictureError> {
        let connected = |a: &[f64; 4], b: &[f64; 4]| b[0] - a[0] <= self.course.apart;
        let pale = |channel: u8| (0.28 * f64::from(channel) + 0.72 * 255.0).round() as u8;
        let band = RGBColor(pale(colour.0), pale(colour.1), pale(colour.2));
        for run in line.points.chunk_by(connected) {
            let upper = run.iter().map(|p| [self.across(p[0]), self.up(p[3])]);
            let lower = run.iter().rev().map(|p| [self.across(p[0]), self.up(p[1])]);
            let around: Vec<[f64; 2]> = upper.chain(lower).collect();
            pen.area(&around, band)?;
            let mean = run.iter().map(|p| [self.across(p[0]), self.up(p[2])]);
            match run {
                [point] => {
                    let [x, y] = [self.across(point[0]), self.up(point[2])];
                    pen.line([[x - 1.5, y], [x + 1.5, y]], colour, 2.0)?;
                }
                _ => pen.line(mean, colour, 1.4)?,
            }
        }
        Ok(())
    }
}

impl Drawing for Plot<'_> {
    fn size(&self) -> [f64; 2] {
        SIZE
    }

    fn draw<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        let (right, bottom) = (self.right(), SIZE[1] - BOTTOM);
        pen.bold(self.course.title, [LEFT, 14.0], 14.0, INK, Anchor::Left)?;
        for [begin, end] in &self.course.gaps {
            let [from, to] = [begin, end].map(|at| self.across(*at));
            // a short gap must stay visible
            let to = to.max(from + 1.0);
            pen.area(&rectangle([from, TOP], [to, bottom]), GAP)?;
        }
        let (every, decimals) = step(self.high - self.low, 5);
        for k in (self.low / every).ceil() as i64..=(self.high / every).floor() as i64 {
            let y = self.up(k as f64 * every);
            pen.line([[LEFT, y], [right, y]], GRID, 0.6)?;
            let number = format!("{:.decimals$}", k as f64 * every).replace('-', "\u{2212}");
            pen.text(&number, [LEFT - 6.0, y], 12.0, INK, Anchor::Right)?;
        }
        for (at, words) in &self.course.ticks {
            let x = self.across(*at);
            pen.line([[x, bottom], [x, bottom + 4.0]], PALE, 0.8)?;
            pen.text(words, [x, bottom + 14.0], 12.0, INK, Anchor::Centre)?;
        }
        for (index, line) in self.course.lines.iter().enumerate() {
            let colour = COLOURS[index % COLOURS.len()];
            self.line(pen, line, colour)?;
            if self.course.lines.len() > 1 {
                let y = TOP + 8.0 + 16.0 * index as f64;
                pen.line([[right + 10.0, y], [right + 26.0, y]], colour, 2.5)?;
                pen.text(&line.name, [right + 31.0, y], 12.0, INK, Anchor::Left)?;
            }
        }
        for at in &self.course.marks {
            let x = self.across(*at);
            pen.line([[x, TOP - 6.0], [x, bottom]], ALARM, 1.0)?;
            let head = [[x - 4.0, TOP - 8.0], [x + 4.0, TOP - 8.0], [x, TOP - 1.0]];
            pen.area(&head, ALARM)?;
        }
        pen.line([[LEFT, TOP], [LEFT, bottom], [right, bottom]], PALE, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(points: Vec<[f64; 4]>) -> Course<'static> {
        Course {
            title: "load, N",
            span: [0.0, 100.0],
            ticks: vec![(50.0, "03:00".to_owned())],
            lines: vec![CourseLine {
                name: "sheet".into(),
                points,
            }],
            apart: 15.0,
            gaps: vec![[20.0, 80.0]],
            marks: vec![90.0],
        }
    }

    #[test]
    fn points_across_a_gap_are_not_connected() {
        let lines = |points| {
            course_svg(&course(points))
                .unwrap()
                .matches("<polyline")
                .count()
        };
        let [a, b] = [[0.0, 1.0, 2.0, 3.0], [10.0, 1.0, 2.0, 3.0]];
        let [c, d] = [[90.0, 1.0, 2.0, 3.0], [100.0, 1.0, 2.0, 3.0]];
        let joined = lines(vec![a, b]);
        assert_eq!(lines(vec![a, b, c, d]), joined + 1);
        let svg = course_svg(&course(vec![a, b])).unwrap();
        assert!(svg.contains("load, N") && svg.contains("03:00"), "{svg}");
    }

    #[test]
    fn values_that_are_no_numbers_are_refused() {
        assert!(course_svg(&course(vec![[0.0, f64::NAN, 1.0, 2.0]])).is_err());
        assert!(course_svg(&course(Vec::new())).is_ok(), "nothing is drawn");
    }
}
