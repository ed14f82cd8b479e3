//! PNG and SVG: one map, or many with one scale.

use std::collections::BTreeMap;
use std::fmt::Write;

use plotters::prelude::*;
use survey::Map;

use crate::drawing::canvas::{FINER, GRAIN, SINK, encoded, inside, opening};
use crate::drawing::pen::Pen;
use crate::page::{Drawn, Page};
use crate::raster::{check_size, fill};
use crate::{Grid, PictureError, Rgb, Sheet, Style};

/// A map as a PNG, 720 pixels wide.
///
/// # Errors
/// A map of another sheet, a sheet without area, an invalid scale.
pub fn png(sheet: &Sheet, map: &Map, style: &Style) -> Result<Vec<u8>, PictureError> {
    Page::single(sheet, map, style)?.png()
}

/// A map as an SVG.
///
/// # Errors
/// As [`png()`].
pub fn svg(sheet: &Sheet, map: &Map, style: &Style) -> Result<String, PictureError> {
    Page::single(sheet, map, style)?.svg()
}

/// Many maps of one sheet in one PNG, row by row. The label SIMULATED is drawn if any of them is.
///
/// # Errors
/// As [`png()`]; or no map, or no column, or maps of several units on one scale.
pub fn png_grid(
    sheet: &Sheet,
    maps: &[(Map, Style)],
    grid: &Grid<'_>,
) -> Result<Vec<u8>, PictureError> {
    Page::grid(sheet, maps, grid)?.png()
}

/// Many maps of one sheet in one SVG, as [`png_grid`].
///
/// # Errors
/// As [`png_grid`].
pub fn svg_grid(
    sheet: &Sheet,
    maps: &[(Map, Style)],
    grid: &Grid<'_>,
) -> Result<String, PictureError> {
    Page::grid(sheet, maps, grid)?.svg()
}

impl Page<'_> {
    fn png(&self) -> Result<Vec<u8>, PictureError> {
        let scale = FINER as f64;
        let [width, height] = self.pixels(1.0).map(|points| points * FINER);
        check_size(width, height)?;
        let mut fine = vec![255_u8; width * height * 3];
        let whole = (width as u32, height as u32);
        self.beneath(
            &BitMapBackend::with_buffer(&mut fine, whole).into_drawing_area(),
            (scale, SINK),
        )?;
        for drawn in &self.panels {
            self.paint(drawn, &mut fine, width, scale);
        }
        let area = BitMapBackend::with_buffer(&mut fine, whole).into_drawing_area();
        self.above(&Pen::new(&area, scale, SINK))?;
        drop(area);
        let [width, height] = [width / FINER, height / FINER];
        let coarse = average(&fine, width, height);
        encoded(&coarse, width, height)
    }

    fn paint(&self, drawn: &Drawn<'_>, pixels: &mut [u8], width: usize, scale: f64) {
        let Drawn { panel, map, .. } = drawn;
        let [across, down] = panel.size().map(|points| (points * scale).round() as usize);
        let [left, top] = panel.corner.map(|points| (points * scale).round() as usize);
        let colours: Vec<Option<Rgb>> = map
            .values
            .iter()
            .map(|value| drawn.colour(*value))
            .collect();
        fill(self.sheet, panel.extent, across, down, |pixel, triangle| {
            let (row, column) = (top + pixel / across, left + pixel % across);
            let at = 3 * (row * width + column);
            if let (Some(colour), Some(pixel)) = (colours[triangle], pixels.get_mut(at..at + 3)) {
                pixel.copy_from_slice(&colour);
            }
        });
    }

    fn svg(&self) -> Result<String, PictureError> {
        let size = self.pixels(GRAIN);
        let whole = (size[0] as u32, size[1] as u32);
        let mut drawn = [String::new(), String::new()];
        let [beneath, above] = &mut drawn;
        self.beneath(
            &SVGBackend::with_string(beneath, whole).into_drawing_area(),
            (GRAIN, 0.0),
        )?;
        let area = SVGBackend::with_string(above, whole).into_drawing_area();
        self.above(&Pen::new(&area, GRAIN, 0.0))?;
        drop(area);
        let [beneath, above] = drawn.each_ref().map(|svg| inside(svg));
        let [width, height] = self.pixels(1.0);
        let mut svg = opening([width, height], [whole.0, whole.1]);
        svg += beneath;
        for drawn in &self.panels {
            svg += &self.triangles(drawn);
        }
        svg += above;
        svg += "</svg>\n";
        Ok(svg)
    }

    /// The triangles of each colour as one path. A stroke of the same colour closes the seams in viewers.
    fn triangles(&self, drawn: &Drawn<'_>) -> String {
        let Drawn { panel, map, .. } = drawn;
        let mut paths: BTreeMap<Rgb, String> = BTreeMap::new();
        for (triangle, value) in self.sheet.triangles.iter().zip(&map.values) {
            let Some(colour) = drawn.colour(*value) else {
                continue;
            };
            let path = paths.entry(colour).or_default();
            let [a, b, c] = triangle.map(|corner| {
                panel
                    .place(corner)
                    .map(|points| (points * GRAIN).round() as i64)
            });
            let [to_b, to_c] = [b, c].map(|corner| [corner[0] - a[0], corner[1] - a[1]]);
            let on = [to_c[0] - to_b[0], to_c[1] - to_b[1]];
            // Writing to a string cannot fail.
            let _ = write!(
                path,
                "M{} {}l{} {} {} {}z",
                a[0], a[1], to_b[0], to_b[1], on[0], on[1]
            );
        }
        let mut svg = String::new();
        for ([r, g, b], path) in paths {
            let colour = format!("#{r:02x}{g:02x}{b:02x}");
            let _ = writeln!(
                svg,
                "<path fill=\"{colour}\" stroke=\"{colour}\" stroke-width=\"2\" stroke-linejoin=\"round\" d=\"{path}\"/>"
            );
        }
        svg
    }
}

pub(crate) fn average(fine: &[u8], width: usize, height: usize) -> Vec<u8> {
    let mut coarse = Vec::with_capacity(width * height * 3);
    for row in 0..height {
        for column in 0..width {
            for channel in 0..3 {
                let mut sum = 0_usize;
                for y in row * FINER..(row + 1) * FINER {
                    for x in column * FINER..(column + 1) * FINER {
                        sum += usize::from(fine[3 * (y * width * FINER + x) + channel]);
                    }
                }
                coarse.push((sum / (FINER * FINER)) as u8);
            }
        }
    }
    coarse
}
