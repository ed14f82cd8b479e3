//! Output of the commands: a line of text or of JSON for each item.

use std::io::Write;
use std::path::PathBuf;

use serde::Serialize;

use super::failure::Failure;
use crate::catalogue::{ArchivedPart, Migration};
use crate::retrieval::Holding;
use crate::upload::{Status, Step};

/// Prints lines on standard output.
#[derive(Debug)]
pub(super) struct Printer {
    json: bool,
}

impl Printer {
    pub(super) fn new(json: bool) -> Self {
        Self { json }
    }

    /// Prints a line immediately, so that a service's journal shows it when it happens.
    pub(super) fn line<T: Serialize>(
        &mut self,
        value: &T,
        text: impl Fn(&T) -> String,
    ) -> Result<(), Failure> {
        let line = match self.json {
            true => {
                serde_json::to_string(value).map_err(|error| Failure::Failed(error.to_string()))?
            }
            false => survey::printable_lines(&text(value)).into_owned(),
        };
        let mut out = std::io::stdout().lock();
        match writeln!(out, "{line}").and_then(|()| out.flush()) {
            // a closed pipe is not an error: the reader has finished
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
            printed => printed
                .map_err(|error| Failure::Failed(format!("cannot write the output: {error}"))),
        }
    }
}

pub(super) fn step(step: &Step) -> String {
    match step {
        Step::Archived {
            part,
            stored_as,
            bytes,
            frames,
        } => format!("{part}: archived as {stored_as}: {frames} frames, {bytes} bytes"),
        Step::Receipt { part } => format!("{part}: receipt written"),
        Step::Quantities { session, lines } => format!("{session}: {lines} lines of quantities"),
        Step::Problem { part, text } => format!("{part}: NOT ARCHIVED OR NOT THE SAME: {text}"),
    }
}

pub(super) fn status(found: &Status) -> String {
    let mut text = format!(
        "{} of {} closed parts are archived; {} open; {} lines of quantities are missing",
        found.archived, found.closed, found.open, found.missing_lines
    );
    for part in &found.missing {
        text.push_str(&format!("\n  missing: {part}"));
    }
    text
}

#[derive(Debug, Serialize)]
pub(super) struct Pulled<'a> {
    #[serde(flatten)]
    pub part: &'a ArchivedPart,
    pub path: PathBuf,
}

pub(super) fn pulled(line: &Pulled<'_>) -> String {
    format!(
        "{}: {} frames, {} bytes",
        line.path.display(),
        line.part.frames,
        line.part.bytes
    )
}

#[derive(Debug, Serialize)]
pub(super) struct Verified<'a> {
    #[serde(flatten)]
    pub part: &'a ArchivedPart,
    #[serde(flatten)]
    pub holding: &'a Holding,
}

pub(super) fn verified(line: &Verified<'_>) -> String {
    let state = match line.holding {
        Holding::Intact => "intact".to_owned(),
        Holding::Damaged { found } => format!("DAMAGED: its SHA-256 is {found}"),
        Holding::Missing => "MISSING".to_owned(),
    };
    format!("{}: {state}", line.part.name)
}

pub(super) fn migrated(line: &Migration) -> String {
    let mut text = match line.applied.is_empty() {
        true => "the catalogue is up to date".to_owned(),
        false => format!("applied: {}", line.applied.join(", ")),
    };
    if let Some(timescaledb) = &line.timescaledb {
        text.push_str(&format!("\nTimescaleDB for quantities: {timescaledb}"));
    }
    text
}
