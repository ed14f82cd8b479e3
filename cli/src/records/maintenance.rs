//! `tactus sessions verify | repair | prune`: checks, repairs and removes records.

use std::io::Write;
use std::path::PathBuf;

use chrono::Utc;
use logbook::{Removed, Retention, Verified};
use serde::Serialize;

use crate::args::{Export, Global, Prune, Repair, SessionsCommand, Verify};
use crate::failure::{Failure, chain};
use crate::output::progress::progress;
use crate::output::{Printer, complain};
use crate::session_files;

pub(crate) fn run(
    global: &Global,
    what: &SessionsCommand,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    match what {
        SessionsCommand::Show { session } => super::show::run(global, session, printer),
        SessionsCommand::Verify(asked) => verify(global, asked, printer),
        SessionsCommand::Repair(asked) => repair(global, asked, printer),
        SessionsCommand::Prune(asked) => prune(global, asked, printer),
    }
}

/// A line of `sessions verify --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct VerifyLine {
    intact: bool,
    #[serde(flatten)]
    found: Verified,
}

fn verify(
    global: &Global,
    asked: &Verify,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let files = match asked.all {
        true => all(global)?,
        false => asked
            .sessions
            .iter()
            .map(|named| session_files::session_file(global, named))
            .collect::<Result<_, _>>()?,
    };
    let (mut checked, mut broken) = (0, 0);
    for file in &files {
        let frames: u64 = logbook::parts(file)?
            .iter()
            .filter_map(|part| logbook::SessionReader::open(part).ok()?.len().ok())
            .sum();
        let bar = progress(Some(frames), printer.is_terminal());
        let found = logbook::verify(file, |done| bar.set_position(done));
        bar.finish_and_clear();
        let found = found?;
        checked += 1;
        let line = VerifyLine {
            intact: found.findings.is_empty(),
            found,
        };
        broken += u32::from(!line.intact);
        printer.record(&line, describe)?;
    }
    match broken {
        0 => Ok(()),
        _ => Err(Failure::Failed(format!(
            "{broken} of {checked} sessions have defects; `tactus sessions repair SESSION` copies the readable \
             frames of a damaged file"
        ))),
    }
}

/// One file per session, the oldest first.
fn all(global: &Global) -> Result<Vec<PathBuf>, Failure> {
    let mut files: Vec<PathBuf> = Vec::new();
    let places = session_files::directories(global)?;
    for place in &places {
        if !place.exists() {
            continue;
        }
        let listing = logbook::list(place)?;
        let readable = listing.sessions.into_iter().map(|session| session.path);
        let unreadable = listing.unreadable.into_iter().map(|file| file.path);
        for file in readable.chain(unreadable) {
            let parts = logbook::parts(&file)?;
            let first = parts.into_iter().next().unwrap_or(file);
            if !files.contains(&first) {
                files.push(first);
            }
        }
    }
    if files.is_empty() {
        return Err(session_files::none(&places));
    }
    Ok(files)
}

fn describe(line: &VerifyLine) -> String {
    let found = &line.found;
    let explained = found.gaps.iter().filter(|gap| gap.explained.is_some());
    let mut text = format!(
        "{}: {}: {} frames in {} part{}, {} gaps, {} explained by an event{}",
        found.session,
        if line.intact { "intact" } else { "DAMAGED" },
        found.frames,
        found.parts.len(),
        if found.parts.len() == 1 { "" } else { "s" },
        found.gaps.len(),
        explained.clone().count(),
        if found.closed { "" } else { "; not closed" },
    );
    for gap in explained {
        text.push_str(&format!(
            "\n  gap of {:.1} s after frame {}: {}",
            gap.seconds,
            gap.after,
            gap.explained.as_deref().unwrap_or_default()
        ));
    }
    for finding in &found.findings {
        text.push_str(&format!(
            "\n  {} ({}): {}",
            finding.part, finding.kind, finding.text
        ));
    }
    text
}

fn repair(
    global: &Global,
    asked: &Repair,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let file = session_files::session_file(global, &asked.session)?;
    let frames = logbook::SessionReader::open(&file)
        .and_then(|session| session.len())
        .unwrap_or(0);
    let bar = progress(Some(frames), printer.is_terminal());
    let repaired = logbook::repair(&file, asked.out.as_deref(), Utc::now(), |done| {
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let repaired = repaired?;
    printer.record(&repaired, |repaired| {
        let mut text = format!(
            "{}: {} frames and {} events kept{}",
            repaired.path.display(),
            repaired.frames,
            repaired.events,
            if repaired.baseline {
                ", baseline kept"
            } else {
                ""
            },
        );
        for cut in &repaired.cut {
            text.push_str(&format!(
                "\n  frames {} to {} were cut: {}",
                cut.first, cut.last, cut.why
            ));
        }
        for lost in &repaired.lost {
            text.push_str(&format!("\n  lost: {lost}"));
        }
        text
    })
}

/// A line of `sessions prune --json`; see `docs/reference/json.md`.
#[derive(Debug, Serialize)]
struct PrunedLine<'a> {
    what: &'static str,
    id: &'a str,
    bytes: Option<u64>,
    why: &'a str,
}

fn prune(global: &Global, asked: &Prune, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    let retention = Retention {
        older_than: asked.older_than,
        keep_bytes: asked.keep_bytes,
        exported_only: asked.exported_only,
        archived_only: asked.archived_only,
        ring: false,
    };
    let (verb, participle) = match asked.dry_run {
        true => ("would be removed", "would be removed"),
        false => ("was removed", "were removed"),
    };
    let (mut count, mut bytes) = (0, 0);
    let mut failed = None;
    for place in session_files::directories(global)? {
        if !place.exists() {
            continue;
        }
        let mut printed = Ok(());
        let report = |removed: &Removed| {
            count += 1;
            bytes += removed.bytes;
            let line = PrunedLine {
                what: if asked.dry_run {
                    "would_remove"
                } else {
                    "removed"
                },
                id: &removed.id,
                bytes: Some(removed.bytes),
                why: &removed.why,
            };
            let written = printer.record(&line, |line| {
                let mb = removed.bytes as f64 / 1e6;
                format!("{} {verb} ({mb:.1} MB): {}", line.id, line.why)
            });
            if printed.is_ok() {
                printed = written;
            }
        };
        let pruned = logbook::prune_each(&place, &retention, Utc::now(), asked.dry_run, report);
        printed?;
        let pruned = match pruned {
            Ok(pruned) => pruned,
            Err(error) => {
                failed = Some(Failure::failed(
                    "not all selected sessions could be removed",
                    &error,
                ));
                break;
            }
        };
        for spared in &pruned.spared {
            let line = PrunedLine {
                what: "spared",
                id: &spared.id,
                bytes: None,
                why: &spared.why,
            };
            printer.record(&line, |line| format!("{} is kept: {}", line.id, line.why))?;
        }
    }
    printer.text(&format!(
        "{count} sessions {participle}, {:.1} MB",
        bytes as f64 / 1e6
    ))?;
    failed.map_or(Ok(()), Err)
}

/// Marks a session as exported. A folder that cannot be written to is reported, but is not a failure.
pub(crate) fn mark(session: &logbook::SessionReader, last: u64, export: &Export) {
    let to = &export.out;
    let exported = logbook::ExportMarker {
        at: Utc::now(),
        last,
        format: export.format.name(),
        to: std::path::absolute(to)
            .unwrap_or(to.to_path_buf())
            .display()
            .to_string(),
    };
    if let Err(error) = logbook::mark_exported(session.path(), &exported) {
        complain(&format!(
            "tactus: not marked as exported, so `sessions prune --exported-only` will keep it: {}",
            chain(&error)
        ));
    }
}

/// Parses a size in bytes: `500MB`, `20GB`, `1TB` (powers of ten), `1GiB` (powers of two), or a plain number.
pub(crate) fn parse_size(text: &str) -> Result<u64, String> {
    parse_size::parse_size(text).map_err(|cause| {
        format!("'{text}' is not a size ({cause}); write for example 20GB or 1GiB")
    })
}

#[cfg(test)]
mod tests {
    use crate::records::maintenance::parse_size;

    #[test]
    fn sizes_are_read_as_they_are_written() {
        assert_eq!(parse_size("20GB"), Ok(20_000_000_000));
        assert_eq!(parse_size("1.5 MB"), Ok(1_500_000));
        assert_eq!(parse_size("1GiB"), Ok(1 << 30));
        assert_eq!(parse_size("0"), Ok(0));
        assert!(parse_size("20 gigs").unwrap_err().contains("gigs"));
        assert!(parse_size("GB").unwrap_err().contains("20GB"));
    }
}
