//! A mesh: every triangle's edges, the region shaded, electrodes numbered.

use plotters::coord::Shift;
use plotters::prelude::*;

use crate::chart::{Panel, RING, heading};
use crate::image::{encoded, failed, inside};
use crate::pen::Pen;
use crate::{PictureError, Sheet, Style};

const FINER: f64 = 2.0;
const GRAIN: f64 = 4.0;
/// plotters writes words of a bitmap too high by this part of their size.
const SINK: f64 = 0.1;
const WIDTH: f64 = 640.0;
const REGION: RGBColor = RGBColor(206, 224, 240);
const EDGE: RGBColor = RGBColor(120, 120, 126);

/// A mesh as a PNG: `all` its triangles (m), of which the sheet's are the region.
///
/// # Errors
/// A sheet without area.
pub fn mesh_png(
    sheet: &Sheet,
    all: &[[[f64; 2]; 3]],
    title: &str,
) -> Result<Vec<u8>, PictureError> {
    let plot = Plot::new(sheet, all, title)?;
    let size = plot.size.map(|points| (points * FINER) as u32);
    let mut pixels = vec![255; (size[0] * size[1] * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut pixels, (size[0], size[1])).into_drawing_area();
        plot.draw(&area, FINER, SINK)?;
        area.present().map_err(failed)?;
    }
    encoded(&pixels, size[0] as usize, size[1] as usize)
}

/// A mesh as an SVG, as [`mesh_png`].
///
/// # Errors
/// As [`mesh_png`].
pub fn mesh_svg(sheet: &Sheet, all: &[[[f64; 2]; 3]], title: &str) -> Result<String, PictureError> {
    let plot = Plot::new(sheet, all, title)?;
    let size = plot.size.map(|points| (points * GRAIN) as u32);
    let mut drawn = String::new();
    {
        let area = SVGBackend::with_string(&mut drawn, (size[0], size[1])).into_drawing_area();
        plot.draw(&area, GRAIN, 0.0)?;
        area.present().map_err(failed)?;
    }
    let [width, height] = plot.size;
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {} {}\">\n{}</svg>\n",
        size[0],
        size[1],
        inside(&drawn)
    ))
}

struct Plot<'a> {
    sheet: &'a Sheet,
    all: &'a [[[f64; 2]; 3]],
    title: &'a str,
    panel: Panel,
    size: [f64; 2],
}

impl<'a> Plot<'a> {
    fn new(
        sheet: &'a Sheet,
        all: &'a [[[f64; 2]; 3]],
        title: &'a str,
    ) -> Result<Self, PictureError> {
        let extent = sheet.extent()?;
        let (left, right, top, bottom) = (72.0, 24.0, 62.0, 52.0);
        let per_metre = (WIDTH - left - right - 2.0 * RING) / extent.width();
        let panel = Panel {
            corner: [left + RING, top + RING],
            per_metre,
            extent,
            words: 14.0,
            numbered: [true, true],
        };
        let size = [WIDTH, top + panel.size()[1] + 2.0 * RING + bottom];
        Ok(Self {
            sheet,
            all,
            title,
            panel,
            size,
        })
    }

    fn draw<DB: DrawingBackend>(
        &self,
        area: &DrawingArea<DB, Shift>,
        scale: f64,
        sink: f64,
    ) -> Result<(), PictureError> {
        area.fill(&WHITE).map_err(failed)?;
        let pen = Pen::new(area, scale, sink);
        self.panel.ground(&pen, self.sheet)?;
        for triangle in &self.sheet.triangles {
            pen.area(&triangle.map(|p| self.panel.place(p)), REGION)?;
        }
        for [a, b, c] in self.all {
            let corners = [a, b, c, a].map(|p| self.panel.place(*p));
            pen.line(corners, EDGE, 0.4)?;
        }
        self.panel.furniture(&pen, self.sheet, &Style::default())?;
        let below = format!(
            "{} triangles, {} of them in the region of interest (shaded), {} electrodes",
            self.all.len(),
            self.sheet.triangles.len(),
            self.sheet.electrodes.len()
        );
        heading(&pen, self.title, &below, false, self.size[0])
    }
}
