//! Draws a map in a terminal: two pixels per character cell.

mod cells;

use survey::{HotSpot, Map, printable};

use cells::{Canvas, Ink, MARGIN, fitting, scale_cells, written};
pub use cells::{CellColour, TerminalCell, TerminalMap, TerminalScale, terminal_map};

use crate::raster::raster;
use crate::{PictureError, Range, Sheet, Style, hot_spots};

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

/// Most columns of the sheet: a wider picture would be too high for a screen.
const WIDEST: usize = 72;
/// Minimum rows of the sheet before hot spots are listed, if the height allows.
const FEWEST_ROWS: usize = 10;
/// Maximum number of hot spots listed.
const SPOTS: usize = 3;

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
    let mut spots = match style.style.nothing_above {
        Some(_) => Vec::new(),
        None => hot_spots(sheet, map)?,
    };
    spots.truncate(SPOTS);
    let mut most = available;
    if let Some(height) = style.height {
        // caption, title, two rows of electrode numbers, three lines of scale
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
    let (columns, rows) = fitting(extent, available, most);
    let mut canvas = Canvas::new(extent, columns, rows);
    let range = Range::styled(map, &style.style)?;
    canvas.paint(&raster(sheet, map, columns, 2 * rows)?);
    canvas.number(sheet);
    canvas.hatch(sheet, map);
    for (index, spot) in spots.iter().enumerate() {
        canvas.mark(spot.centre, &(index + 1).to_string());
    }
    if let Some(truth) = style.style.true_position {
        canvas.mark(truth.centre, "o");
    }
    if let Some(found) = style.style.found {
        canvas.mark(found, "x");
    }

    let mut text = String::new();
    let ink = Ink(style.colour);
    head(&mut text, map, &style.style, ink);
    for row in canvas.rows(&range, ink) {
        line(&mut text, &written(&row));
    }
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
        // a title may name a frame of a file, and a caption a method from one
        line(text, &format!("{}{simulated}", printable(&style.title)));
    }
    line(text, &printable(&crate::chart::caption(map, style)));
}

fn scale(text: &mut String, map: &Map, range: &Range, columns: usize, ink: Ink) {
    let scale = scale_cells(map, range, columns.clamp(12, 48), ink);
    let margin = " ".repeat(MARGIN);
    line(text, &format!("{margin}{}", written(&scale.bar)));
    let gap = scale
        .bar
        .len()
        .saturating_sub(scale.low.chars().count() + scale.high.chars().count())
        .max(2);
    let gap = " ".repeat(gap);
    line(text, &format!("{margin}{}{gap}{}", scale.low, scale.high));
    line(text, &format!("{margin}{}", scale.unit));
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
