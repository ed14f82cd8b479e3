//! All parts of a picture except its triangles: outline, axes, numbers, marks, colour bar, texts.

use plotters::prelude::*;
use survey::{Electrode, Map};

use crate::drawing::canvas::PALE;
use crate::drawing::pen::{Anchor, INK, Pen, rectangle};
use crate::drawing::scale::step;
use crate::drawing::text_fitting::{shortened, two_lines};
use crate::{Extent, PictureError, Range, Sheet, Style};

pub(crate) const PAPER: RGBColor = RGBColor(236, 236, 238);
pub(crate) const ALARM: RGBColor = RGBColor(176, 64, 0);
/// Space between the sheet's edge and the axes for the electrodes' numbers, in points.
pub(crate) const RING: f64 = 20.0;

/// Position of one map on the page, in points from the upper left corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Panel {
    /// Upper left corner of the sheet's box.
    pub(crate) corner: [f64; 2],
    /// Points per metre.
    pub(crate) per_metre: f64,
    pub(crate) extent: Extent,
    /// Size of small text.
    pub(crate) words: f64,
    /// Whether the ticks of the axes have numbers: across, up.
    pub(crate) numbered: [bool; 2],
}

impl Panel {
    pub(crate) fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.corner[0] + (x - self.extent.low[0]) * self.per_metre,
            self.corner[1] + (self.extent.high[1] - y) * self.per_metre,
        ]
    }

    /// The position of a point of the page: the inverse of [`Panel::place`].
    pub(crate) fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.extent.low[0] + (x - self.corner[0]) / self.per_metre,
            self.extent.high[1] - (y - self.corner[1]) / self.per_metre,
        ]
    }

    pub(crate) fn size(&self) -> [f64; 2] {
        [
            self.extent.width() * self.per_metre,
            self.extent.height() * self.per_metre,
        ]
    }

    /// The background of the sheet; it stays visible where the map has no triangles.
    pub(crate) fn ground<DB: DrawingBackend>(
        &self,
        pen: &Pen<'_, DB>,
        sheet: &Sheet,
    ) -> Result<(), PictureError> {
        let mut loops: Vec<Vec<[f64; 2]>> = sheet
            .outline
            .iter()
            .filter(|corners| corners.len() >= 3)
            .map(|corners| corners.iter().map(|point| self.place(*point)).collect())
            .collect();
        // The outer edge is the largest; the others are holes in it.
        loops.sort_by(|a, b| area(b).total_cmp(&area(a)));
        for (index, corners) in loops.iter().enumerate() {
            pen.area(corners, if index == 0 { PAPER } else { WHITE })?;
        }
        Ok(())
    }

    /// Outline, electrodes, axes.
    pub(crate) fn furniture<DB: DrawingBackend>(
        &self,
        pen: &Pen<'_, DB>,
        sheet: &Sheet,
    ) -> Result<(), PictureError> {
        for corners in &sheet.outline {
            let closed = corners.iter().chain(corners.first());
            pen.line(closed.map(|point| self.place(*point)), PALE, 1.0)?;
        }
        self.electrodes(pen, sheet)?;
        self.axes(pen)
    }

    fn electrodes<DB: DrawingBackend>(
        &self,
        pen: &Pen<'_, DB>,
        sheet: &Sheet,
    ) -> Result<(), PictureError> {
        let [width, height] = self.size();
        let middle = [self.corner[0] + width / 2.0, self.corner[1] + height / 2.0];
        let places: Vec<_> = sheet.electrodes.iter().map(|at| self.place(*at)).collect();
        let size = self.words * 0.86;
        let beside: Vec<_> = places
            .iter()
            .map(|at| self.beside(*at, middle, size))
            .collect();
        let every = number_every(&beside, size);
        for (index, (at, beside)) in places.iter().zip(&beside).enumerate() {
            let mark = (self.words * 0.16).max(1.2);
            pen.area(
                &[
                    [at[0] - mark, at[1] - mark],
                    [at[0] + mark, at[1] - mark],
                    [at[0] + mark, at[1] + mark],
                    [at[0] - mark, at[1] + mark],
                ],
                INK,
            )?;
            let number = Electrode(index).number();
            if !(number == 1 || number.is_multiple_of(every)) {
                continue;
            }
            pen.text(&number.to_string(), *beside, size, INK, Anchor::Centre)?;
        }
        Ok(())
    }

    /// A position just outside the sheet: perpendicular to a near side of the box, otherwise away from `middle`.
    fn beside(&self, at: [f64; 2], middle: [f64; 2], size: f64) -> [f64; 2] {
        let [width, height] = self.size();
        let out = size * 0.95;
        let near = 0.06 * width.min(height);
        let to_side = [
            at[0] - self.corner[0],
            self.corner[0] + width - at[0],
            at[1] - self.corner[1],
            self.corner[1] + height - at[1],
        ];
        let nearest = (0..4).min_by(|a, b| to_side[*a].total_cmp(&to_side[*b]));
        match nearest {
            Some(0) if to_side[0] < near => [self.corner[0] - out, at[1]],
            Some(1) if to_side[1] < near => [self.corner[0] + width + out, at[1]],
            Some(2) if to_side[2] < near => [at[0], self.corner[1] - out],
            Some(3) if to_side[3] < near => [at[0], self.corner[1] + height + out],
            _ => {
                let away = [at[0] - middle[0], at[1] - middle[1]];
                let length = away[0].hypot(away[1]).max(1e-9);
                let out = out + self.words * 0.3;
                [
                    at[0] + away[0] / length * out,
                    at[1] + away[1] / length * out,
                ]
            }
        }
    }

    fn axes<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        let [width, height] = self.size();
        let [left, top] = [self.corner[0] - RING, self.corner[1] - RING];
        let [right, bottom] = [
            self.corner[0] + width + RING,
            self.corner[1] + height + RING,
        ];
        let frame = [
            [left, top],
            [right, top],
            [right, bottom],
            [left, bottom],
            [left, top],
        ];
        pen.line(frame, PALE, 0.6)?;
        for axis in 0..2 {
            let (low, high) = (
                self.extent.low[axis] - RING / self.per_metre,
                self.extent.high[axis] + RING / self.per_metre,
            );
            let available = [width, height][axis] / (self.words * 3.6);
            let (step, decimals) = step((high - low) * 1e3, available.max(2.0) as usize);
            for k in (low * 1e3 / step).ceil() as i64..=(high * 1e3 / step).floor() as i64 {
                let millimetres = k as f64 * step;
                let number = format!("{millimetres:.decimals$}").replace('-', "\u{2212}");
                if axis == 0 {
                    let x = self.place([millimetres / 1e3, 0.0])[0];
                    pen.line([[x, bottom], [x, bottom + 4.0]], PALE, 0.6)?;
                    if self.numbered[0] {
                        let at = [x, bottom + 5.0 + self.words * 0.7];
                        pen.text(&number, at, self.words, INK, Anchor::Centre)?;
                    }
                } else {
                    let y = self.place([0.0, millimetres / 1e3])[1];
                    pen.line([[left - 4.0, y], [left, y]], PALE, 0.6)?;
                    if self.numbered[1] {
                        let at = [left - 6.0, y];
                        pen.text(&number, at, self.words, INK, Anchor::Right)?;
                    }
                }
            }
        }
        if self.numbered[0] {
            let at = [(left + right) / 2.0, bottom + 8.0 + self.words * 1.9];
            pen.text("x, mm", at, self.words, INK, Anchor::Centre)?;
        }
        if self.numbered[1] {
            let at = [left - 10.0 - self.words * 2.4, (top + bottom) / 2.0];
            pen.upright("y, mm", at, self.words)?;
        }
        Ok(())
    }
}

/// A colour bar with its ticks and label; larger displayed numbers are at the top.
pub(crate) fn bar<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    range: &Range,
    labelled: bool,
    [left, top]: [f64; 2],
    [width, height]: [f64; 2],
    words: f64,
) -> Result<(), PictureError> {
    let [(least, under), (most, over)] = range.ends();
    let at = |value: f64| top + height * (most - value) / (most - least);
    let slices = (height * 1.5) as usize;
    for slice in 0..slices {
        let part = |k: usize| top + height * k as f64 / slices as f64;
        let middle = (slice as f64 + 0.5) / slices as f64;
        let value = most - middle * (most - least);
        if let Some([r, g, b]) = range.colour(value) {
            // Half a point of overlap hides the seam to the next slice.
            let below = (part(slice + 1) + 0.5).min(top + height);
            let (first, last) = (
                pen.pixel([left, part(slice)]),
                pen.pixel([left + width, below]),
            );
            pen.draw(Rectangle::new([first, last], RGBColor(r, g, b).filled()))?;
        }
    }
    let edge = [
        [left, top],
        [left + width, top],
        [left + width, top + height],
        [left, top + height],
        [left, top],
    ];
    pen.line(edge, PALE, 0.6)?;
    for (value, number) in range.ticks((height / (words * 2.6)).max(2.0) as usize) {
        let y = at(value);
        pen.line([[left + width, y], [left + width + 4.0, y]], PALE, 0.6)?;
        pen.text(&number, [left + width + 7.0, y], words, INK, Anchor::Left)?;
    }
    for (beyond, value, y, sign) in [
        (over, most, top - words * 0.9, "\u{2265}"),
        (under, least, top + height + words * 0.9, "\u{2264}"),
    ] {
        if beyond {
            let end = format!("{sign} {}", range.words(value));
            pen.text(&end, [left, y], words, INK, Anchor::Left)?;
        }
    }
    if !labelled {
        return Ok(());
    }
    let place = [left + width + 16.0 + words * 2.6, top + height / 2.0];
    let (label, (_, unit)) = (range.unit.caption(), range.unit.shown());
    pen.upright(&format!("{label}, {unit}"), place, words)
}

/// The title at the upper left corner, in the first size that fits the width, otherwise on two lines.
pub(crate) fn page_title<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    title: &str,
    sizes: [f64; 3],
    available: f64,
) -> Result<(), PictureError> {
    let bold = |words: &str, size| pen.bold_width(words, size);
    for size in sizes {
        if bold(title, size)? <= available {
            return pen.bold(title, [16.0, 22.0], size, INK, Anchor::Left);
        }
    }
    let [first, second] = two_lines(title, available, |words| bold(words, 14.0))?;
    pen.bold(&first, [16.0, 13.0], 14.0, INK, Anchor::Left)?;
    pen.bold(&second, [16.0, 30.0], 14.0, INK, Anchor::Left)
}

/// The title, and below it the caption; at the right end the label of a simulation.
pub(crate) fn heading<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    title: &str,
    below: &str,
    simulated: bool,
    page: f64,
) -> Result<(), PictureError> {
    let available = page - 32.0 - if simulated { 122.0 } else { 0.0 };
    page_title(pen, title, [19.0, 17.0, 15.0], available)?;
    let below = shortened(below, page - 32.0, |words| pen.text_width(words, 14.0))?;
    pen.text(&below, [16.0, 47.0], 14.0, PALE, Anchor::Left)?;
    if simulated {
        let (left, right, top, bottom) = (page - 126.0, page - 14.0, 10.0, 34.0);
        pen.area(&rectangle([left, top], [right, bottom]), ALARM)?;
        let at = [(left + right) / 2.0, (top + bottom) / 2.0];
        pen.bold("SIMULATED", at, 15.0, WHITE, Anchor::Centre)?;
    }
    Ok(())
}

/// The line under the title: why the map is not sound, whether nothing in it is above its noise, the method, and the
/// number of missing readings.
pub(crate) fn caption(map: &Map, style: &Style) -> String {
    let method = match map.masked {
        0 => map.method.clone(),
        1 => format!("{}, 1 reading left out", map.method),
        several => format!("{}, {several} readings left out", map.method),
    };
    let doubt = map.quality.as_ref().filter(|quality| !quality.is_silent());
    let nothing = style.nothing_above.map(nothing_above);
    let parts = [doubt.map(ToString::to_string), nothing, Some(method)];
    parts.into_iter().flatten().collect::<Vec<_>>().join("; ")
}

/// The text for a map in which nothing is above its noise. `noise`: a relative loss.
pub fn nothing_above(noise: f64) -> String {
    let percent = 100.0 * noise;
    let (_, decimals) = step(percent, 10);
    format!("nothing above the noise ({percent:.decimals$} %)")
}

/// The title above one map of a grid, shortened to fit.
pub(crate) fn small_title<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    title: &str,
    at: [f64; 2],
    size: f64,
    available: f64,
) -> Result<(), PictureError> {
    let title = shortened(title, available, |words| pen.bold_width(words, size))?;
    pen.bold(&title, at, size, INK, Anchor::Centre)
}

/// Interval of the displayed electrode numbers: 1 if there is space, otherwise 2, 5, 10 or 20.
fn number_every(places: &[[f64; 2]], size: f64) -> usize {
    let closest = places
        .iter()
        .zip(places.iter().cycle().skip(1))
        .map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
        .fold(f64::INFINITY, f64::min);
    [1, 2, 5, 10]
        .into_iter()
        .find(|every| closest * *every as f64 >= size * 1.5)
        .unwrap_or(20)
}

fn area(corners: &[[f64; 2]]) -> f64 {
    let next = corners.iter().cycle().skip(1);
    let twice: f64 = corners
        .iter()
        .zip(next)
        .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
        .sum();
    twice.abs() / 2.0
}
