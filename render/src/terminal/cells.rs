//! A map as character cells with colours.

use std::fmt::Write;

use survey::{Electrode, Map};

use super::TerminalColour;
use crate::drawing::colour::luminance;
use crate::raster::raster;
use crate::rim::Rim;
use crate::{Extent, PictureError, Range, Rgb, Sheet, Style};

/// Columns between the edge of the text and the sheet, for electrode numbers.
pub(super) const MARGIN: usize = 4;
/// Zero, followed by increasing loss.
const LOSS_SIGNS: &[u8] = b".:-=oO%@";
/// Zero, followed by increasing gain.
const GAIN_SIGNS: &[u8] = b".'\"^";

/// A colour that the terminal supports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CellColour {
    /// 24 bits.
    Rgb(Rgb),
    /// One of the 256 colours of xterm.
    Indexed(u8),
}

/// One character cell. Without a colour it has the terminal's default colours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TerminalCell {
    /// The character.
    pub sign: char,
    /// Its colour.
    pub fore: Option<CellColour>,
    /// The colour behind it.
    pub back: Option<CellColour>,
    /// Whether it is bold: a mark on the sheet.
    pub bold: bool,
}

/// The colour scale of a map in a terminal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TerminalScale {
    /// Cells from the lowest to the highest value.
    pub bar: Vec<TerminalCell>,
    /// The lowest value, with its unit.
    pub low: String,
    /// The highest value, with its unit.
    pub high: String,
    /// The displayed quantity, without its unit.
    pub unit: &'static str,
}

/// The sheet, surrounded by the electrodes' numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TerminalMap {
    /// Rows of cells, the top first, all of one length.
    pub rows: Vec<Vec<TerminalCell>>,
    /// Its colour scale.
    pub scale: TerminalScale,
}

/// A map as cells, as large as fits into `columns` and `rows`, with at least one cell of sheet within its margin.
/// `marks`: short texts at positions of the sheet, m.
///
/// # Errors
/// A map of another sheet, a sheet without area, an invalid scale.
pub fn terminal_map(
    sheet: &Sheet,
    map: &Map,
    [columns, rows]: [usize; 2],
    marks: &[([f64; 2], String)],
    colour: TerminalColour,
    style: &Style,
) -> Result<TerminalMap, PictureError> {
    let extent = sheet.extent()?;
    let range = Range::styled(map, style)?;
    let available = columns.saturating_sub(2 * MARGIN);
    let (columns, rows) = fitting(extent, available, rows.saturating_sub(2));
    let mut canvas = Canvas::new(extent, columns, rows);
    canvas.paint(&raster(sheet, map, columns, 2 * rows)?);
    canvas.number(sheet);
    canvas.hatch(sheet, map);
    for (place, text) in marks {
        canvas.mark(*place, text);
    }
    let ink = Ink(colour);
    Ok(TerminalMap {
        rows: canvas.rows(&range, ink),
        scale: scale_cells(map, &range, columns.clamp(8, 24), ink),
    })
}

/// Columns and rows of the sheet: the largest that keep its shape. A cell is about twice as high as wide: two square
/// pixels.
pub(super) fn fitting(extent: Extent, columns: usize, rows: usize) -> (usize, usize) {
    let shape = extent.height() / extent.width();
    let high = (columns as f64 * shape / 2.0).round() as usize;
    let (columns, rows) = match high > rows {
        true => (((2 * rows) as f64 / shape).round() as usize, rows),
        false => (columns, high),
    };
    (columns.max(1), rows.max(1))
}

/// The scale of a map, `width` cells wide.
pub(super) fn scale_cells(map: &Map, range: &Range, width: usize, ink: Ink) -> TerminalScale {
    let [(least, under), (most, over)] = range.ends();
    let value = |cell: usize| least + (cell as f64 + 0.5) / width as f64 * (most - least);
    let sign = |beyond: bool, sign: &'static str| if beyond { sign } else { "" };
    TerminalScale {
        bar: (0..width)
            .map(|cell| ink.cell([Some(value(cell)); 2], range))
            .collect(),
        low: format!("{}{}", sign(under, "<= "), range.words(least)),
        high: format!("{}{}", sign(over, ">= "), range.words(most)),
        unit: map.unit.caption(),
    }
}

/// Cells as text with escape sequences; the text ends with the terminal's default colours.
pub(super) fn written(cells: &[TerminalCell]) -> String {
    let mut text = String::new();
    let mut coloured = false;
    for cell in cells {
        cell.write(&mut text, &mut coloured);
    }
    if coloured {
        text.push_str("\u{1b}[0m");
    }
    text
}

impl TerminalCell {
    fn of(sign: char) -> Self {
        Self {
            sign,
            fore: None,
            back: None,
            bold: false,
        }
    }

    /// Writes the cell. `coloured`: whether the terminal has other colours than its default ones.
    fn write(self, text: &mut String, coloured: &mut bool) {
        if self.back.is_none() && std::mem::take(coloured) {
            text.push_str("\u{1b}[0m");
        }
        if self.bold {
            text.push_str("\u{1b}[1m");
        }
        for (layer, colour) in [(38, self.fore), (48, self.back)] {
            // writing to a string cannot fail
            let _ = match colour {
                None => continue,
                Some(CellColour::Rgb([r, g, b])) => write!(text, "\u{1b}[{layer};2;{r};{g};{b}m"),
                Some(CellColour::Indexed(index)) => write!(text, "\u{1b}[{layer};5;{index}m"),
            };
            *coloured = true;
        }
        text.push(self.sign);
        if self.bold {
            text.push_str("\u{1b}[22m");
        }
    }
}

/// Pixels of the sheet, and characters on and around it.
pub(super) struct Canvas {
    extent: Extent,
    columns: usize,
    rows: usize,
    pixels: Vec<Option<f64>>,
    /// The characters, with a margin of [`MARGIN`] columns and one row around the sheet.
    signs: Vec<Option<char>>,
}

impl Canvas {
    pub(super) fn new(extent: Extent, columns: usize, rows: usize) -> Self {
        Self {
            extent,
            columns,
            rows,
            pixels: Vec::new(),
            signs: vec![None; (columns + 2 * MARGIN) * (rows + 2)],
        }
    }

    pub(super) fn paint(&mut self, pixels: &[Option<f64>]) {
        self.pixels = pixels.to_vec();
    }

    /// Cell of a position, from the sheet's upper left corner.
    fn cell(&self, [x, y]: [f64; 2]) -> (usize, usize) {
        let across = (x - self.extent.low[0]) / self.extent.width() * self.columns as f64;
        let down = (self.extent.high[1] - y) / self.extent.height() * self.rows as f64;
        (
            (across.max(0.0) as usize).min(self.columns - 1),
            (down.max(0.0) as usize).min(self.rows - 1),
        )
    }

    fn put(&mut self, row: usize, column: usize, sign: char) {
        let at = row * (self.columns + 2 * MARGIN) + column;
        if let Some(cell) = self.signs.get_mut(at) {
            *cell = Some(sign);
        }
    }

    /// Writes a short text centred on a position of the sheet.
    pub(super) fn mark(&mut self, place: [f64; 2], text: &str) {
        let (column, row) = self.cell(place);
        let first = (column + MARGIN).saturating_sub(text.chars().count() / 2);
        for (offset, sign) in text.chars().enumerate() {
            self.put(row + 1, first + offset, sign);
        }
    }

    /// Draws strokes over the part of the rim where a load is.
    pub(super) fn hatch(&mut self, sheet: &Sheet, map: &Map) {
        let Some(rim) = Rim::loaded(sheet, map) else {
            return;
        };
        for row in 0..self.rows {
            for column in 0..self.columns {
                let along = |cell: usize, cells: usize| (cell as f64 + 0.5) / cells as f64;
                let centre = [
                    self.extent.low[0] + along(column, self.columns) * self.extent.width(),
                    self.extent.high[1] - along(row, self.rows) * self.extent.height(),
                ];
                if rim.contains(centre) {
                    self.put(row + 1, column + MARGIN, '/');
                }
            }
        }
    }

    /// Writes each electrode's number next to the nearest side of the sheet.
    pub(super) fn number(&mut self, sheet: &Sheet) {
        let mut taken = vec![false; self.signs.len()];
        for (index, &place) in sheet.electrodes.iter().enumerate() {
            let number = Electrode(index).number().to_string();
            let (column, row) = self.cell(place);
            let [x, y] = place;
            let [width, height] = [self.extent.width(), self.extent.height()];
            let to_side = [
                (x - self.extent.low[0]) / width,
                (self.extent.high[0] - x) / width,
                (self.extent.high[1] - y) / height,
                (y - self.extent.low[1]) / height,
            ];
            let side = (0..4).min_by(|a, b| to_side[*a].total_cmp(&to_side[*b]));
            let centred = (column + MARGIN).saturating_sub(number.len() / 2);
            let (row, column) = match side {
                Some(0) => (row + 1, MARGIN.saturating_sub(number.len() + 1)),
                Some(1) => (row + 1, MARGIN + self.columns + 1),
                Some(2) => (0, centred),
                _ => (self.rows + 1, centred),
            };
            let stride = self.columns + 2 * MARGIN;
            let first = (row * stride + column).saturating_sub(1);
            let last = (row * stride + column + number.len()).min(taken.len() - 1);
            // in a narrow picture, overlapping numbers are omitted
            if taken[first..=last].iter().any(|taken| *taken) {
                continue;
            }
            for (offset, digit) in number.chars().enumerate() {
                self.put(row, column + offset, digit);
                if let Some(taken) = taken.get_mut(row * stride + column + offset) {
                    *taken = true;
                }
            }
        }
    }

    /// Rows of cells: the sheet with its margin.
    pub(super) fn rows(&self, range: &Range, ink: Ink) -> Vec<Vec<TerminalCell>> {
        let stride = self.columns + 2 * MARGIN;
        let cell = |row: usize, column: usize| {
            let sign = self.signs[row * stride + column];
            let on_sheet =
                (1..=self.rows).contains(&row) && (MARGIN..MARGIN + self.columns).contains(&column);
            if !on_sheet {
                return TerminalCell::of(sign.unwrap_or(' '));
            }
            let upper = 2 * (row - 1) * self.columns + column - MARGIN;
            let pixels = [self.pixels[upper], self.pixels[upper + self.columns]];
            match sign {
                Some(sign) => ink.sign(sign, pixels, range),
                None => ink.cell(pixels, range),
            }
        };
        (0..self.rows + 2)
            .map(|row| (0..stride).map(|column| cell(row, column)).collect())
            .collect()
    }
}

/// The colours and signs of values with the terminal's colour support.
#[derive(Clone, Copy)]
pub(super) struct Ink(pub(super) TerminalColour);

impl Ink {
    fn cell(self, pixels: [Option<f64>; 2], range: &Range) -> TerminalCell {
        if self.0 == TerminalColour::Plain {
            return TerminalCell::of(plain_sign(mean(pixels), range));
        }
        let [upper, lower] = pixels.map(|value| self.colour(range.colour(value?)?));
        let (sign, fore, back) = match (upper, lower) {
            (None, None) => (' ', None, None),
            (None, lower) => ('\u{2584}', lower, None),
            (upper, lower) => ('\u{2580}', upper, lower),
        };
        TerminalCell {
            fore,
            back,
            ..TerminalCell::of(sign)
        }
    }

    fn sign(self, sign: char, pixels: [Option<f64>; 2], range: &Range) -> TerminalCell {
        let under = mean(pixels).and_then(|value| range.colour(value));
        let Some(under) = under.filter(|_| self.0 != TerminalColour::Plain) else {
            return TerminalCell::of(sign);
        };
        let ink = if luminance(under) > 0.2 {
            [0; 3]
        } else {
            [255; 3]
        };
        TerminalCell {
            sign,
            fore: self.colour(ink),
            back: self.colour(under),
            bold: true,
        }
    }

    fn colour(self, colour: Rgb) -> Option<CellColour> {
        match self.0 {
            TerminalColour::Plain => None,
            TerminalColour::TrueColour => Some(CellColour::Rgb(colour)),
            TerminalColour::Ansi256 => Some(CellColour::Indexed(nearest(colour))),
        }
    }
}

fn mean(pixels: [Option<f64>; 2]) -> Option<f64> {
    match pixels {
        [Some(upper), Some(lower)] => Some((upper + lower) / 2.0),
        [one, other] => one.or(other),
    }
}

fn plain_sign(value: Option<f64>, range: &Range) -> char {
    let Some(value) = value else { return ' ' };
    let share = range.share(value);
    let signs = if share <= 0.0 { LOSS_SIGNS } else { GAIN_SIGNS };
    let place = share.abs().min(1.0) * (signs.len() - 1) as f64;
    char::from(signs[place.round() as usize])
}

/// The index of the nearest colour in xterm's colour cube and grey ramp.
fn nearest(colour: Rgb) -> u8 {
    const LEVELS: [u8; 6] = [0, 95, 135, 175, 215, 255];
    let level = |channel: u8| {
        (0..6_u8)
            .min_by_key(|level| LEVELS[usize::from(*level)].abs_diff(channel))
            .unwrap_or(0)
    };
    let [r, g, b] = colour.map(level);
    let cube = [r, g, b].map(|level| LEVELS[usize::from(level)]);
    let grey_step = (0..24_u8)
        .min_by_key(|step| distance([8 + 10 * step; 3], colour))
        .unwrap_or(0);
    if distance([8 + 10 * grey_step; 3], colour) < distance(cube, colour) {
        232 + grey_step
    } else {
        16 + 36 * r + 6 * g + b
    }
}

fn distance(a: Rgb, b: Rgb) -> u32 {
    a.iter()
        .zip(b)
        .map(|(a, b)| u32::from(a.abs_diff(b)).pow(2))
        .sum()
}
