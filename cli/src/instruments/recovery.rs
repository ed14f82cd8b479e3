//! Commands for a rig that needs a person: open its relays, accept replaced instruments, reload the configuration,
//! print the transcript of messages.

use std::io::Write;

use dbus::TranscriptOptions;
use serde::Serialize;

use crate::args::Transcript;
use crate::connection::Daemon;
use crate::failure::Failure;
use crate::output::Printer;

/// The line of `instruments open-all`, `instruments accept` and `reload` with `--json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct DoneLine {
    event: &'static str,
    text: String,
}

fn done(
    event: &'static str,
    text: String,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    printer.record(&DoneLine { event, text }, |done| done.text.clone())
}

pub(crate) async fn open_all(
    daemon: &Daemon,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let text = daemon.ask("the relays", daemon.manager.open_all()).await?;
    done("opened", text, printer)
}

pub(crate) async fn accept(
    daemon: &Daemon,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let requested = daemon.manager.accept_instruments();
    let text = daemon.ask("the instruments", requested).await?;
    done("accepted", text, printer)
}

pub(crate) async fn reload(
    daemon: &Daemon,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let text = daemon
        .ask("the configuration", daemon.manager.reload())
        .await?;
    done("reloaded", text, printer)
}

/// Prints the transcript, which is lines of JSON with and without `--json`.
pub(crate) async fn transcript(
    daemon: &Daemon,
    requested: &Transcript,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let options = TranscriptOptions {
        frames: Some(u64::from(requested.frames)),
    };
    let lines = daemon
        .ask("the transcript", daemon.manager.transcript(&options))
        .await?;
    if lines.is_empty() {
        return Err(Failure::Missing(
            "there is no transcript: no message was exchanged with an instrument yet; a recording has no instruments".to_owned(),
        ));
    }
    match &requested.out {
        None => printer.raw(survey::printable_json(lines).as_bytes()),
        Some(path) => {
            outfile::write(path, requested.replacing.existing(), lines.as_bytes())?;
            let count = lines.lines().count();
            let text = format!(
                "{count} lines are in {}; `tactus-sim replay {0}` plays them to the simulators",
                path.display()
            );
            done("written", text, printer)
        }
    }
}
