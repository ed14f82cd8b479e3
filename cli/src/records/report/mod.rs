//! `tactus report`: what happened in a session, as one HTML page that prints to A4.

mod charts;
mod health;
mod html;
mod moments;
mod page;
mod rows;
mod sections;

use std::io::Write;
use std::path::Path;

use imaging::recorded::{Recording, SessionParts};
use logbook::{Event, Verified};
use outfile::NewFolder;
use serde_json::json;

use crate::args::{Global, Report};
use crate::failure::Failure;
use crate::maps::reconstruction::Reconstruction;
use crate::output::Printer;
use crate::output::progress::progress;
use crate::session_files;
use health::Health;
use moments::Moments;
use rows::SessionRows;

/// All data of the page.
struct Facts<'a> {
    session: &'a SessionParts,
    verified: Verified,
    events: Vec<Event>,
    health: Health,
    /// The results of the maps, or why no maps can be made.
    maps: Result<MapFacts<'a>, String>,
}

impl Facts<'_> {
    /// The events by which a rule or the daemon raised an alarm.
    fn alarms(&self) -> impl Iterator<Item = &Event> {
        let raised = ["alarm", "alarm-active"];
        let events = self.events.iter();
        events.filter(move |event| raised.contains(&event.kind.as_str()))
    }

    /// Number of times that an alarm could not be judged.
    fn not_judged(&self) -> usize {
        let events = self.events.iter();
        events.filter(|event| event.kind == "alarm-invalid").count()
    }
}

/// The results of a session's maps.
struct MapFacts<'a> {
    reconstruction: &'a Reconstruction,
    rows: SessionRows,
    moments: Moments,
}

/// Writes the page and reports its path.
pub(crate) fn run(
    global: &Global,
    requested: &Report,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let mut folder = NewFolder::create(&requested.out)?;
    let path = session_files::session_file(global, &requested.session)?;
    let session = SessionParts::open(&path)?;
    let header = session.header();
    let bar = progress(Some(session.len()?), printer.is_terminal());
    let verified = logbook::verify(&path, |frames| bar.set_position(frames))?;
    bar.finish_and_clear();
    let prepared = match Reconstruction::of_session(&path, &requested.asked) {
        Ok(prepared) => Ok(prepared),
        // a page without maps is better than none; but a wrong option is an error of the command line and not of the
        // session
        Err(error @ (Failure::Usage(_) | Failure::Configuration(_)))
            if requested.asked.differ() =>
        {
            return Err(error);
        }
        Err(other) => Err(other.to_string()),
    };
    let maps = match &prepared {
        Ok((recording, reconstruction)) => Ok(map_facts(
            &path,
            recording,
            reconstruction,
            requested,
            printer,
        )?),
        Err(why) => Err(why.clone()),
    };
    let facts = Facts {
        session: &session,
        verified,
        events: session.events()?,
        health: Health::of(&session),
        maps,
    };
    let html = page::html(&facts)?;
    folder.put("index.html", html.as_bytes())?;
    let folder = folder.finish()?;
    let gaps = &facts.verified.gaps;
    let path = folder.join("index.html").display().to_string();
    let maps = facts.maps.as_ref();
    // the line of `report --json`; see `docs/reference/json.md`
    let written = json!({
        "path": path,
        "session": header.id,
        "simulated": header.simulated,
        "frames": facts.verified.frames,
        "events": facts.events.len(),
        "gaps": gaps.len(),
        "unexplained": gaps.iter().filter(|gap| gap.explained.is_none()).count(),
        "maps": maps.map_or(0, |maps| maps.moments.shown.len()),
    });
    printer.record(&written, |_| format!("report    {path}"))
}

fn map_facts<'a>(
    path: &Path,
    recording: &'a Recording,
    reconstruction: &'a Reconstruction,
    requested: &Report,
    printer: &Printer<impl Write>,
) -> Result<MapFacts<'a>, Failure> {
    let on_terminal = printer.is_terminal();
    let rows = SessionRows::of(path, recording, reconstruction, requested, on_terminal)?;
    let moments = moments::worst(&rows, recording, reconstruction, requested, on_terminal)?;
    Ok(MapFacts {
        reconstruction,
        rows,
        moments,
    })
}
