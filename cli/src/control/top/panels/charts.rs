//! Strip charts of the last ten minutes.

use chrono::{DateTime, FixedOffset};
use imaging::quantities::{LoadUnit, rounded};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::widgets::Sparkline;

use crate::control::top::dashboard::Dashboard;
use crate::control::top::history::CHARTED;
use crate::control::top::panels::titled;

/// Height of the highest bar in steps: eight for each of at most 100 rows.
const STEPS: f64 = 8.0 * 100.0;

pub(crate) fn draw(
    frame: &mut Frame<'_>,
    area: Rect,
    shown: &Dashboard,
    now: DateTime<FixedOffset>,
) {
    let heights = CHARTED.map(|_| Constraint::Fill(1));
    let areas: [Rect; CHARTED.len()] = area.layout(&Layout::vertical(heights));
    let unit = shown.history.unit().unwrap_or(LoadUnit::Pressure);
    for (chart, (quantity, area)) in CHARTED.into_iter().zip(areas).enumerate() {
        let columns = usize::from(area.width);
        let values = shown
            .history
            .columns(chart, columns, now.timestamp_millis());
        let most = values.iter().flatten().copied().fold(0.0, f64::max);
        let span = ", last 10 min";
        let title = match values.iter().any(Option::is_some) {
            true => format!(
                "{} \u{2264} {} {}",
                quantity.words(),
                rounded(most),
                quantity.unit(unit)
            ),
            false => format!("{}: no value", quantity.words()),
        };
        let title = match title.chars().count() + span.len() + 2 <= columns {
            true => title + span,
            false => title,
        };
        let inner = titled(frame, area, &title);
        frame.render_widget(
            Sparkline::default()
                .data(bars(&values, most, inner.height))
                .max(STEPS as u64),
            inner,
        );
    }
}

/// Heights of bars. Zero has the lowest bar, to distinguish it from a span without a value.
fn bars(values: &[Option<f64>], most: f64, rows: u16) -> Vec<Option<u64>> {
    let least = STEPS / (8.0 * f64::from(rows.max(1)));
    let bar = |value: f64| {
        (STEPS * value / most.max(f64::MIN_POSITIVE))
            .max(least)
            .ceil() as u64
    };
    values.iter().map(|value| value.map(bar)).collect()
}
