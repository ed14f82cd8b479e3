//! PNG and SVG: one map, or many with one scale.

use std::collections::BTreeMap;
use std::fmt::Write;

use plotters::coord::Shift;
use plotters::prelude::*;
use survey::Map;

use crate::chart::{Panel, RING, bar, caption, heading, legend, small_title};
use crate::drawing::canvas::{FINER, GRAIN, SINK, encoded, failed, inside, opening};
use crate::drawing::pen::Pen;
use crate::raster::{check_size, fill};
use crate::{Grid, PictureError, Range, Rgb, Scales, Sheet, Style};

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

/// One map on the page.
struct Drawn<'a> {
    panel: Panel,
    map: &'a Map,
    style: &'a Style,
    range: Range,
}

/// A colour bar: its range, upper left corner and size, text size, and whether it has a label.
struct Bar {
    range: Range,
    corner: [f64; 2],
    size: [f64; 2],
    words: f64,
    labelled: bool,
}

/// Layout of a page, in points.
struct Page<'a> {
    sheet: &'a Sheet,
    panels: Vec<Drawn<'a>>,
    title: &'a str,
    below: String,
    size: [f64; 2],
    bars: Vec<Bar>,
    single: bool,
}

impl Drawn<'_> {
    fn colour(&self, value: f64) -> Option<Rgb> {
        Some(value)
            .filter(|value| value.is_finite())
            .and_then(|value| self.range.colour(value))
    }
}

/// Width of the colour bar next to a map of a grid.
const OWN_BAR: f64 = 58.0;

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
        let range = Range::styled(map, style)?;
        // Labels at the ends of the bar need space between frame and bar.
        let inset = if range.below || range.above {
            22.0
        } else {
            0.0
        };
        Ok(Self {
            sheet,
            title: &style.title,
            below: caption(map, style),
            size: [
                width.min(left + right + 2.0 * RING + across),
                top + frame + bottom,
            ],
            bars: vec![Bar {
                range,
                corner: [left + 2.0 * RING + across + 20.0, top + inset],
                size: [18.0, frame - 2.0 * inset],
                words: 14.0,
                labelled: true,
            }],
            panels: vec![Drawn {
                panel,
                map,
                style,
                range,
            }],
            single: true,
        })
    }

    fn grid(
        sheet: &'a Sheet,
        maps: &'a [(Map, Style)],
        grid: &Grid<'a>,
    ) -> Result<Self, PictureError> {
        let Some((first, _)) = maps.first().filter(|_| grid.columns > 0) else {
            return Err(PictureError::EmptyGrid);
        };
        for (map, _) in maps {
            sheet.check(map)?;
        }
        let extent = sheet.extent()?;
        let common = Range::of(maps.iter().map(|(map, style)| (map, style.scale)))?;
        let each = grid.scales == Scales::Each;
        let beside = if each { OWN_BAR } else { 0.0 };
        let columns = grid.columns.min(maps.len());
        let rows = maps.len().div_ceil(columns);
        let (left, top, heading) = (64.0, 62.0, 24.0);
        let right = if each { 20.0 } else { 116.0 };
        let marked = maps.iter().any(|(_, style)| {
            style.true_position.is_some() || style.found.is_some() || !style.true_outline.is_empty()
        });
        let bottom = if marked { 60.0 } else { 36.0 };
        let cell = (1000.0 / columns as f64 - beside).clamp(170.0, 420.0);
        let gap = 14.0;
        let inner = cell - gap - 2.0 * RING;
        let per_metre = (inner / extent.width()).min(1.3 * inner / extent.height());
        let words = (cell / 20.0).clamp(10.0, 14.0);
        let mut size = [0.0; 2];
        let mut bars = Vec::new();
        let mut panels = Vec::with_capacity(maps.len());
        for (index, (map, style)) in maps.iter().enumerate() {
            let (row, column) = (index / columns, index % columns);
            let mut panel = Panel {
                corner: [0.0; 2],
                per_metre,
                extent,
                words,
                // A cell has numbers below if there is no map below it.
                numbered: [index + columns >= maps.len(), column == 0],
            };
            let [across, down] = panel.size();
            size = [
                across + 2.0 * RING + gap + beside,
                down + 2.0 * RING + gap + heading,
            ];
            panel.corner = [
                left + RING + column as f64 * size[0],
                top + heading + RING + row as f64 * size[1],
            ];
            let range = match each {
                true => Range::styled(map, style)?,
                false => common,
            };
            if each {
                bars.push(Bar {
                    range,
                    corner: [panel.corner[0] + across + RING + 4.0, panel.corner[1]],
                    size: [10.0, down],
                    words,
                    labelled: false,
                });
            }
            panels.push(Drawn {
                panel,
                map,
                style,
                range,
            });
        }
        let whole = [size[0] * columns as f64, size[1] * rows as f64];
        let full = whole[1] - heading - gap;
        let high = full.min(620.0);
        if !each {
            bars.push(Bar {
                range: common,
                corner: [left + whole[0] + 8.0, top + heading + (full - high) / 2.0],
                size: [18.0, high],
                words: 14.0,
                labelled: true,
            });
        }
        let methods_agree = maps.iter().all(|(map, _)| map.method == first.method);
        let masked: usize = maps.iter().map(|(map, _)| map.masked).sum();
        let mut below: Vec<String> = Vec::new();
        if methods_agree {
            below.push(first.method.clone());
        }
        if masked > 0 {
            below.push(format!("{masked} readings left out in all"));
        }
        if each {
            let (_, unit) = common.unit.shown();
            below.push(format!(
                "a colour bar for each map: {}, {unit}",
                common.unit.caption()
            ));
        }
        let page = Self {
            sheet,
            panels,
            title: grid.title,
            below: below.join(", "),
            size: [
                (left + whole[0] + right).max(440.0),
                top + whole[1] + bottom,
            ],
            bars,
            single: false,
        };
        check_size(page.pixels(FINER as f64)[0], page.pixels(FINER as f64)[1])?;
        Ok(page)
    }

    fn pixels(&self, scale: f64) -> [usize; 2] {
        self.size.map(|points| (points * scale).round() as usize)
    }

    /// The layer below the maps: paper and sheets.
    fn beneath<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        (scale, sink): (f64, f64),
    ) -> Result<(), PictureError> {
        area.fill(&WHITE).map_err(failed)?;
        let pen = Pen::new(area, scale, sink);
        self.panels
            .iter()
            .try_for_each(|drawn| drawn.panel.ground(&pen, self.sheet))
    }

    /// The layer above the maps: outlines, axes, marks, texts.
    fn above<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        (scale, sink): (f64, f64),
    ) -> Result<(), PictureError> {
        let pen = Pen::new(area, scale, sink);
        let styles = || self.panels.iter().map(|drawn| drawn.style);
        let simulated = styles().any(|style| style.simulated);
        heading(&pen, self.title, &self.below, simulated, self.size[0])?;
        for Drawn { panel, style, .. } in &self.panels {
            panel.furniture(&pen, self.sheet, style)?;
            if !self.single {
                let middle = panel.corner[0] + panel.size()[0] / 2.0;
                let at = [middle, panel.corner[1] - RING - panel.words * 0.9];
                let available = panel.size()[0] + 2.0 * RING;
                small_title(&pen, &style.title, at, panel.words * 1.1, available)?;
            }
        }
        for drawn in &self.bars {
            let Bar {
                range,
                corner,
                size,
                words,
                labelled,
            } = drawn;
            bar(&pen, range, *labelled, *corner, *size, *words)?;
        }
        let truth = |style: &Style| style.true_position.is_some() || !style.true_outline.is_empty();
        legend(
            &pen,
            [16.0, self.size[1] - 16.0],
            styles().any(truth),
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
        for drawn in &self.panels {
            self.paint(drawn, &mut fine, width, scale);
        }
        self.above(
            &BitMapBackend::with_buffer(&mut fine, whole).into_drawing_area(),
            (scale, SINK),
        )?;
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
        self.above(
            &SVGBackend::with_string(above, whole).into_drawing_area(),
            (GRAIN, 0.0),
        )?;
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

    /// All triangles of one colour are one path; a stroke of the same colour closes the seams in viewers.
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
