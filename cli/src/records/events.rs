//! `tactus events`: events of a session and its rig, from the record.

use std::io::Write;

use imaging::recorded::SessionParts;
use logbook::Event;
use serde::Serialize;
use survey::printable;

use crate::args::Global;
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::time::local;
use crate::session_files;

/// A line of `events --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct Line<'a> {
    session: &'a str,
    #[serde(flatten)]
    event: Event,
}

pub(crate) fn run(
    global: &Global,
    named: &str,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let session = SessionParts::open(&session_files::session_file(global, named)?)?;
    let events = session.events()?;
    if events.is_empty() && !printer.is_json() {
        return printer.text("this session has no events, only frames");
    }
    for event in events {
        let line = Line {
            session: &session.header().id,
            event,
        };
        printer.record(&line, |Line { event, .. }| {
            format!(
                "{}  {:17}  {}",
                local(event.at),
                printable(&event.kind),
                printable(&event.text)
            )
        })?;
    }
    Ok(())
}
