//! The pictures of a film: the parts that are the same in all of them are drawn once.

use plotters::prelude::*;
use survey::Map;

use crate::drawing::canvas::{FINER, SINK};
use crate::drawing::pen::Pen;
use crate::image::average;
use crate::page::Page;
use crate::raster::{check_size, fill};
use crate::{PictureError, Range, Rgb, Sheet, Style};

/// No triangle.
const NONE: u32 = u32::MAX;

/// All sizes and positions are in fine pixels; [`FINER`] by [`FINER`] of them become one pixel of the picture.
pub(crate) struct Layers {
    sheet: Sheet,
    range: Range,
    width: usize,
    height: usize,
    /// Everything but triangles, title and marks, drawn on the sheet: red, green and blue of each pixel.
    fixed: Vec<u8>,
    /// The pixels that show only a triangle: pixel and triangle, in the order of pixels.
    triangles: Vec<(u32, u32)>,
    /// The pixels with lines or text over a triangle: pixel, triangle, and the colours over black and over white.
    over: Vec<(u32, u32, Rgb, Rgb)>,
    /// The picture being drawn.
    canvas: Vec<u8>,
}

impl Layers {
    /// `style`: the marks that the legend explains.
    pub(crate) fn new(sheet: &Sheet, range: Range, style: &Style) -> Result<Self, PictureError> {
        let map = empty(sheet, range);
        let page = Page::with_range(sheet, &map, style, range)?;
        let [width, height] = page.pixels(1.0).map(|points| points * FINER);
        check_size(width, height)?;
        let scale = FINER as f64;
        let whole = (width as u32, height as u32);
        let mut fixed = vec![255; width * height * 3];
        let mut backgrounds = [vec![0; width * height * 3], vec![255; width * height * 3]];
        page.beneath(
            &BitMapBackend::with_buffer(&mut fixed, whole).into_drawing_area(),
            (scale, SINK),
        )?;
        for pixels in backgrounds.iter_mut().chain([&mut fixed]) {
            let area = BitMapBackend::with_buffer(pixels, whole).into_drawing_area();
            page.fixed(&Pen::new(&area, scale, SINK))?;
        }
        let mut triangle_at = vec![NONE; width * height];
        for drawn in &page.panels {
            let panel = &drawn.panel;
            let [across, down] = panel.size().map(|points| (points * scale).round() as usize);
            let [left, top] = panel.corner.map(|points| (points * scale).round() as usize);
            fill(sheet, panel.extent, across, down, |pixel, triangle| {
                let at = (top + pixel / across) * width + left + pixel % across;
                if let Some(place) = triangle_at.get_mut(at) {
                    *place = triangle as u32;
                }
            });
        }
        let pixel =
            |pixels: &[u8], at: usize| [pixels[3 * at], pixels[3 * at + 1], pixels[3 * at + 2]];
        let (mut triangles, mut over) = (Vec::new(), Vec::new());
        for (at, &triangle) in triangle_at.iter().enumerate() {
            if triangle == NONE {
                continue;
            }
            let [black, white] = backgrounds.each_ref().map(|pixels| pixel(pixels, at));
            match (black, white) {
                ([0, 0, 0], [255, 255, 255]) => triangles.push((at as u32, triangle)),
                _ => over.push((at as u32, triangle, black, white)),
            }
        }
        Ok(Self {
            sheet: sheet.clone(),
            range,
            width,
            height,
            canvas: fixed.clone(),
            fixed,
            triangles,
            over,
        })
    }

    /// Width and height of a picture.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.width / FINER, self.height / FINER]
    }

    /// The picture of a map: red, green and blue of each pixel.
    pub(crate) fn picture(&mut self, map: &Map, style: &Style) -> Result<Vec<u8>, PictureError> {
        let range = Range {
            grey: style.nothing_above.is_some(),
            ..self.range
        };
        let page = Page::with_range(&self.sheet, map, style, range)?;
        let finite = |value: &f64| Some(*value).filter(|value| value.is_finite());
        let colour = |value: &f64| finite(value).and_then(|value| range.colour(value));
        let colours: Vec<Option<Rgb>> = map.values.iter().map(colour).collect();
        self.canvas.copy_from_slice(&self.fixed);
        for &(at, triangle) in &self.triangles {
            if let Some(colour) = colours[triangle as usize] {
                let at = 3 * at as usize;
                self.canvas[at..at + 3].copy_from_slice(&colour);
            }
        }
        for &(at, triangle, black, white) in &self.over {
            if let Some(colour) = colours[triangle as usize] {
                for axis in 0..3 {
                    let [black, white] = [black, white].map(|side| u32::from(side[axis]));
                    let through = u32::from(colour[axis]) * white.saturating_sub(black) / 255;
                    self.canvas[3 * at as usize + axis] = (black + through).min(255) as u8;
                }
            }
        }
        let whole = (self.width as u32, self.height as u32);
        let area = BitMapBackend::with_buffer(&mut self.canvas, whole).into_drawing_area();
        let pen = Pen::new(&area, FINER as f64, SINK);
        page.heading(&pen)?;
        page.marks(&pen)?;
        drop(area);
        let [width, height] = self.size();
        Ok(average(&self.canvas, width, height))
    }
}

/// A map without values.
fn empty(sheet: &Sheet, range: Range) -> Map {
    Map {
        mesh_hash: String::new(),
        values: vec![f64::NAN; sheet.triangles.len()],
        unit: range.unit,
        method: String::new(),
        masked: 0,
        evidence: None,
        quality: None,
    }
}
