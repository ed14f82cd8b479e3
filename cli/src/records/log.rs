//! `tactus log`: events of the daemon and of all its sessions, from their records.

use std::collections::BTreeSet;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::time::{Duration, SystemTime};

use chrono::{DateTime, Utc};
use dbus::next;
use logbook::SessionReader;
use serde::Serialize;
use survey::printable;

use crate::args::{Global, Log};
use crate::connection::{Daemon, LAST, fault};
use crate::failure::{Failure, chain};
use crate::output::time::local;
use crate::output::{Printer, complain};
use crate::session_files;

/// A line of `log --json`; see `docs/reference/json.md`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
struct LogLine {
    at: DateTime<Utc>,
    session: Option<String>,
    kind: String,
    text: String,
}

impl LogLine {
    fn print(&self, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
        printer.record(self, |line| {
            format!(
                "{}  {:17}  {}{}",
                local(line.at),
                printable(&line.kind),
                match &line.session {
                    Some(session) => format!("{}: ", printable(session)),
                    None => String::new(),
                },
                printable(&line.text)
            )
        })
    }

    fn is_requested(&self, log: &Log, since: Option<DateTime<Utc>>) -> bool {
        since.is_none_or(|since| self.at >= since)
            && log.kind.as_ref().is_none_or(|kind| *kind == self.kind)
            && log.session.as_ref().is_none_or(|asked| {
                self.session
                    .as_ref()
                    .is_some_and(|session| session.starts_with(asked))
            })
    }
}

/// Prints recorded events, the oldest first.
pub(crate) fn run(
    global: &Global,
    log: &Log,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let last = match log.session.as_deref() {
        Some(LAST) => {
            let file = session_files::session_file(global, LAST)?;
            Some(session_files::open(&file)?.header().id.clone())
        }
        _ => None,
    };
    let log = &with_session(log, last);
    let places = session_files::directories(global)?;
    let since = since(log, Utc::now());
    let mut lines = BTreeSet::new();
    for place in &places {
        lines.extend(recorded(place, log, since));
    }
    if lines.is_empty() && !printer.is_json() {
        return printer.text(&format!(
            "no such events in {}; --state DIR selects another directory",
            session_files::listed(&places)
        ));
    }
    lines.iter().try_for_each(|line| line.print(printer))
}

/// Prints recorded events and continues with new ones.
pub(crate) async fn follow(
    daemon: &Daemon,
    log: &Log,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let last = match log.session.as_deref() {
        Some(LAST) => daemon.session_id(LAST, |_| true).await?,
        _ => None,
    };
    let log = &with_session(log, last);
    // subscribed before the records are read, so that no event is missed
    let listening = daemon.manager.receive_happened();
    let mut happened = daemon
        .ask("the events", async { Ok(listening.await?) })
        .await?;
    let directory = daemon
        .ask("the record", daemon.manager.record_directory())
        .await?;
    let since = since(log, Utc::now());
    let lines: BTreeSet<LogLine> = recorded(Path::new(&directory), log, since).collect();
    for line in &lines {
        line.print(printer)?;
    }
    while let Some(signal) = next(&mut happened).await {
        let event = signal
            .args()
            .map_err(|error| fault("an event", &error.into()))?;
        let line = LogLine {
            at: DateTime::from_timestamp_nanos(event.wall_ns),
            session: event.details.session.clone(),
            kind: event.kind.to_string(),
            text: event.text.to_string(),
        };
        if line.is_requested(log, None) && !lines.contains(&line) {
            line.print(printer)?;
        }
    }
    Err(Failure::Missing(
        "the daemon ended; `tactus log` prints what it has recorded".to_owned(),
    ))
}

fn since(log: &Log, now: DateTime<Utc>) -> Option<DateTime<Utc>> {
    let span = chrono::TimeDelta::from_std(log.since?).ok()?;
    now.checked_sub_signed(span)
}

/// The options with this id in place of `last`.
fn with_session(log: &Log, last: Option<String>) -> Log {
    Log {
        session: last.or_else(|| log.session.clone()),
        ..log.clone()
    }
}

/// The events in a folder; unreadable sessions are reported on standard error.
fn recorded(
    place: &Path,
    log: &Log,
    since: Option<DateTime<Utc>>,
) -> impl Iterator<Item = LogLine> {
    let mut lines = Vec::new();
    let mut complained = false;
    if log.session.is_none() {
        match logbook::read_daemon_log(place) {
            Ok(events) => lines.extend(events.into_iter().map(|event| LogLine {
                at: event.at,
                session: None,
                kind: event.kind,
                text: event.text,
            })),
            Err(error) => {
                complained = true;
                complain(&format!("tactus: {}", chain(&error)));
            }
        }
    }
    let files = std::fs::read_dir(place);
    if let Err(error) = &files
        && error.kind() != ErrorKind::NotFound
        && !complained
    {
        let place = place.display();
        complain(&format!("tactus: {place} is left out: {}", chain(error)));
    }
    let files = files.into_iter().flatten().flatten();
    for file in files.map(|entry| entry.path()) {
        let id = file.file_stem().and_then(|id| id.to_str());
        let asked = log.session.as_ref();
        let named = asked.is_none_or(|asked| id.is_some_and(|id| id.starts_with(asked.as_str())));
        let is_session = file.extension().is_some_and(|end| end == "tactus");
        if !is_session || !named || last_written_before(&file, log.since) {
            continue;
        }
        match of_session(&file) {
            Ok(events) => lines.extend(events),
            Err(error) => complain(&format!("tactus: {}: {}", file.display(), chain(&error))),
        }
    }
    let log = log.clone();
    lines
        .into_iter()
        .filter(move |line| line.is_requested(&log, since))
}

/// Whether a file was last written before the time span began, so that it need not be opened. While a file is being
/// written, its journal is newer than the file.
fn last_written_before(file: &Path, span: Option<Duration>) -> bool {
    let Some(span) = span else { return false };
    let journal = file.with_extension("tactus-wal");
    let [file, journal] = [file, &journal].map(|path| path.metadata()?.modified());
    let newest = file.ok().max(journal.ok());
    newest
        .and_then(|newest| SystemTime::now().duration_since(newest).ok())
        .is_some_and(|age| age > span)
}

/// Start, events and end of one session.
fn of_session(file: &Path) -> Result<Vec<LogLine>, logbook::LogbookError> {
    let session = SessionReader::open(file)?;
    let header = session.header();
    let line = |at, kind: &str, text: String| LogLine {
        at,
        session: Some(header.id.clone()),
        kind: kind.to_owned(),
        text,
    };
    let simulated = if header.simulated { ", SIMULATED" } else { "" };
    let begins = format!("{}{simulated} {}", header.kind, header.note);
    let mut lines = vec![line(
        header.started,
        "session-started",
        begins.trim_end().to_owned(),
    )];
    for event in session.events()? {
        lines.push(line(event.at, &event.kind, event.text));
    }
    if let Some(closing) = session.closed() {
        lines.push(line(closing.at, "session-ended", closing.reason.clone()));
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use crate::records::log::*;
    use logbook::{DaemonLog, Event, SessionHeader, SessionWriter};
    use survey::Protocol;

    fn at(second: i64) -> DateTime<Utc> {
        DateTime::from_timestamp_nanos(second * 1_000_000_000)
    }

    /// One closed session, one running, and two events of the daemon.
    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let protocol = Protocol::sheffield(4).unwrap();
        let mut daemon_log = DaemonLog::open(folder.path()).unwrap();
        for (second, kind) in [(5, "started"), (40, "daily")] {
            let event = Event {
                at: at(second),
                kind: kind.into(),
                text: "of the daemon".into(),
            };
            daemon_log.append(&event).unwrap();
        }
        for (id, begin) in [("m1", 10), ("m2", 30)] {
            let mut header = SessionHeader::new(id, at(begin), protocol.clone());
            header.simulated = true;
            let mut writer = SessionWriter::create(folder.path(), &header).unwrap();
            writer.event(at(begin + 1), "suspended", "lost").unwrap();
            if id == "m1" {
                writer.close(at(20), "asked to stop").unwrap();
            }
        }
        folder
    }

    fn shown(folder: &tempfile::TempDir, log: &Log, since: Option<DateTime<Utc>>) -> Vec<String> {
        let lines: BTreeSet<LogLine> = recorded(folder.path(), log, since).collect();
        let each = lines.iter();
        each.map(|line| {
            let session = line.session.as_deref().unwrap_or("-");
            format!("{} {session} {}", line.at.timestamp(), line.kind)
        })
        .collect()
    }

    #[test]
    fn events_of_daemon_and_sessions_are_listed_in_order_of_time() {
        let folder = folder();
        let all = Log::default();
        assert_eq!(
            shown(&folder, &all, None),
            [
                "5 - started",
                "10 m1 session-started",
                "11 m1 suspended",
                "20 m1 session-ended",
                "30 m2 session-started",
                "31 m2 suspended",
                "40 - daily",
            ]
        );
        assert_eq!(
            shown(&folder, &all, Some(at(31))),
            ["31 m2 suspended", "40 - daily"]
        );
        let of_one = Log {
            session: Some("m1".into()),
            ..Log::default()
        };
        assert_eq!(shown(&folder, &of_one, None).len(), 3);
        let of_a_kind = Log {
            kind: Some("suspended".into()),
            ..Log::default()
        };
        assert_eq!(
            shown(&folder, &of_a_kind, None),
            ["11 m1 suspended", "31 m2 suspended"]
        );
    }

    #[test]
    fn a_file_that_is_no_session_takes_no_other_with_it() {
        let folder = folder();
        std::fs::write(folder.path().join("m3.tactus"), "no database").unwrap();
        assert_eq!(shown(&folder, &Log::default(), None).len(), 7);
    }

    #[test]
    fn a_line_is_a_line_of_json() {
        let line = LogLine {
            at: at(1),
            session: None,
            kind: "daily".into(),
            text: "a day".into(),
        };
        let mut printer = Printer::into(true, Vec::new());
        line.print(&mut printer).unwrap();
        assert_eq!(
            String::from_utf8(printer.sink()).unwrap(),
            "{\"at\":\"1970-01-01T00:00:01Z\",\"session\":null,\"kind\":\"daily\",\"text\":\"a day\"}\n"
        );
    }
}
