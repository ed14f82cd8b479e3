//! Films: maps of one sheet, one after the other, as an animated PNG (APNG) with 255 colours.
//!
//! Layout and colours are those of [`png()`](crate::png()). What does not change is drawn once; a picture contains only
//! the pixels that differ from the previous picture.

mod layers;
mod palette;

use std::io::Write;

use survey::Map;

use crate::drawing::canvas::failed;
use crate::{PictureError, Range, Sheet, Style};
use layers::Layers;
use palette::{Palette, TRANSPARENT};

/// Number and duration of the pictures of a film.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// Number of pictures; exactly as many must be added.
    pub pictures: u32,
    /// Duration of each, ms.
    pub each_ms: u16,
}

/// A film that is being written.
pub struct Film<W: Write> {
    writer: png::Writer<W>,
    layers: Layers,
    palette: Palette,
    size: [usize; 2],
    /// The previous picture, a palette index for each pixel; empty before the first one.
    before: Vec<u8>,
}

impl<W: Write> Film<W> {
    /// Begins a film that repeats without end. `range`: the scale of all maps ([`Range::of_film`]); `style`: the marks
    /// that the legend explains, and the label of a simulation.
    ///
    /// # Errors
    /// A sheet without area; no picture; a sink that cannot be written to.
    pub fn new(
        sink: W,
        sheet: &Sheet,
        range: Range,
        style: &Style,
        pace: Pace,
    ) -> Result<Self, PictureError> {
        let layers = Layers::new(sheet, range, style)?;
        let palette = Palette::new(&range);
        let size = layers.size();
        let mut encoder = png::Encoder::new(sink, size[0] as u32, size[1] as u32);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette(palette.bytes());
        encoder.set_trns(palette.opacities());
        encoder.set_deflate_compression(png::DeflateCompression::Level(2));
        // in flat areas, filters would only hide repeated bytes from the compression
        encoder.set_filter(png::Filter::NoFilter);
        encoder.validate_sequence(true);
        encoder.set_animated(pace.pictures, 0).map_err(failed)?;
        encoder
            .set_frame_delay(pace.each_ms, 1000)
            .map_err(failed)?;
        Ok(Self {
            writer: encoder.write_header().map_err(failed)?,
            layers,
            palette,
            size,
            before: Vec::new(),
        })
    }

    /// Adds the picture of a map, with the title and marks of its style; the style's scale is not used.
    ///
    /// # Errors
    /// A map of another sheet; a sink that cannot be written to; more pictures than announced.
    pub fn add(&mut self, map: &Map, style: &Style) -> Result<(), PictureError> {
        let pixels = self.layers.picture(map, style)?;
        let indices = self.palette.indices(&pixels);
        if self.before.is_empty() {
            self.writer.write_image_data(&indices).map_err(failed)?;
            self.writer
                .set_blend_op(png::BlendOp::Over)
                .map_err(failed)?;
        } else {
            self.changes(&indices)?;
        }
        self.before = indices;
        Ok(())
    }

    fn changes(&mut self, indices: &[u8]) -> Result<(), PictureError> {
        let part = Part::between(&self.before, indices, self.size[0]);
        let [[left, top], [width, height]] =
            [part.corner, part.size].map(|pair| pair.map(|n| n as u32));
        let writer = &mut self.writer;
        // the position first: the box must be inside the picture at every moment
        writer.reset_frame_position().map_err(failed)?;
        writer.set_frame_dimension(width, height).map_err(failed)?;
        writer.set_frame_position(left, top).map_err(failed)?;
        writer.write_image_data(&part.indices).map_err(failed)
    }

    /// Ends the film.
    ///
    /// # Errors
    /// Fewer pictures than announced; a sink that cannot be written to.
    pub fn finish(self) -> Result<(), PictureError> {
        self.writer.finish().map_err(failed)
    }
}

/// The box that contains all pixels that differ from the previous picture; the other pixels in it are transparent.
struct Part {
    corner: [usize; 2],
    size: [usize; 2],
    indices: Vec<u8>,
}

impl Part {
    fn between(before: &[u8], after: &[u8], width: usize) -> Self {
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for (row, (before, after)) in before.chunks(width).zip(after.chunks(width)).enumerate() {
            if before == after {
                continue;
            }
            for column in (0..width).filter(|column| before[*column] != after[*column]) {
                low = [low[0].min(column), low[1].min(row)];
                high = [high[0].max(column + 1), row + 1];
            }
        }
        // APNG requires at least one pixel in a picture
        if high == [0; 2] {
            (low, high) = ([0; 2], [1; 2]);
        }
        let rows = (low[1]..high[1]).map(|row| row * width + low[0]..row * width + high[0]);
        let indices = rows.flatten().map(|at| match before[at] == after[at] {
            true => TRANSPARENT,
            false => after[at],
        });
        Self {
            corner: low,
            size: [high[0] - low[0], high[1] - low[1]],
            indices: indices.collect(),
        }
    }
}
