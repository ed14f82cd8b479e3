//! Finds the frame of an instant of a session.

use std::time::Duration;

use chrono::{DateTime, TimeDelta, Utc};
use imaging::recorded::SessionParts;
use logbook::Event;
use survey::printable;

use crate::failure::Failure;
use crate::options::instant::{ANY_KIND, Instant};
use crate::options::moment::Moment;
use crate::output::time::local;

/// Largest distance of a time from the frames: times are often written to the minute.
const BESIDE: Duration = Duration::from_secs(60);

/// The number of the last frame that had begun at this instant, or of the first frame if none had.
///
/// # Errors
/// No such event; a time outside of the session; a session without frames.
pub(super) fn frame_at(session: &SessionParts, instant: &Instant) -> Result<u64, Failure> {
    let first = super::first_frame(session)?.frame;
    let (at, within) = match instant {
        Instant::Place(Moment::Frame(sequence)) => return Ok(*sequence),
        Instant::Place(Moment::At(at)) => (*at, true),
        Instant::Place(Moment::Since(since)) => {
            let since = TimeDelta::from_std(*since).ok();
            let at = since.and_then(|since| first.wall.checked_add_signed(since));
            (at.unwrap_or(DateTime::<Utc>::MAX_UTC), true)
        }
        Instant::Event { kind, number } => (event(session, kind, *number)?.at, false),
    };
    let (mut newest, mut last) = (None, first.wall);
    for record in session.frames().filter_map(Result::ok) {
        last = last.max(record.frame.wall);
        if record.frame.wall <= at {
            newest = Some(record.frame.sequence);
        }
    }
    if within && (at < first.wall - BESIDE || at > last + BESIDE) {
        return Err(Failure::Usage(format!(
            "--at {}: session {} has frames from {} to {}; name a time between these",
            local(at),
            session.header().id,
            local(first.wall),
            local(last),
        )));
    }
    Ok(newest.unwrap_or(first.sequence))
}

fn event(session: &SessionParts, kind: &str, number: usize) -> Result<Event, Failure> {
    let all = session.events()?;
    let of_kind = |event: &&Event| kind == ANY_KIND || event.kind == kind;
    let count = all.iter().filter(of_kind).count();
    if let Some(found) = all.iter().filter(of_kind).nth(number - 1) {
        return Ok(found.clone());
    }
    let mut kinds: Vec<&str> = Vec::new();
    for event in &all {
        if !kinds.contains(&event.kind.as_str()) {
            kinds.push(&event.kind);
        }
    }
    let has = match kinds.is_empty() {
        true => "it has no events".to_owned(),
        false => format!(
            "it has events of the kinds {}",
            printable(&kinds.join(", "))
        ),
    };
    Err(Failure::Usage(format!(
        "--at {kind}:{number}: session {} has {count} such events; {has}, as `tactus events {}` lists them",
        session.header().id,
        session.header().id,
    )))
}
