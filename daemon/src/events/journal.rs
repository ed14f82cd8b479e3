//! Where the log goes: straight to systemd's journal, with fields, where standard error leads there; else to standard error.
//!
//! `journalctl TACTUS_SESSION=m20261207t093000_000` finds what a session told; other fields are `TACTUS_KIND`,
//! `TACTUS_FRAME` and `TACTUS_INSTRUMENT`.

use std::io::IsTerminal;

use survey::printable;
use tracing_subscriber::field::MakeExt;
use tracing_subscriber::fmt::format::debug_fn;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// What the names of the fields begin with.
const PREFIX: &str = "TACTUS";

/// `RUST_LOG` decides what is said; warnings and the daemon's own words by default.
pub(crate) fn begin() {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,daemon=info"));
    let log = tracing_subscriber::registry().with(filter);
    let stream = std::env::var("JOURNAL_STREAM").unwrap_or_default();
    let begun = match journald(&stream) {
        Some(journald) => log.with(journald).try_init(),
        None => {
            let to_stderr = tracing_subscriber::fmt::layer()
                .with_writer(std::io::stderr)
                .with_ansi(std::io::stderr().is_terminal())
                .with_target(false)
                // what instruments and clients say is in some of it
                .fmt_fields(debug_fn(|to, field, value| {
                    let text = format!("{value:?}");
                    match field.name() {
                        "message" => write!(to, "{}", printable(&text)),
                        name => write!(to, "{name}={}", printable(&text)),
                    }
                }))
                .map_fmt_fields(|fields| fields.delimited(" "));
            log.with(to_stderr).try_init()
        }
    };
    // a second daemon in one process (a test) goes on with the first one's
    drop(begun);
}

/// The journal, where standard error is the stream that systemd names (`JOURNAL_STREAM`, systemd.exec(5)) and the journal
/// listens.
fn journald(stream: &str) -> Option<tracing_journald::Layer> {
    let stderr = rustix::fs::fstat(std::io::stderr()).ok()?;
    if !leads(stream, stderr.st_dev, stderr.st_ino) {
        return None;
    }
    let layer = tracing_journald::layer().ok()?;
    Some(layer.with_field_prefix(Some(PREFIX.to_owned())))
}

/// Whether `device:inode` names this file.
fn leads(stream: &str, device: u64, inode: u64) -> bool {
    stream
        .split_once(':')
        .is_some_and(|(dev, ino)| dev.parse() == Ok(device) && ino.parse() == Ok(inode))
}

#[cfg(test)]
mod tests {
    use crate::events::journal::*;

    #[test]
    fn only_the_stream_that_is_named_leads_to_the_journal() {
        assert!(leads("8:1234", 8, 1234));
        // a child whose standard error was sent elsewhere still has the variable
        for other in ["8:1235", "9:1234", "", "8", "8:x"] {
            assert!(!leads(other, 8, 1234), "{other}");
        }
    }
}
