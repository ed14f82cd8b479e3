//! State and health of the daemon, and its last events.

use chrono::{DateTime, FixedOffset};
use dbus::json::Alarm;
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Margin, Rect};
use ratatui::style::Modifier;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Wrap};
use survey::printable;
use web::DaemonState;

use crate::control::health::remark_on_baseline;
use crate::control::top::dashboard::Dashboard;
use crate::control::top::panels::{titled, warning};
use crate::options::duration::display_long;

pub(crate) fn health(frame: &mut Frame<'_>, area: Rect, shown: &Dashboard) {
    let area = titled(frame, area, "Health");
    let warned = |text: &str| {
        Line::from(Span::styled(
            printable(text).into_owned(),
            warning(shown.colour),
        ))
    };
    let mut lines = Vec::new();
    if let Some(trouble) = &shown.seen.trouble {
        lines.push(warned(trouble));
    }
    if let Some(daemon) = &shown.seen.daemon {
        match (daemon.well, daemon.troubles.as_slice()) {
            (Some(true), _) => lines.push("well".into()),
            (Some(false), []) => lines.push(warned("NOT WELL")),
            (None, []) => lines.push("health not known".into()),
            (_, troubles) => {
                let each = troubles.iter();
                lines.extend(each.map(|trouble| warned(&format!("NOT WELL: {trouble}"))));
            }
        }
        lines.extend(
            daemon
                .lost
                .iter()
                .map(|lost| warned(&format!("reconnecting: {lost}"))),
        );
        // before the lines that a small terminal has no room for
        let remark = remark_on_baseline(&daemon.baseline_remarks);
        lines.extend(remark.map(|text| warned(&format!("baseline, warning: {text}"))));
        if let Some(session) = &shown.seen.session {
            let count = |count: Option<u64>| count.unwrap_or(0);
            lines.push(plain(&format!(
                "frames   {} ({}), {} failed, {} missed",
                count(session.frames),
                session.state,
                count(session.failed),
                count(session.dropped)
            )));
            let error = session.last_error.as_ref();
            lines.extend(error.map(|error| plain(&format!("error    {error}"))));
        } else {
            lines.push("session  none; `tactus start` starts one".into());
        }
        lines.extend(of_daemon(daemon));
    }
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }), area);
}

fn of_daemon(daemon: &DaemonState) -> Vec<Line<'static>> {
    let age = daemon
        .baseline_age_s
        .map(|age| format!(", {} old", display_long(age)));
    let baseline = match daemon.baseline.as_str() {
        "" => "baseline none; `tactus baseline record`".to_owned(),
        id => format!("baseline {id}{}", age.unwrap_or_default()),
    };
    let source = format!("source   {}, {}", daemon.source, daemon.source_state);
    let mut lines = vec![plain(&baseline), plain(&source)];
    lines.push(plain(&format!("method   {}", daemon.method)));
    if let Some(days) = daemon.disk_days {
        lines.push(plain(&format!("disk     {days:.0} days left")));
    }
    if let Some(error) = &daemon.last_error {
        lines.push(plain(&format!("error    {error}")));
    }
    lines.push(plain(&format!("daemon   tactusd {}", daemon.version)));
    lines
}

fn plain(text: &str) -> Line<'static> {
    Line::from(printable(text).into_owned())
}

pub(crate) fn events(
    frame: &mut Frame<'_>,
    area: Rect,
    shown: &Dashboard,
    now: DateTime<FixedOffset>,
) {
    let area = titled(frame, area, "Alarms; events, the newest first");
    let matter = shown.seen.alarms.iter().filter(|alarm| alarm.matters());
    let mut lines: Vec<Line<'_>> = matter.map(|alarm| of_alarm(alarm, shown)).collect();
    let events = shown.seen.events.iter().take(usize::from(area.height));
    lines.extend(events.map(|event| {
        let at = DateTime::from_timestamp_millis(event.wall_ms).unwrap_or_default();
        let at = at.with_timezone(now.offset()).format("%H:%M:%S");
        plain(&format!("{at} {}: {}", event.kind, event.text))
    }));
    if lines.is_empty() {
        lines.push("none since this program started".into());
    }
    frame.render_widget(Paragraph::new(lines).wrap(Wrap { trim: false }), area);
}

/// An alarm on one line; an alarm that notifies is highlighted.
fn of_alarm(alarm: &Alarm, shown: &Dashboard) -> Line<'static> {
    let why = match (alarm.active, &alarm.invalid) {
        (false, Some(why)) => why.clone(),
        _ => alarm.cause.clone().unwrap_or_default(),
    };
    let mut text = format!("{}: {}", alarm.name, alarm.words());
    if !why.is_empty() {
        text.push_str(&format!(": {why}"));
    }
    if let Some(guidance) = alarm.guidance.as_ref().filter(|_| alarm.active) {
        text.push_str(&format!("; {guidance}"));
    }
    match alarm.notifies() {
        true => Line::from(Span::styled(
            printable(&text).into_owned(),
            warning(shown.colour),
        )),
        false => plain(&text),
    }
}

/// Draws all alarms over the other panels.
pub(crate) fn alarms(frame: &mut Frame<'_>, area: Rect, shown: &Dashboard) {
    let alarms = &shown.seen.alarms;
    let chosen = shown.chosen.min(alarms.len().saturating_sub(1));
    let mut lines: Vec<Line<'static>> = Vec::new();
    // starts four alarms before the selected one, so that it is visible
    for (index, alarm) in alarms.iter().enumerate().skip(chosen.saturating_sub(4)) {
        let mark = if index == chosen { "> " } else { "  " };
        let mut line = of_alarm(alarm, shown);
        line.spans.insert(0, mark.into());
        lines.push(line);
    }
    if lines.is_empty() {
        lines.push("this daemon has no alarms".into());
    }
    let last = match (&shown.asking, &shown.answer) {
        (Some(name), _) => Line::from(Span::styled(
            printable(&format!("acknowledge {name}? y: yes; any other key: no")).into_owned(),
            warning(shown.colour),
        )),
        (None, Some(answer)) => plain(answer),
        (None, None) => {
            "Up Down choose, Enter acknowledges; `tactus alarms shelve|reset NAME`".into()
        }
    };
    let area = area.inner(Margin::new(2, 1));
    let block = Block::bordered().title(Span::styled(" Alarms ", Modifier::BOLD));
    let inner = block.inner(area);
    let [list, below] = inner.layout(&Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(1 + u16::from(last.width() > usize::from(inner.width))),
    ]));
    frame.render_widget(Clear, area);
    frame.render_widget(block, area);
    let wrapped = |lines: Vec<Line<'static>>| Paragraph::new(lines).wrap(Wrap { trim: false });
    frame.render_widget(wrapped(lines), list);
    frame.render_widget(wrapped(vec![last]), below);
}
