//! PNG and SVG: one map, or many with one scale.

use std::collections::BTreeMap;
use std::fmt::Write;

use plotters::coord::Shift;
use plotters::prelude::*;
use survey::Map;

use crate::chart::{Panel, RING, bar, caption, heading, legend, small_title};
use crate::pen::Pen;
use crate::raster::{check_size, fill};
use crate::{PictureError, Range, Rgb, Sheet, Style};

/// Each pixel of a PNG is the mean of so many by so many.
const FINER: usize = 2;
/// plotters writes words of a bitmap too high by this part of their size, those of an SVG right.
const SINK: f64 = 0.1;
/// Lines and words of an SVG lie on a grid of so many to the point (plotters knows whole numbers only).
const GRAIN: f64 = 4.0;

/// A map as a PNG, 720 pixels wide.
///
/// # Errors
/// A map of another sheet, a sheet without area, a scale that is none.
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

/// Many maps of one sheet in one PNG, row by row, with one scale that serves them all. It says SIMULATED if any is.
///
/// # Errors
/// As [`png()`]; or no map, or no column.
pub fn png_grid(
    sheet: &Sheet,
    maps: &[(Map, Style)],
    columns: usize,
    title: &str,
) -> Result<Vec<u8>, PictureError> {
    Page::grid(sheet, maps, columns, title)?.png()
}

/// Many maps of one sheet in one SVG, as [`png_grid`].
///
/// # Errors
/// As [`png_grid`].
pub fn svg_grid(
    sheet: &Sheet,
    maps: &[(Map, Style)],
    columns: usize,
    title: &str,
) -> Result<String, PictureError> {
    Page::grid(sheet, maps, columns, title)?.svg()
}

/// What goes where, in points.
struct Page<'a> {
    sheet: &'a Sheet,
    panels: Vec<(Panel, &'a Map, &'a Style)>,
    range: Range,
    title: &'a str,
    below: String,
    size: [f64; 2],
    /// Upper left corner, and size, of the colour bar.
    bar: [[f64; 2]; 2],
    single: bool,
}

impl<'a> Page<'a> {
    fn single(sheet: &'a Sheet, map: &'a Map, style: &'a Style) -> Result<Self, PictureError> {
        sheet.check(map)?;
        let extent = sheet.extent()?;
        let (width, left, right, top) = (720.0, 72.0, 116.0, 62.0);
        let marked = style.true_position.is_some() || style.found.is_some();
        let bottom = if marked { 78.0 } else { 52.0 };
        let per_metre =
            ((width - left - right - 2.0 * RING) / extent.width()).min(900.0 / extent.height());
        let panel = Panel {
            corner: [left + RING, top + RING],
            per_metre,
            extent,
            words: 14.0,
            numbered: [true, true],
        };
        let [across, down] = panel.size();
        let frame = down + 2.0 * RING;
        let range = Range::of([(map, style.scale)])?;
        // Words at the ends of the bar need room between frame and bar.
        let inset = if range.below || range.above {
            22.0
        } else {
            0.0
        };
        Ok(Self {
            sheet,
            range,
            title: &style.title,
            below: caption(map),
            size: [
                width.min(left + right + 2.0 * RING + across),
                top + frame + bottom,
            ],
            bar: [
                [left + 2.0 * RING + across + 20.0, top + inset],
                [18.0, frame - 2.0 * inset],
            ],
            panels: vec![(panel, map, style)],
            single: true,
        })
    }

    fn grid(
        sheet: &'a Sheet,
        maps: &'a [(Map, Style)],
        columns: usize,
        title: &'a str,
    ) -> Result<Self, PictureError> {
        let Some((first, _)) = maps.first().filter(|_| columns > 0) else {
            return Err(PictureError::EmptyGrid);
        };
        for (map, _) in maps {
            sheet.check(map)?;
        }
        let extent = sheet.extent()?;
        let range = Range::of(maps.iter().map(|(map, style)| (map, style.scale)))?;
        let columns = columns.min(maps.len());
        let rows = maps.len().div_ceil(columns);
        let (left, right, top, heading) = (64.0, 116.0, 62.0, 24.0);
        let marked = maps
            .iter()
            .any(|(_, style)| style.true_position.is_some() || style.found.is_some());
        let bottom = if marked { 60.0 } else { 36.0 };
        let cell = (1000.0 / columns as f64).clamp(170.0, 420.0);
        let gap = 14.0;
        let inner = cell - gap - 2.0 * RING;
        let per_metre = (inner / extent.width()).min(1.3 * inner / extent.height());
        let words = (cell / 20.0).clamp(10.0, 14.0);
        let mut size = [0.0; 2];
        let panels: Vec<_> = maps
            .iter()
            .enumerate()
            .map(|(index, (map, style))| {
                let (row, column) = (index / columns, index % columns);
                let mut panel = Panel {
                    corner: [0.0; 2],
                    per_metre,
                    extent,
                    words,
                    // A cell has numbers below where no other map stands below it.
                    numbered: [index + columns >= maps.len(), column == 0],
                };
                let [across, down] = panel.size();
                size = [across + 2.0 * RING + gap, down + 2.0 * RING + gap + heading];
                panel.corner = [
                    left + RING + column as f64 * size[0],
                    top + heading + RING + row as f64 * size[1],
                ];
                (panel, map, style)
            })
            .collect();
        let grid = [size[0] * columns as f64, size[1] * rows as f64];
        let full = grid[1] - heading - gap;
        let high = full.min(620.0);
        let methods_agree = maps.iter().all(|(map, _)| map.method == first.method);
        let masked: usize = maps.iter().map(|(map, _)| map.masked).sum();
        let mut below = if methods_agree {
            first.method.clone()
        } else {
            String::new()
        };
        if masked > 0 {
            let comma = if below.is_empty() { "" } else { ", " };
            let _ = write!(below, "{comma}{masked} readings left out in all");
        }
        let page = Self {
            sheet,
            panels,
            range,
            title,
            below,
            size: [(left + grid[0] + right).max(440.0), top + grid[1] + bottom],
            bar: [
                [left + grid[0] + 8.0, top + heading + (full - high) / 2.0],
                [18.0, high],
            ],
            single: false,
        };
        check_size(page.pixels(FINER as f64)[0], page.pixels(FINER as f64)[1])?;
        Ok(page)
    }

    fn pixels(&self, scale: f64) -> [usize; 2] {
        self.size.map(|points| (points * scale).round() as usize)
    }

    /// What lies beneath the maps.
    fn beneath<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        (scale, sink): (f64, f64),
    ) -> Result<(), PictureError> {
        area.fill(&WHITE).map_err(failed)?;
        let pen = Pen::new(area, scale, sink);
        self.panels
            .iter()
            .try_for_each(|(panel, _, _)| panel.ground(&pen, self.sheet))
    }

    /// What lies above them.
    fn above<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        (scale, sink): (f64, f64),
    ) -> Result<(), PictureError> {
        let pen = Pen::new(area, scale, sink);
        let styles = || self.panels.iter().map(|(_, _, style)| style);
        let simulated = styles().any(|style| style.simulated);
        heading(&pen, self.title, &self.below, simulated, self.size[0])?;
        for (panel, _, style) in &self.panels {
            panel.furniture(&pen, self.sheet, style)?;
            if !self.single {
                let middle = panel.corner[0] + panel.size()[0] / 2.0;
                let at = [middle, panel.corner[1] - RING - panel.words * 0.9];
                let room = panel.size()[0] + 2.0 * RING;
                small_title(&pen, &style.title, at, panel.words * 1.1, room)?;
            }
        }
        let label = self.panels[0].1.unit.label();
        bar(&pen, &self.range, label, self.bar[0], self.bar[1], 14.0)?;
        legend(
            &pen,
            [16.0, self.size[1] - 16.0],
            styles().any(|style| style.true_position.is_some()),
            styles().any(|style| style.found.is_some()),
        )
    }

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
        for (panel, map, _) in &self.panels {
            self.paint(panel, map, &mut fine, width, scale);
        }
        self.above(
            &BitMapBackend::with_buffer(&mut fine, whole).into_drawing_area(),
            (scale, SINK),
        )?;
        let [width, height] = [width / FINER, height / FINER];
        let coarse = average(&fine, width, height);
        encode(&coarse, width, height)
    }

    fn paint(&self, panel: &Panel, map: &Map, pixels: &mut [u8], width: usize, scale: f64) {
        let [across, down] = panel.size().map(|points| (points * scale).round() as usize);
        let [left, top] = panel.corner.map(|points| (points * scale).round() as usize);
        let colours: Vec<Option<Rgb>> =
            map.values.iter().map(|value| self.colour(*value)).collect();
        fill(self.sheet, panel.extent, across, down, |pixel, triangle| {
            let (row, column) = (top + pixel / across, left + pixel % across);
            let at = 3 * (row * width + column);
            if let (Some(colour), Some(pixel)) = (colours[triangle], pixels.get_mut(at..at + 3)) {
                pixel.copy_from_slice(&colour);
            }
        });
    }

    fn colour(&self, value: f64) -> Option<Rgb> {
        Some(value)
            .filter(|value| value.is_finite())
            .and_then(|value| self.range.colour(value))
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
        self.above(
            &SVGBackend::with_string(above, whole).into_drawing_area(),
            (GRAIN, 0.0),
        )?;
        let [beneath, above] = drawn.each_ref().map(|svg| inside(svg));
        let [width, height] = self.pixels(1.0);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {} {}\">\n",
            size[0], size[1]
        );
        svg += beneath;
        for (panel, map, _) in &self.panels {
            svg += &self.triangles(panel, map);
        }
        svg += above;
        svg += "</svg>\n";
        Ok(svg)
    }

    /// All triangles of one colour are one path; a stroke of the same colour closes the seams that viewers leave.
    fn triangles(&self, panel: &Panel, map: &Map) -> String {
        let mut paths: BTreeMap<Rgb, String> = BTreeMap::new();
        for (triangle, value) in self.sheet.triangles.iter().zip(&map.values) {
            let Some(colour) = self.colour(*value) else {
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

/// What stands between the first and the last tag of an SVG.
fn inside(svg: &str) -> &str {
    let after_head = svg
        .find("<svg")
        .and_then(|at| svg[at..].find('>').map(|end| at + end + 1));
    let from = after_head.unwrap_or(0);
    let to = svg.rfind("</svg>").unwrap_or(svg.len());
    svg.get(from..to).unwrap_or("")
}

fn average(fine: &[u8], width: usize, height: usize) -> Vec<u8> {
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

fn encode(pixels: &[u8], width: usize, height: usize) -> Result<Vec<u8>, PictureError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(pixels).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

fn failed(cause: impl std::fmt::Display) -> PictureError {
    PictureError::Draw(cause.to_string())
}
