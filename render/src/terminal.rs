//! Draws a map in a terminal: two pixels per character cell.

use std::fmt::Write;

use survey::{Electrode, HotSpot, Map};

use crate::drawing::colour::luminance;
use crate::raster::raster;
use crate::{Extent, PictureError, Range, Rgb, Sheet, Style, hot_spots};

/// Colour support of the terminal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TerminalColour {
    /// 24 bits, half blocks.
    TrueColour,
    /// The 256 colours of xterm, half blocks.
    #[default]
    Ansi256,
    /// No colour and only ASCII characters: the larger the loss, the denser the character.
    Plain,
}

/// Layout of a map in a terminal.
#[derive(Debug, Clone, PartialEq)]
pub struct TerminalStyle {
    /// Maximum columns of the sheet with its numbers; at least 20. Below about 50, the text below is longer.
    pub width: usize,
    /// Maximum lines of the whole text, but at least 14 and the lines of found and true position; `None` for as many as
    /// the width needs.
    pub height: Option<usize>,
    /// Colour support of the terminal.
    pub colour: TerminalColour,
    /// Title, scale, marks.
    pub style: Style,
}

impl Default for TerminalStyle {
    fn default() -> Self {
        Self {
            width: 80,
            height: None,
            colour: TerminalColour::default(),
            style: Style::default(),
        }
    }
}

/// Columns between the edge of the text and the sheet, for electrode numbers.
const MARGIN: usize = 4;
/// Wider pictures are too high for a screen.
const WIDEST: usize = 72;
/// Minimum rows of the sheet, if the height allows, before hot spots are listed.
const FEWEST_ROWS: usize = 10;
/// Maximum number of hot spots listed.
const SPOTS: usize = 3;
/// Zero, followed by increasing loss.
const LOSS_SIGNS: &[u8] = b".:-=oO%@";
/// Zero, followed by increasing gain.
const GAIN_SIGNS: &[u8] = b".'\"^";

/// A map as lines of text, each ended by a newline: title, sheet surrounded by the electrodes' numbers, scale in per
/// cent, and positions (mm) of hot spots. Hot spots are marked 1, 2, 3; the true position `o`; the position found `x`.
///
/// # Errors
/// A map of another sheet, a sheet without area, an invalid scale, fewer than 20 columns.
pub fn terminal(sheet: &Sheet, map: &Map, style: &TerminalStyle) -> Result<String, PictureError> {
    if style.width < 20 {
        return Err(PictureError::Size {
            width: style.width,
            height: 0,
            limit: "a terminal picture needs 20 columns",
        });
    }
    let extent = sheet.extent()?;
    let available = style.width.min(WIDEST) - 2 * MARGIN;
    // A cell is about twice as high as wide: two square pixels.
    let mut columns = available;
    let mut rows = (columns as f64 * extent.height() / extent.width() / 2.0).round() as usize;
    let mut spots = match style.style.nothing_above {
        Some(_) => Vec::new(),
        None => hot_spots(sheet, map)?,
    };
    spots.truncate(SPOTS);
    let mut most = available;
    if let Some(height) = style.height {
        // caption, title, two rows of numbers, three lines of scale
        let around = 6 + usize::from(has_title(&style.style));
        let named = [
            style.style.found.is_some(),
            style.style.true_position.is_some(),
        ];
        let named = named.into_iter().filter(|named| *named).count();
        let lines = height.saturating_sub(around + named);
        let fewest = lines.min(FEWEST_ROWS);
        spots.truncate(lines - fewest);
        most = most.min(lines - spots.len());
    }
    if rows > most {
        rows = most;
        columns = ((2 * rows) as f64 * extent.width() / extent.height()).round() as usize;
    }
    let (columns, rows) = (columns.max(1), rows.max(1));
    let mut canvas = Canvas::new(extent, columns, rows);
    let range = Range::styled(map, &style.style)?;
    canvas.paint(&raster(sheet, map, columns, 2 * rows)?);
    canvas.number(sheet);
    for (index, spot) in spots.iter().enumerate() {
        canvas.mark(spot.centre, char::from(b'1' + index as u8));
    }
    if let Some(truth) = style.style.true_position {
        canvas.mark(truth.centre, 'o');
    }
    if let Some(found) = style.style.found {
        canvas.mark(found, 'x');
    }

    let mut text = String::new();
    let ink = Ink(style.colour);
    head(&mut text, map, &style.style, ink);
    canvas.write(&mut text, &range, ink);
    scale(&mut text, map, &range, columns, ink);
    places(&mut text, &spots, &style.style, &range);
    if style.colour == TerminalColour::Plain {
        text = text.replace('\u{2212}', "-");
    }
    Ok(text)
}

fn has_title(style: &Style) -> bool {
    !style.title.is_empty() || style.simulated
}

fn head(text: &mut String, map: &Map, style: &Style, ink: Ink) {
    if has_title(style) {
        let simulated = match (style.simulated, ink.0) {
            (false, _) => String::new(),
            (true, TerminalColour::Plain) => "  [SIMULATED]".into(),
            (true, _) => "  \u{1b}[1;97;48;5;130m SIMULATED \u{1b}[0m".into(),
        };
        line(text, &format!("{}{simulated}", style.title));
    }
    line(text, &crate::chart::caption(map, style));
}

fn scale(text: &mut String, map: &Map, range: &Range, columns: usize, ink: Ink) {
    let [(least, under), (most, over)] = range.ends();
    let width = columns.clamp(12, 48);
    let mut bar = " ".repeat(MARGIN);
    for cell in 0..width {
        let part = (cell as f64 + 0.5) / width as f64;
        let value = least + part * (most - least);
        let pixel = Some(value);
        bar += &ink.cell([pixel, pixel], range);
    }
    bar += ink.rest();
    line(text, &bar);
    let sign = |beyond: bool, sign: &'static str| if beyond { sign } else { "" };
    let (low, high) = (
        format!("{}{}", sign(under, "<= "), range.words(least)),
        format!("{}{}", sign(over, ">= "), range.words(most)),
    );
    let gap = width
        .saturating_sub(low.chars().count() + high.chars().count())
        .max(2);
    line(
        text,
        &format!("{}{low}{}{high}", " ".repeat(MARGIN), " ".repeat(gap)),
    );
    line(
        text,
        &format!("{}{}", " ".repeat(MARGIN), map.unit.caption()),
    );
}

fn places(text: &mut String, spots: &[HotSpot], style: &Style, range: &Range) {
    let at = |[x, y]: [f64; 2]| format!("x {:.1} y {:.1} mm", 1e3 * x, 1e3 * y);
    for (index, spot) in spots.iter().enumerate() {
        let loss = range.words(range.unit.load(spot.peak));
        let area = spot.area * 1e4;
        line(
            text,
            &format!(
                "{} hot spot  {}, {loss}, {area:.1} cm2",
                index + 1,
                at(spot.centre)
            ),
        );
    }
    if let Some(found) = style.found {
        line(text, &format!("x found     {}", at(found)));
    }
    if let Some(truth) = style.true_position {
        let off = style.found.map(|found| {
            let [dx, dy] = [found[0] - truth.centre[0], found[1] - truth.centre[1]];
            format!(", {:.1} mm from found", 1e3 * dx.hypot(dy))
        });
        line(
            text,
            &format!(
                "o true      {}{}",
                at(truth.centre),
                off.unwrap_or_default()
            ),
        );
    }
}

fn line(text: &mut String, words: &str) {
    text.push_str(words.trim_end_matches(' '));
    text.push('\n');
}

/// Pixels of the sheet, and characters on and around it.
struct Canvas {
    extent: Extent,
    columns: usize,
    rows: usize,
    pixels: Vec<Option<f64>>,
    /// A margin of [`MARGIN`] columns and one row around the sheet.
    signs: Vec<Option<char>>,
}

impl Canvas {
    fn new(extent: Extent, columns: usize, rows: usize) -> Self {
        Self {
            extent,
            columns,
            rows,
            pixels: Vec::new(),
            signs: vec![None; (columns + 2 * MARGIN) * (rows + 2)],
        }
    }

    fn paint(&mut self, pixels: &[Option<f64>]) {
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

    fn mark(&mut self, place: [f64; 2], sign: char) {
        let (column, row) = self.cell(place);
        self.put(row + 1, column + MARGIN, sign);
    }

    /// Each electrode's number next to the nearest side of the sheet.
    fn number(&mut self, sheet: &Sheet) {
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
            // In a narrow picture, overlapping numbers are omitted.
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

    fn write(&self, text: &mut String, range: &Range, ink: Ink) {
        let stride = self.columns + 2 * MARGIN;
        for row in 0..self.rows + 2 {
            let mut cells = String::new();
            for column in 0..stride {
                let sign = self.signs[row * stride + column];
                let on_sheet = (1..=self.rows).contains(&row)
                    && (MARGIN..MARGIN + self.columns).contains(&column);
                if !on_sheet {
                    cells.push(sign.unwrap_or(' '));
                    continue;
                }
                let upper = 2 * (row - 1) * self.columns + column - MARGIN;
                let pixels = [self.pixels[upper], self.pixels[upper + self.columns]];
                cells += &match sign {
                    Some(sign) => ink.sign(sign, pixels, range),
                    None => ink.cell(pixels, range),
                };
                if column + 1 == MARGIN + self.columns {
                    cells += ink.rest();
                }
            }
            line(text, &cells);
        }
    }
}

/// Escape sequences for the terminal's colour support.
#[derive(Clone, Copy)]
struct Ink(TerminalColour);

impl Ink {
    fn cell(self, [upper, lower]: [Option<f64>; 2], range: &Range) -> String {
        if self.0 == TerminalColour::Plain {
            return plain_sign(mean([upper, lower]), range).to_string();
        }
        let colour = |value: Option<f64>| value.and_then(|value| range.colour(value));
        match (colour(upper), colour(lower)) {
            (None, None) => "\u{1b}[0m ".into(),
            (Some(upper), None) => format!("\u{1b}[0m{}\u{2580}", self.fore(upper)),
            (None, Some(lower)) => format!("\u{1b}[0m{}\u{2584}", self.fore(lower)),
            (Some(upper), Some(lower)) => {
                format!("{}{}\u{2580}", self.fore(upper), self.back(lower))
            }
        }
    }

    fn sign(self, sign: char, pixels: [Option<f64>; 2], range: &Range) -> String {
        if self.0 == TerminalColour::Plain {
            return sign.to_string();
        }
        match mean(pixels).and_then(|value| range.colour(value)) {
            None => format!("\u{1b}[0m{sign}"),
            Some(under) => {
                let ink = if luminance(under) > 0.2 {
                    [0; 3]
                } else {
                    [255; 3]
                };
                format!(
                    "\u{1b}[1m{}{}{sign}\u{1b}[22m",
                    self.fore(ink),
                    self.back(under)
                )
            }
        }
    }

    /// Resets to the terminal's own colours.
    fn rest(self) -> &'static str {
        match self.0 {
            TerminalColour::Plain => "",
            TerminalColour::TrueColour | TerminalColour::Ansi256 => "\u{1b}[0m",
        }
    }

    fn fore(self, colour: Rgb) -> String {
        self.paint(38, colour)
    }

    fn back(self, colour: Rgb) -> String {
        self.paint(48, colour)
    }

    fn paint(self, layer: u8, [r, g, b]: Rgb) -> String {
        let mut code = String::new();
        // Writing to a string cannot fail.
        let _ = match self.0 {
            TerminalColour::Plain => Ok(()),
            TerminalColour::TrueColour => write!(code, "\u{1b}[{layer};2;{r};{g};{b}m"),
            TerminalColour::Ansi256 => write!(code, "\u{1b}[{layer};5;{}m", nearest([r, g, b])),
        };
        code
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

/// The nearest of xterm's colour cube and grey ramp.
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
