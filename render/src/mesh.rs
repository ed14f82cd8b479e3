//! A mesh: every triangle's edges, the region shaded, electrodes numbered.

use plotters::prelude::*;

use crate::chart::{Panel, RING, heading};
use crate::drawing::canvas::{Drawing, PALE};
use crate::drawing::pen::Pen;
use crate::{PictureError, Sheet};

const WIDTH: f64 = 640.0;
const REGION: RGBColor = RGBColor(206, 224, 240);

/// A mesh as a PNG. `all`: all its triangles, m; those of `sheet` are the region.
///
/// # Errors
/// A sheet without area.
pub fn mesh_png(
    sheet: &Sheet,
    all: &[[[f64; 2]; 3]],
    title: &str,
) -> Result<Vec<u8>, PictureError> {
    Plot::new(sheet, all, title)?.png()
}

/// A mesh as an SVG, as [`mesh_png`].
///
/// # Errors
/// As [`mesh_png`].
pub fn mesh_svg(sheet: &Sheet, all: &[[[f64; 2]; 3]], title: &str) -> Result<String, PictureError> {
    Plot::new(sheet, all, title)?.svg()
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
}

impl Drawing for Plot<'_> {
    fn size(&self) -> [f64; 2] {
        self.size
    }

    fn draw<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError> {
        self.panel.ground(pen, self.sheet)?;
        for triangle in &self.sheet.triangles {
            pen.area(&triangle.map(|p| self.panel.place(p)), REGION)?;
        }
        for [a, b, c] in self.all {
            let corners = [a, b, c, a].map(|p| self.panel.place(*p));
            pen.line(corners, PALE, 0.4)?;
        }
        self.panel.furniture(pen, self.sheet)?;
        let below = format!(
            "{} triangles, {} of them in the region of interest (shaded), {} electrodes",
            self.all.len(),
            self.sheet.triangles.len(),
            self.sheet.electrodes.len()
        );
        heading(pen, self.title, &below, false, self.size[0])
    }
}
