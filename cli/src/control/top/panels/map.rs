//! The map, as large as its area allows.

use chrono::{DateTime, FixedOffset};
use imaging::quantities::Quantity;
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Position, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::widgets::{Paragraph, Wrap};
use render::{CellColour, TerminalCell, TerminalMap};
use survey::printable;

use crate::control::top::dashboard::{Dashboard, Picture};
use crate::control::top::panels::{titled, warning};
use crate::maps::drawing::Field;
use crate::options::duration::display_long;

pub(crate) fn draw(
    frame: &mut Frame<'_>,
    area: Rect,
    shown: &Dashboard,
    now: DateTime<FixedOffset>,
) {
    let title = match &shown.picture {
        None => "Map".to_owned(),
        Some(picture) => {
            let age = 1e-3 * (now.timestamp_millis() - picture.frame.wall_ms).max(0) as f64;
            format!(
                "Map of frame {}, {} old",
                picture.frame.sequence,
                display_long(age)
            )
        }
    };
    let area = titled(frame, area, &title);
    let doubt = shown
        .picture
        .as_ref()
        .and_then(|picture| doubt(shown, picture));
    let below = u16::from(doubt.is_some());
    let [area, last] = area.layout(&Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(below),
    ]));
    let drawn = match (&shown.picture, &shown.field) {
        (Some(picture), Some(Ok(field))) => cells(shown, picture, field, area),
        (_, Some(Err(why))) => Err(why.clone()),
        _ => Err(without_map(shown)),
    };
    match drawn {
        Ok(map) => place(frame.buffer_mut(), area, &map),
        Err(why) => frame.render_widget(
            Paragraph::new(printable(&why).into_owned()).wrap(Wrap { trim: true }),
            area,
        ),
    }
    if let Some(doubt) = doubt {
        let doubt = format!(" {} ", printable(&doubt));
        frame.render_widget(Paragraph::new(doubt).style(warning(shown.colour)), last);
    }
}

/// Why there is no map.
fn without_map(shown: &Dashboard) -> String {
    let seen = &shown.seen;
    match (&seen.trouble, &seen.daemon, &seen.session) {
        (Some(trouble), ..) => format!("{trouble}; trying again"),
        (None, None, _) => "connecting to the daemon".to_owned(),
        (None, Some(_), None) => "no session is running; `tactus start` starts one".to_owned(),
        (None, Some(_), Some(session)) if session.kind == "baseline" => format!(
            "{} records a baseline: {} frames",
            session.id,
            session.frames.unwrap_or(0)
        ),
        (None, Some(_), Some(session)) => format!("waiting for the first map of {}", session.id),
    }
}

/// Why the map is not reliable, or that nothing in it is above its noise.
fn doubt(shown: &Dashboard, picture: &Picture) -> Option<String> {
    let tracked = picture.tracked.as_ref().filter(|tracked| !tracked.known);
    if let Some(reason) = tracked.and_then(|tracked| tracked.reason) {
        return Some(format!("not known: {}", reason.words()));
    }
    if let Some(quality) = picture
        .map
        .quality
        .as_ref()
        .filter(|quality| !quality.is_silent())
    {
        return Some(quality.to_string());
    }
    nothing_above(shown, picture).map(render::nothing_above)
}

/// The noise, if no loss of the map exceeds it.
fn nothing_above(shown: &Dashboard, picture: &Picture) -> Option<f64> {
    let noise = shown.seen.session.as_ref()?.map_noise?;
    let loss = picture.frame.largest_loss.unwrap_or(0.0);
    Some(noise).filter(|noise| loss <= *noise)
}

/// The map and its scale, which takes one row.
fn cells(
    shown: &Dashboard,
    picture: &Picture,
    field: &Field,
    area: Rect,
) -> Result<TerminalMap, String> {
    let style = render::Style {
        scale: shown.scale.of(picture.map.unit)?,
        simulated: picture.frame.simulated,
        nothing_above: nothing_above(shown, picture),
        ..render::Style::default()
    };
    let mut marks = Vec::new();
    if let Some(quantities) = &picture.quantities {
        let metres = |[x, y]: [f64; 2]| [1e-3 * x, 1e-3 * y];
        let centre = quantities.regions.first().and_then(|sheet| {
            let [x, y] = [Quantity::CentreX, Quantity::CentreY].map(|axis| sheet.values.get(axis));
            Some([x?, y?])
        });
        marks.extend(centre.map(|centre| (metres(centre), "+".to_owned())));
        let spots = quantities.spots.iter();
        marks.extend(spots.map(|spot| (metres(spot.centre_mm), spot.number.to_string())));
    }
    let size = [
        usize::from(area.width),
        usize::from(area.height).saturating_sub(1),
    ];
    render::terminal_map(
        &field.sheet,
        &picture.map,
        size,
        &marks,
        shown.colour,
        &style,
    )
    .map_err(|error| format!("the map cannot be drawn: {error}"))
}

/// Copies the map to the middle of the area, and its scale to the last row.
fn place(buffer: &mut Buffer, area: Rect, map: &TerminalMap) {
    let width = map.rows.first().map_or(0, Vec::len) as u16;
    let left = area.x + area.width.saturating_sub(width) / 2;
    for (row, cells) in (area.y..).zip(&map.rows) {
        put(buffer, [left, row], area, cells);
    }
    let row = area.bottom().saturating_sub(1);
    let scale = &map.scale;
    let around = scale.low.chars().count() + scale.high.chars().count() + scale.bar.len() + 2;
    let left = area.x + area.width.saturating_sub(around as u16) / 2;
    let low = format!("{} ", scale.low);
    let bar = left + low.chars().count() as u16;
    buffer.set_string(left, row, low, Style::new());
    put(buffer, [bar, row], area, &scale.bar);
    let high = bar + scale.bar.len() as u16;
    buffer.set_string(high, row, format!(" {}", scale.high), Style::new());
}

fn put(buffer: &mut Buffer, [left, row]: [u16; 2], area: Rect, cells: &[TerminalCell]) {
    for (column, cell) in (left..).zip(cells) {
        let position = Position::new(column, row);
        if let Some(place) = buffer
            .cell_mut(position)
            .filter(|_| area.contains(position))
        {
            place.set_char(cell.sign).set_style(style(cell));
        }
    }
}

fn style(cell: &TerminalCell) -> Style {
    let colour = |colour: CellColour| match colour {
        CellColour::Rgb([r, g, b]) => Color::Rgb(r, g, b),
        CellColour::Indexed(index) => Color::Indexed(index),
    };
    let mut style = Style::new();
    style.fg = cell.fore.map(colour);
    style.bg = cell.back.map(colour);
    match cell.bold {
        true => style.add_modifier(Modifier::BOLD),
        false => style,
    }
}
