//! The panels of the dashboard: each draws its part of the state into its area.

pub(super) mod charts;
pub(super) mod map;
pub(super) mod state;
pub(super) mod tables;

use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::Span;
use ratatui::widgets::{Block, Borders};
use render::TerminalColour;

/// Draws the title line of a panel and returns the area below it.
pub(super) fn titled(frame: &mut Frame<'_>, area: Rect, title: &str) -> Rect {
    let block = Block::new()
        .borders(Borders::TOP)
        .title(Span::styled(format!(" {title} "), Modifier::BOLD));
    let inner = block.inner(area);
    frame.render_widget(block, area);
    inner
}

/// The style of a conspicuous warning, on terminals without colours too.
pub(super) fn warning(colour: TerminalColour) -> Style {
    match colour {
        TerminalColour::Plain => Style::new().add_modifier(Modifier::BOLD | Modifier::REVERSED),
        _ => Style::new()
            .fg(Color::Indexed(231))
            .bg(Color::Indexed(124))
            .add_modifier(Modifier::BOLD),
    }
}
