//! The page of every picture: a white area in points, as PNG and as SVG; and the colours of curves and points.

use plotters::prelude::*;

use crate::PictureError;
use crate::drawing::pen::Pen;
use crate::raster::check_size;

/// Pixels of a PNG per point, in each direction; maps are drawn finer by this factor and averaged.
pub(crate) const FINER: usize = 2;
/// Resolution of lines and text in an SVG per point (plotters uses integers only).
pub(crate) const GRAIN: f64 = 4.0;
/// plotters draws text in bitmaps too high by this fraction of its size; in SVGs its position is correct.
pub(crate) const SINK: f64 = 0.1;

/// The words by which the name of a method is recognised, and its colour in every figure. The first row of which all
/// words occur in the name is used.
const METHODS: [(&[&str], RGBColor); 10] = [
    (&["best"], RGBColor(190, 30, 50)),
    (&["one-step", "loss"], RGBColor(200, 80, 0)),
    (&["one-step"], RGBColor(0, 90, 160)),
    (&["tv", "paper"], RGBColor(0, 130, 80)),
    (&["tv", "printed"], RGBColor(0, 130, 80)),
    (&["tv", "loss"], RGBColor(150, 40, 120)),
    (&["tv"], RGBColor(215, 110, 180)),
    (&["linear"], RGBColor(110, 110, 0)),
    (&["rbf"], RGBColor(90, 60, 40)),
    (&["deep"], RGBColor(0, 150, 165)),
];

/// The colour of a curve or point: that of the method whose words its name contains, otherwise that of its index.
pub(crate) fn colour_of(name: &str, index: usize) -> RGBColor {
    let name = name.to_lowercase();
    METHODS
        .iter()
        .find(|(words, _)| words.iter().all(|word| name.contains(word)))
        .map_or(COLOURS[index % COLOURS.len()], |(_, colour)| *colour)
}

/// Colours of adjacent elements; consecutive ones differ in brightness too.
pub(crate) const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 90, 160),
    RGBColor(200, 80, 0),
    RGBColor(0, 130, 80),
    RGBColor(150, 40, 120),
    RGBColor(110, 110, 0),
    RGBColor(190, 30, 50),
    RGBColor(70, 70, 150),
    RGBColor(90, 60, 40),
];
/// Grid lines behind curves and points.
pub(crate) const GRID: RGBColor = RGBColor(205, 205, 210);
/// Edges and vertical marks.
pub(crate) const PALE: RGBColor = RGBColor(120, 120, 126);

/// A picture that can be drawn by a pen.
pub(crate) trait Drawing {
    /// Width and height, points.
    fn size(&self) -> [f64; 2];

    /// Draws it on a white page.
    fn draw<DB: DrawingBackend>(&self, pen: &Pen<'_, DB>) -> Result<(), PictureError>;

    fn png(&self) -> Result<Vec<u8>, PictureError> {
        let [width, height] = self
            .size()
            .map(|points| (points * FINER as f64).round() as usize);
        check_size(width, height)?;
        let mut pixels = vec![255; width * height * 3];
        {
            let area = BitMapBackend::with_buffer(&mut pixels, (width as u32, height as u32))
                .into_drawing_area();
            area.fill(&WHITE).map_err(failed)?;
            self.draw(&Pen::new(&area, FINER as f64, SINK))?;
            area.present().map_err(failed)?;
        }
        encoded(&pixels, width, height)
    }

    fn svg(&self) -> Result<String, PictureError> {
        let size = self.size();
        let grains = size.map(|points| (points * GRAIN).round() as u32);
        let mut drawn = String::new();
        {
            let area = SVGBackend::with_string(&mut drawn, grains.into()).into_drawing_area();
            area.fill(&WHITE).map_err(failed)?;
            self.draw(&Pen::new(&area, GRAIN, 0.0))?;
            area.present().map_err(failed)?;
        }
        Ok(format!(
            "{}{}</svg>\n",
            opening(size.map(|points| points.round() as usize), grains),
            inside(&drawn)
        ))
    }
}

/// The first tag of an SVG: its size in points, and in units of the resolution.
pub(crate) fn opening([width, height]: [usize; 2], grains: [u32; 2]) -> String {
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {} {}\">\n",
        grains[0], grains[1]
    )
}

/// The content between the first and the last tag of an SVG.
pub(crate) fn inside(svg: &str) -> &str {
    let after_head = svg
        .find("<svg")
        .and_then(|at| svg[at..].find('>').map(|end| at + end + 1));
    let from = after_head.unwrap_or(0);
    let to = svg.rfind("</svg>").unwrap_or(svg.len());
    svg.get(from..to).unwrap_or("")
}

/// Pixels as a PNG.
pub(crate) fn encoded(pixels: &[u8], width: usize, height: usize) -> Result<Vec<u8>, PictureError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(pixels).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

pub(crate) fn failed(cause: impl std::fmt::Display) -> PictureError {
    PictureError::Draw(cause.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_method_has_one_colour_whatever_its_index() {
        assert_eq!(
            colour_of("TV, losses only", 0),
            colour_of("tv --loss-only", 5)
        );
        assert_eq!(colour_of("TV as printed", 0), colour_of("tv-paper", 2));
        assert_eq!(colour_of("paper's TV step", 1), colour_of("tv-paper", 2));
        assert_ne!(colour_of("one-step", 0), colour_of("deep network", 0));
        assert_ne!(colour_of("a", 0), colour_of("b", 1));
    }
}
