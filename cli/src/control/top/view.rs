//! Draws the dashboard: a header, panels in two columns, a footer.

use chrono::{DateTime, FixedOffset};
use ratatui::Frame;
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Wrap};
use survey::printable;

use crate::control::top::dashboard::Dashboard;
use crate::control::top::history::CHARTED;
use crate::control::top::panels::{self, warning};

/// Minimum columns and rows of a screen.
const LEAST: [u16; 2] = [80, 24];
/// Number of rows from which on the panels are higher.
const TALL: u16 = 32;

/// A part of the screen with a title.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Panel {
    Map,
    HotSpots,
    Events,
    Charts,
    Quantities,
    Health,
}

/// The panels of each column, from the top.
const COLUMNS: [&[Panel]; 2] = [
    &[Panel::Map, Panel::HotSpots, Panel::Events],
    &[Panel::Charts, Panel::Quantities, Panel::Health],
];

const KEYS: [(&str, &str); 8] = [
    ("?", "show or hide this list"),
    ("a", "show or hide all alarms"),
    ("Up Down Enter", "in that list: choose one, acknowledge it"),
    ("Up Down", "scroll the table of quantities"),
    ("Left Right", "scroll its regions"),
    ("Ctrl-L", "draw the whole screen again"),
    ("q Esc Ctrl-C", "leave"),
    ("on the map", "1, 2, ... hot spots, + centre of pressure"),
];

impl Panel {
    /// The height of a panel; in each column one panel takes the remaining rows.
    fn height(self, tall: bool) -> Constraint {
        let rows = |low, high| Constraint::Length(if tall { high } else { low });
        match self {
            Self::Map | Self::Quantities => Constraint::Fill(1),
            Self::Charts => {
                let charts = CHARTED.len() as u16;
                rows(3 * charts, 4 * charts)
            }
            Self::HotSpots => rows(3, 6),
            Self::Events => rows(4, 9),
            Self::Health => rows(6, 8),
        }
    }

    fn draw(
        self,
        frame: &mut Frame<'_>,
        area: Rect,
        shown: &Dashboard,
        now: DateTime<FixedOffset>,
    ) {
        match self {
            Self::Map => panels::map::draw(frame, area, shown, now),
            Self::HotSpots => panels::tables::hot_spots(frame, area, shown),
            Self::Events => panels::state::events(frame, area, shown, now),
            Self::Charts => panels::charts::draw(frame, area, shown, now),
            Self::Quantities => panels::tables::quantities(frame, area, shown),
            Self::Health => panels::state::health(frame, area, shown),
        }
    }
}

/// Draws the dashboard at the time `now`, whose offset from UTC is used for all displayed times.
pub(crate) fn draw(frame: &mut Frame<'_>, shown: &Dashboard, now: DateTime<FixedOffset>) {
    let area = frame.area();
    let [least_columns, least_rows] = LEAST;
    if area.width < least_columns || area.height < least_rows {
        let text = format!(
            "tactus top needs {least_columns}x{least_rows} characters, this terminal has {}x{}; q leaves",
            area.width, area.height
        );
        frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
        return;
    }
    let [head, body, foot] = area.layout(&Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(1),
    ]));
    header(frame, head, shown, now);
    let left = 38 + (area.width - least_columns) / 2;
    let columns: [Rect; 2] = body
        .layout(&Layout::horizontal([Constraint::Length(left), Constraint::Fill(1)]).spacing(1));
    for (column, panels) in columns.into_iter().zip(COLUMNS) {
        let heights = panels.iter().map(|panel| panel.height(area.height >= TALL));
        let areas = Layout::vertical(heights).split(column);
        for (panel, area) in panels.iter().zip(areas.iter()) {
            panel.draw(frame, *area, shown, now);
        }
    }
    footer(frame, foot);
    if shown.alarms {
        panels::state::alarms(frame, body, shown);
    }
    if shown.help {
        help(frame, body);
    }
}

fn header(frame: &mut Frame<'_>, area: Rect, shown: &Dashboard, now: DateTime<FixedOffset>) {
    let mut words = vec![Span::styled("tactus top", Modifier::BOLD)];
    if shown.simulated() {
        words.push("  ".into());
        words.push(Span::styled(" SIMULATED ", warning(shown.colour)));
    }
    if let Some(alarm) = shown.seen.alarms.iter().find(|alarm| alarm.notifies()) {
        words.push("  ".into());
        let text = format!(" ALARM {} ", printable(&alarm.name));
        words.push(Span::styled(text, warning(shown.colour)));
    }
    match &shown.seen.daemon {
        None => {
            words.push("  ".into());
            words.push(Span::styled(" NO DAEMON ", warning(shown.colour)));
        }
        Some(daemon) => words.push(format!("  {}", printable(&daemon.state)).into()),
    }
    if let Some(session) = &shown.seen.session {
        words.push(format!("  {}", printable(&session.id)).into());
    }
    frame.render_widget(Line::from(words), area);
    let time = now.format(" %m-%d %H:%M:%S %:z").to_string();
    frame.render_widget(Paragraph::new(time).alignment(Alignment::Right), area);
}

fn footer(frame: &mut Frame<'_>, area: Rect) {
    frame.render_widget("A research instrument, not a medical device.", area);
    let keys = Paragraph::new("? keys  a alarms  q leave").alignment(Alignment::Right);
    frame.render_widget(keys, area);
}

fn help(frame: &mut Frame<'_>, area: Rect) {
    let [width, height] = [62, KEYS.len() as u16 + 2];
    let area = area.centered(Constraint::Length(width), Constraint::Length(height));
    let lines = KEYS.map(|(keys, what)| Line::from(format!(" {keys:<14}{what}")));
    frame.render_widget(Clear, area);
    let block = Block::bordered().title(Span::styled(" Keys ", Modifier::BOLD));
    frame.render_widget(Paragraph::new(Vec::from(lines)).block(block), area);
}
