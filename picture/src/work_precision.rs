//! Accuracy against time: a panel a judged set, a point a method.

use plotters::prelude::*;

use crate::PictureError;
use crate::pen::{Anchor, INK, Pen};

/// One method on one set.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkPoint {
    /// The set: points of the same set share a panel.
    pub panel: String,
    /// The method.
    pub name: String,
    /// Time a frame, ms.
    pub ms: f64,
    /// The accuracy, 0 to 1, upwards.
    pub value: f64,
    /// What else stands beside it.
    pub words: String,
}

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 330.0;
const SCALE: f64 = 2.0;
/// plotters writes words of a bitmap too high by this part of their size.
const SINK: f64 = 0.1;
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 90, 160),
    RGBColor(200, 80, 0),
    RGBColor(0, 130, 80),
    RGBColor(150, 40, 120),
    RGBColor(110, 110, 0),
    RGBColor(190, 30, 50),
    RGBColor(70, 70, 150),
    RGBColor(90, 60, 40),
];

/// A PNG with two panels a row; `marks` are times (ms) drawn as upright lines with their names.
///
/// # Errors
/// No point, a value that is not finite or a time that is not positive; or a drawing that fails.
pub fn work_precision_png(
    title: &str,
    points: &[WorkPoint],
    marks: &[(&str, f64)],
) -> Result<Vec<u8>, PictureError> {
    let sound = |p: &&WorkPoint| p.value.is_finite() && p.ms > 0.0 && p.ms.is_finite();
    if points.is_empty() || points.iter().filter(sound).count() < points.len() {
        return Err(PictureError::EmptyGrid);
    }
    let mut panels: Vec<&str> = Vec::new();
    for point in points {
        if !panels.contains(&point.panel.as_str()) {
            panels.push(&point.panel);
        }
    }
    let times = points.iter().map(|p| p.ms).chain(marks.iter().map(|m| m.1));
    let low = times.clone().fold(f64::INFINITY, f64::min).log10().floor();
    let high = times.fold(0.0, f64::max).log10().ceil().max(low + 1.0);
    let columns = panels.len().min(2);
    let rows = panels.len().div_ceil(columns);
    let size = [WIDTH * columns as f64 + 20.0, HEIGHT * rows as f64 + 44.0];
    let pixels = size.map(|points| (points * SCALE).round() as u32);
    let mut buffer = vec![255; (pixels[0] * pixels[1] * 3) as usize];
    {
        let area =
            BitMapBackend::with_buffer(&mut buffer, (pixels[0], pixels[1])).into_drawing_area();
        let drawn = |fault: String| PictureError::Draw(fault);
        area.fill(&WHITE)
            .map_err(|fault| drawn(fault.to_string()))?;
        let pen = Pen::new(&area, SCALE, SINK);
        pen.bold(title, [size[0] / 2.0, 22.0], 15.0, INK, Anchor::Centre)?;
        for (k, name) in panels.iter().enumerate() {
            let corner = [
                WIDTH * (k % columns) as f64 + 10.0,
                HEIGHT * (k / columns) as f64 + 40.0,
            ];
            panel(&pen, corner, name, points, marks, [low, high])?;
        }
        area.present().map_err(|fault| drawn(fault.to_string()))?;
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, pixels[0], pixels[1]);
    encoder.set_color(png::ColorType::Rgb);
    let failed = |fault: png::EncodingError| PictureError::Draw(fault.to_string());
    let mut writer = encoder.write_header().map_err(failed)?;
    writer.write_image_data(&buffer).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

fn panel<DB: DrawingBackend>(
    pen: &Pen<'_, DB>,
    corner: [f64; 2],
    name: &str,
    points: &[WorkPoint],
    marks: &[(&str, f64)],
    [low, high]: [f64; 2],
) -> Result<(), PictureError> {
    const PALE: RGBColor = RGBColor(205, 205, 210);
    let (left, top) = (corner[0] + 44.0, corner[1] + 26.0);
    let (wide, tall) = (WIDTH - 70.0, HEIGHT - 80.0);
    let x = |ms: f64| left + (ms.log10() - low) / (high - low) * wide;
    let y = |value: f64| top + (1.0 - value.clamp(0.0, 1.0)) * tall;
    pen.bold(
        name,
        [left + wide / 2.0, corner[1] + 10.0],
        13.0,
        INK,
        Anchor::Centre,
    )?;
    for decade in low as i32..=high as i32 {
        let at = left + (f64::from(decade) - low) / (high - low) * wide;
        pen.line([[at, top], [at, top + tall]], PALE, 0.5)?;
        let words = if decade < 0 {
            format!("{:.*}", decade.unsigned_abs() as usize, 10_f64.powi(decade))
        } else {
            format!("{:.0}", 10_f64.powi(decade))
        };
        pen.text(&words, [at, top + tall + 11.0], 10.0, INK, Anchor::Centre)?;
    }
    for k in 0..=5 {
        let value = f64::from(k) / 5.0;
        pen.line([[left, y(value)], [left + wide, y(value)]], PALE, 0.5)?;
        pen.text(
            &format!("{value:.1}"),
            [left - 6.0, y(value)],
            10.0,
            INK,
            Anchor::Right,
        )?;
    }
    pen.text(
        "ms a frame",
        [left + wide / 2.0, top + tall + 26.0],
        10.0,
        INK,
        Anchor::Centre,
    )?;
    for (k, (words, ms)) in marks.iter().enumerate() {
        pen.line(
            [[x(*ms), top], [x(*ms), top + tall]],
            RGBColor(120, 120, 126),
            1.5,
        )?;
        let at = [x(*ms) + 3.0, top + tall - 8.0 - 12.0 * k as f64];
        pen.text(words, at, 9.0, RGBColor(90, 90, 96), Anchor::Left)?;
    }
    // words that would stand on one another move down
    let mut taken: Vec<[f64; 2]> = Vec::new();
    let here: Vec<&WorkPoint> = points.iter().filter(|p| p.panel == name).collect();
    for (k, point) in here.iter().enumerate() {
        let colour = COLOURS[k % COLOURS.len()];
        let at = [x(point.ms), y(point.value)];
        pen.draw(Circle::new(
            pen.pixel(at),
            (4.0 * SCALE) as i32,
            colour.filled(),
        ))?;
        let right = at[0] < left + 0.62 * wide;
        let mut place = [at[0] + if right { 8.0 } else { -8.0 }, at[1]];
        while taken
            .iter()
            .any(|t| (t[1] - place[1]).abs() < 11.0 && (t[0] - place[0]).abs() < 150.0)
        {
            place[1] += 11.0;
        }
        taken.push(place);
        let words = if point.words.is_empty() {
            point.name.clone()
        } else {
            format!("{}, {}", point.name, point.words)
        };
        let anchor = if right { Anchor::Left } else { Anchor::Right };
        pen.text(&words, place, 10.0, colour, anchor)?;
    }
    Ok(())
}
