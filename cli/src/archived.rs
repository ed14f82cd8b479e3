//! Sessions in the archive: `tactus archive`, `tactus sessions --archive`, and names `archive:SITE/DAQ/SESSION`. Such a
//! session is fetched into a cache and then read like any other session.

use std::io::Write;
use std::path::PathBuf;

use archive::{ArchiveReader, ArchivedSession, FetchedSession, ReadError, SessionFilter, Task};
use config::path_from_environment;

use crate::args::{Global, Sessions};
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::time::local;

/// Path of the daemon's configuration in an installation.
const CONFIG: &str = "/etc/tactus/config.toml";

fn config(global: &Global) -> PathBuf {
    let named = global.archive_config.clone();
    named
        .or_else(|| path_from_environment("TACTUS_ARCHIVE"))
        .unwrap_or_else(|| CONFIG.into())
}

/// `tactus archive`.
pub(crate) fn run(global: &Global, task: &Task) -> Result<(), Failure> {
    Ok(archive::perform_task(&config(global), global.json, task)?)
}

/// The archive that the configuration names; does not connect.
///
/// # Errors
/// A wrong configuration.
pub(crate) fn reader(global: &Global) -> Result<ArchiveReader, Failure> {
    Ok(ArchiveReader::open(&config(global))?)
}

/// Fetches the session of this name into the cache, where it stays as long as it is in use. Must not be called in
/// asynchronous code.
///
/// # Errors
/// The name is invalid, or matches no session or several; the archive cannot be read; the cache cannot be written.
pub(crate) fn fetch(global: &Global, named: &str) -> Result<FetchedSession, Failure> {
    let wanted = named.parse().map_err(Failure::Usage)?;
    Ok(reader(global)?.fetch(&wanted, &cache()?)?)
}

/// The folder of fetched sessions: in the cache of the systemd unit, otherwise in that of the user.
fn cache() -> Result<PathBuf, Failure> {
    let home = || Some(path_from_environment("HOME")?.join(".cache"));
    let user = || {
        let caches = path_from_environment("XDG_CACHE_HOME").or_else(home)?;
        Some(caches.join("tactus"))
    };
    let cache = path_from_environment("CACHE_DIRECTORY").or_else(user);
    let cache = cache.map(|cache| cache.join("archive"));
    cache.ok_or_else(|| {
        Failure::Configuration(
            "there is no folder for fetched sessions: set XDG_CACHE_HOME or HOME".to_owned(),
        )
    })
}

/// `tactus sessions --archive`.
pub(crate) fn list(
    global: &Global,
    requested: &Sessions,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let sessions = reader(global)?.sessions(&SessionFilter {
        site: requested.site.clone(),
        daq: requested.daq.clone(),
        from: requested.from,
        to: requested.to,
        most: None,
    })?;
    if sessions.is_empty() {
        return printer.text("no session of the archive that this role can read matches; `tactus archive status` compares the record with the archive");
    }
    let heading = ["session", "kind", "started", "frames", "ended", "note"];
    printer.table(heading, &sessions, row)
}

fn row(session: &ArchivedSession) -> [String; 6] {
    let simulated = if session.simulated {
        " (SIMULATED)"
    } else {
        ""
    };
    let remark = match session.complete {
        true => "",
        false => " (continues, or parts are missing)",
    };
    [
        format!("{}/{}/{}", session.site, session.daq, session.id),
        format!("{}{simulated}", session.kind),
        local(session.started),
        session.frames.to_string(),
        format!("{}, {}{remark}", local(session.closed_at), session.reason),
        session.note.clone(),
    ]
}

impl From<archive::Failure> for Failure {
    fn from(failure: archive::Failure) -> Self {
        match failure {
            archive::Failure::Failed(text) => Self::Failed(text),
            archive::Failure::Usage(text) => Self::Usage(text),
            archive::Failure::Missing(text) => Self::Missing(text),
            archive::Failure::Temporary(text) => Self::Busy(text),
            archive::Failure::Configuration(text) => Self::Configuration(text),
        }
    }
}

impl From<ReadError> for Failure {
    fn from(error: ReadError) -> Self {
        archive::Failure::from(error).into()
    }
}
