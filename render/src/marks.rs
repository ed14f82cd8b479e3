//! Marks on a map: the true load, the position found, hot spots; and their explanation below the map.

use std::f64::consts::PI;

use plotters::prelude::*;

use crate::chart::Panel;
use crate::drawing::pen::{Anchor, INK, Pen, on_circle, rectangle};
use crate::{PictureError, Style};

/// The kinds of marks on a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Marked {
    pub(crate) truth: bool,
    pub(crate) found: bool,
    pub(crate) spots: bool,
}

impl Marked {
    pub(crate) fn of<'a>(styles: impl Iterator<Item = &'a Style>) -> Self {
        styles.fold(Self::default(), |marked, style| Self {
            truth: marked.truth || style.true_position.is_some() || !style.true_outline.is_empty(),
            found: marked.found || style.found.is_some() || style.hot_spots.is_some(),
            spots: marked.spots || style.hot_spots.is_some(),
        })
    }

    pub(crate) fn any(self) -> bool {
        self.truth || self.found || self.spots
    }
}

/// The marks of one map.
pub(crate) fn marks<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    panel: &Panel,
    style: &Style,
) -> Result<(), PictureError> {
    if !style.true_outline.is_empty() {
        let corners: Vec<_> = style.true_outline.iter().map(|p| panel.place(*p)).collect();
        dashed(pen, &corners)?;
    }
    if let Some(place) = style.true_position {
        let radius = (place.radius * panel.per_metre).max(8.0);
        circle(pen, panel.place(place.centre), radius)?;
    }
    for spot in style.hot_spots.iter().flatten() {
        let radius = ((spot.area / PI).sqrt() * panel.per_metre).max(5.0);
        ring(pen, panel.place(spot.centre), radius)?;
    }
    if let Some(found) = style.found {
        cross(pen, panel.place(found), panel.words * 0.32)?;
    }
    // the numbers last, so that no ring hides them
    for spot in style.hot_spots.iter().flatten() {
        let [x, y] = panel.place(spot.centre);
        let radius = ((spot.area / PI).sqrt() * panel.per_metre).max(5.0);
        let at = [x + radius * 0.71 + 7.0, y - radius * 0.71 - 5.0];
        number(pen, spot.number, at, panel.words * 0.86)?;
    }
    Ok(())
}

/// The legend of the marks; empty without marks.
pub(crate) fn legend<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    [mut x, y]: [f64; 2],
    marked: Marked,
) -> Result<(), PictureError> {
    if marked.truth {
        circle(pen, [x + 6.0, y], 6.0)?;
        pen.text("true place", [x + 18.0, y], 13.0, INK, Anchor::Left)?;
        x += 106.0;
    }
    if marked.found {
        cross(pen, [x + 6.0, y], 5.5)?;
        pen.text("found", [x + 18.0, y], 13.0, INK, Anchor::Left)?;
        x += 76.0;
    }
    if marked.spots {
        ring(pen, [x + 6.0, y], 5.5)?;
        let words = "hot spot: area at half of its peak or more";
        pen.text(words, [x + 18.0, y], 13.0, INK, Anchor::Left)?;
    }
    Ok(())
}

fn circle<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    centre: [f64; 2],
    radius: f64,
) -> Result<(), PictureError> {
    let dashes = ((radius * 0.9) as usize).clamp(6, 40);
    let at = |turn: f64| on_circle(centre, radius, turn);
    // white below, so that the mark is visible on dark colours
    pen.line((0..=72).map(|k| at(f64::from(k) / 72.0)), WHITE, 2.2)?;
    for dash in 0..dashes {
        let arc = (0..=6).map(|k| at((dash as f64 + 0.58 * f64::from(k) / 6.0) / dashes as f64));
        pen.line(arc, INK, 1.4)?;
    }
    Ok(())
}

/// A closed dashed line, white below.
fn dashed<DB: DrawingBackend>(pen: &Pen<'_, DB>, corners: &[[f64; 2]]) -> Result<(), PictureError> {
    const DASH: f64 = 4.0;
    const GAP: f64 = 3.0;
    pen.line(corners.iter().chain(corners.first()).copied(), WHITE, 2.2)?;
    // position on the line within the pattern of dash and gap
    let mut along = 0.0;
    for (a, b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let at = |s: f64| [0, 1].map(|i| a[i] + s / length.max(f64::MIN_POSITIVE) * (b[i] - a[i]));
        let mut from = 0.0;
        while from < length {
            let left = if along < DASH { DASH } else { DASH + GAP } - along;
            let to = (from + left).min(length);
            if along < DASH {
                pen.line([at(from), at(to)], INK, 1.4)?;
            }
            along = if to - from < left {
                along + (to - from)
            } else {
                (along + left) % (DASH + GAP)
            };
            from = to;
        }
    }
    Ok(())
}

fn cross<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    [x, y]: [f64; 2],
    arm: f64,
) -> Result<(), PictureError> {
    let thick = (arm * 0.3).clamp(1.2, 1.8);
    for (colour, width, arm) in [(WHITE, thick + 1.4, arm + 0.6), (INK, thick, arm)] {
        pen.line([[x - arm, y - arm], [x + arm, y + arm]], colour, width)?;
        pen.line([[x - arm, y + arm], [x + arm, y - arm]], colour, width)?;
    }
    Ok(())
}

/// A ring of the size of a hot spot, white below.
fn ring<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    centre: [f64; 2],
    radius: f64,
) -> Result<(), PictureError> {
    let points = || (0..=48).map(|k| on_circle(centre, radius, f64::from(k) / 48.0));
    pen.line(points(), WHITE, 3.0)?;
    pen.line(points(), INK, 1.2)
}

/// The number of a hot spot on a white label.
fn number<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    number: u64,
    [x, y]: [f64; 2],
    size: f64,
) -> Result<(), PictureError> {
    let words = number.to_string();
    let (half, high) = (pen.text_width(&words, size)? / 2.0 + 2.0, size * 0.5 + 1.0);
    let label = rectangle([x - half, y - high], [x + half, y + high]);
    pen.area(&label, WHITE)?;
    pen.text(&words, [x, y], size, INK, Anchor::Centre)
}
