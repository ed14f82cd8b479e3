//! Lines, areas and text in points, independent of the backend's unit.

use std::sync::Once;

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, register_font};

use crate::PictureError;

/// Colour of text and marks.
pub(crate) const INK: RGBColor = RGBColor(34, 34, 38);

/// Position of text relative to its point.
#[derive(Clone, Copy)]
pub(crate) enum Anchor {
    Left,
    Centre,
    Right,
}

/// A plotters area whose unit is the point: `scale` pixels.
pub(crate) struct Pen<'a, DB: DrawingBackend> {
    area: &'a DrawingArea<DB, Shift>,
    scale: f64,
    /// Vertical offset that centres text in this backend, in text heights.
    sink: f64,
}

impl<'a, DB: DrawingBackend> Pen<'a, DB> {
    pub(crate) fn new(area: &'a DrawingArea<DB, Shift>, scale: f64, sink: f64) -> Self {
        static FONTS: Once = Once::new();
        FONTS.call_once(|| {
            let regular = include_bytes!("../../fonts/DejaVuSans-subset.ttf");
            let bold = include_bytes!("../../fonts/DejaVuSans-Bold-subset.ttf");
            for (style, bytes) in [
                (FontStyle::Normal, regular.as_slice()),
                (FontStyle::Bold, bold.as_slice()),
            ] {
                if register_font("sans-serif", style, bytes).is_err() {
                    unreachable!(
                        "the fonts compiled in are whole: every picture of the tests uses them"
                    );
                }
            }
        });
        Self { area, scale, sink }
    }

    pub(crate) fn pixel(&self, [x, y]: [f64; 2]) -> (i32, i32) {
        (
            (x * self.scale).round() as i32,
            (y * self.scale).round() as i32,
        )
    }

    pub(crate) fn line(
        &self,
        points: impl IntoIterator<Item = [f64; 2]>,
        colour: RGBColor,
        width: f64,
    ) -> Result<(), PictureError> {
        let points: Vec<_> = points.into_iter().map(|point| self.pixel(point)).collect();
        let width = (width * self.scale).round().max(1.0) as u32;
        self.draw(PathElement::new(points, colour.stroke_width(width)))
    }

    pub(crate) fn area(&self, points: &[[f64; 2]], colour: RGBColor) -> Result<(), PictureError> {
        let points: Vec<_> = points.iter().map(|point| self.pixel(*point)).collect();
        self.draw(Polygon::new(points, colour.filled()))
    }

    pub(crate) fn draw<E>(&self, element: E) -> Result<(), PictureError>
    where
        for<'b> &'b E: plotters::element::PointCollection<'b, (i32, i32)>,
        E: plotters::element::Drawable<DB>,
    {
        self.area
            .draw(&element)
            .map_err(|cause| PictureError::Draw(cause.to_string()))
    }

    pub(crate) fn text(
        &self,
        words: &str,
        at: [f64; 2],
        size: f64,
        colour: RGBColor,
        anchor: Anchor,
    ) -> Result<(), PictureError> {
        let font = ("sans-serif", size * self.scale).into_font();
        self.write(words, at, font, colour, anchor)
    }

    pub(crate) fn bold(
        &self,
        words: &str,
        at: [f64; 2],
        size: f64,
        colour: RGBColor,
        anchor: Anchor,
    ) -> Result<(), PictureError> {
        let font = FontDesc::new(FontFamily::SansSerif, size * self.scale, FontStyle::Bold);
        self.write(words, at, font, colour, anchor)
    }

    /// Width of bold text, points.
    ///
    /// # Errors
    /// A size that no font has.
    pub(crate) fn bold_width(&self, words: &str, size: f64) -> Result<f64, PictureError> {
        let font = FontDesc::new(FontFamily::SansSerif, size * self.scale, FontStyle::Bold);
        self.width(words, &font)
    }

    /// Width of text, points.
    pub(crate) fn text_width(&self, words: &str, size: f64) -> Result<f64, PictureError> {
        let font = ("sans-serif", size * self.scale).into_font();
        self.width(words, &font)
    }

    fn width(&self, words: &str, font: &FontDesc<'_>) -> Result<f64, PictureError> {
        let (width, _) = font
            .box_size(words)
            .map_err(|cause| PictureError::Draw(cause.to_string()))?;
        Ok(f64::from(width) / self.scale)
    }

    pub(crate) fn upright(&self, words: &str, at: [f64; 2], size: f64) -> Result<(), PictureError> {
        let font = ("sans-serif", size * self.scale)
            .into_font()
            .transform(FontTransform::Rotate270);
        self.write(words, at, font, INK, Anchor::Centre)
    }

    fn write(
        &self,
        words: &str,
        at: [f64; 2],
        font: FontDesc<'_>,
        colour: RGBColor,
        anchor: Anchor,
    ) -> Result<(), PictureError> {
        let across = match anchor {
            Anchor::Left => HPos::Left,
            Anchor::Centre => HPos::Center,
            Anchor::Right => HPos::Right,
        };
        let style = TextStyle::from(font)
            .color(&colour)
            .pos(Pos::new(across, VPos::Center));
        let (mut x, mut y) = self.pixel(at);
        let sink = (self.sink * style.font.get_size()).round() as i32;
        match style.font.get_transform() {
            FontTransform::Rotate270 => x += sink,
            _ => y += sink,
        }
        self.area
            .draw_text(words, &style, (x, y))
            .map_err(|cause| PictureError::Draw(cause.to_string()))
    }
}

/// The point of a circle at a share of its turn, counted from +x towards +y.
pub(crate) fn on_circle(centre: [f64; 2], radius: f64, turn: f64) -> [f64; 2] {
    let angle = turn * std::f64::consts::TAU;
    [
        centre[0] + radius * angle.cos(),
        centre[1] + radius * angle.sin(),
    ]
}

/// The corners of a rectangle from one corner and the opposite one.
pub(crate) fn rectangle([left, top]: [f64; 2], [right, bottom]: [f64; 2]) -> [[f64; 2]; 4] {
    [[left, top], [right, top], [right, bottom], [left, bottom]]
}
