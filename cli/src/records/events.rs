//! `tactus events`: events of a session and its rig, from the record.

use std::io::Write;

use imaging::recorded::SessionParts;
use serde::Serialize;
use survey::printable;

use crate::args::Global;
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::time::{local, utc};
use crate::session_files;

/// A line of `events --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct Event {
    session: String,
    at: String,
    kind: String,
    text: String,
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
        let line = Event {
            session: session.header().id.clone(),
            at: utc(event.at),
            kind: event.kind.clone(),
            text: event.text.clone(),
        };
        printer.record(&line, |line| {
            format!(
                "{}  {:17}  {}",
                local(event.at),
                printable(&line.kind),
                printable(&line.text)
            )
        })?;
    }
    Ok(())
}
