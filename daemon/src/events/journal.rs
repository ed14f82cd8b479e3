//! Destination of the log: systemd's journal, with fields, if standard error is connected to it; else standard error.
//!
//! `journalctl TACTUS_SESSION=m20261207t093000_000` shows the messages of a session; other fields are `TACTUS_KIND`,
//! `TACTUS_FRAME` and `TACTUS_INSTRUMENT`.

use std::io::IsTerminal;

use survey::printable;
use tracing_subscriber::field::MakeExt;
use tracing_subscriber::fmt::format::debug_fn;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Prefix of the fields' names.
const PREFIX: &str = "TACTUS";

/// `RUST_LOG` sets the filter; by default warnings and the daemon's own messages are logged.
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
                // some messages contain text from instruments and clients
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
    // a second daemon in the same process (a test) uses the first one's logger
    drop(begun);
}

/// The journal, if standard error is the stream named by systemd (`JOURNAL_STREAM`, systemd.exec(5)) and the journal
/// accepts messages.
fn journald(stream: &str) -> Option<tracing_journald::Layer> {
    let stderr = rustix::fs::fstat(std::io::stderr()).ok()?;
    if !leads(stream, stderr.st_dev, stderr.st_ino) {
        return None;
    }
    let layer = tracing_journald::layer().ok()?;
    Some(layer.with_field_prefix(Some(PREFIX.to_owned())))
}

/// Whether `device:inode` identifies this file.
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
        // a child with redirected standard error still has the variable
        for other in ["8:1235", "9:1234", "", "8", "8:x"] {
            assert!(!leads(other, 8, 1234), "{other}");
        }
    }
}
