//! `tactus sessions`: lists the state directory, with or without a daemon.

use std::io::Write;
use std::path::PathBuf;

use logbook::{SessionKind, SessionSummary};
use serde_json::{Value, json};

use crate::args::{Global, Sessions};
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::table::columns;
use crate::output::time::{local, utc};
use crate::session_files;

/// A line of `sessions --json`; see `docs/reference/json.md`.
fn json_line(summary: &SessionSummary) -> Value {
    let closed = summary.closed.as_ref();
    json!({
        "id": summary.id,
        "kind": summary.kind.as_str(),
        "started": utc(summary.started),
        "last_frame": summary.last.map(utc),
        "frames": summary.frames,
        "simulated": summary.simulated,
        "closed": closed.is_some(),
        "closed_at": closed.map(|closing| utc(closing.at)),
        "reason": closed.map(|closing| &closing.reason),
        "electrodes": summary.electrodes,
        "readings": summary.readings,
        "note": summary.note,
        "path": summary.path.display().to_string(),
    })
}

/// Lists every recorded session, or those of the archive.
pub(crate) fn run(
    global: &Global,
    requested: &Sessions,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    #[cfg(feature = "archive")]
    if requested.archive {
        return crate::archived::list(global, requested, printer);
    }
    let within = |session: &SessionSummary| {
        let ended = session.closed.as_ref().map(|closing| closing.at);
        let begun_in_time = requested.to.is_none_or(|to| session.started < to);
        let ended_in_time = |from| ended.is_none_or(|ended| from <= ended);
        begun_in_time && requested.from.is_none_or(ended_in_time)
    };
    let (places, sessions) = list(global, within)?;
    if printer.is_json() {
        return sessions
            .iter()
            .try_for_each(|summary| printer.record(&json_line(summary), |_| String::new()));
    }
    show(&places, &sessions, &[], printer)
}

/// `baseline list`: lists the recorded baselines, and marks the one in use.
pub(crate) fn baselines(global: &Global, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    let (places, sessions) = list(global, |session| session.kind == SessionKind::Baseline)?;
    let used = session_files::baseline_in_use(global)?;
    if printer.is_json() {
        return sessions.iter().try_for_each(|summary| {
            let mut line = json_line(summary);
            // whether sessions are measured against it; unknown if no daemon replies
            line["in_use"] = json!(used.as_ref().map(|used| *used == summary.id));
            printer.record(&line, |_| String::new())
        });
    }
    show(&places, &sessions, used.as_slice(), printer)
}

fn list(
    global: &Global,
    wanted: impl Fn(&SessionSummary) -> bool,
) -> Result<(Vec<PathBuf>, Vec<SessionSummary>), Failure> {
    let places = session_files::directories(global)?;
    let mut sessions = Vec::new();
    for place in &places {
        let Some(listing) = session_files::listing(&places, place, session_files::report)? else {
            continue;
        };
        session_files::report_unreadable(&listing);
        sessions.extend(listing.sessions.into_iter().filter(&wanted));
    }
    sessions.sort_by(|a: &SessionSummary, b| (a.started, &a.id).cmp(&(b.started, &b.id)));
    Ok((places, sessions))
}

/// A table of sessions, those in use marked.
fn show(
    places: &[PathBuf],
    sessions: &[SessionSummary],
    in_use: &[String],
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    if sessions.is_empty() {
        return printer.text(&format!(
            "no session in {}; --state DIR names another directory, `tactus start` records one",
            session_files::listed(places)
        ));
    }
    let rows: Vec<[String; 6]> = sessions
        .iter()
        .map(|summary| {
            [
                if in_use.contains(&summary.id) {
                    format!("{}  <- in use", summary.id)
                } else {
                    summary.id.clone()
                },
                if summary.simulated {
                    format!("{} (SIMULATED)", summary.kind)
                } else {
                    summary.kind.to_string()
                },
                local(summary.started),
                summary.frames.to_string(),
                match &summary.closed {
                    Some(closing) => format!("{}, {}", local(closing.at), closing.reason),
                    None => "open, or its daemon was killed".to_owned(),
                },
                summary.note.clone(),
            ]
        })
        .collect();
    printer.text(&columns(
        ["id", "kind", "started", "frames", "ended", "note"],
        &rows,
    ))
}
