//! Finds and opens session files without a daemon.

use std::path::{Path, PathBuf};
use std::time::Duration;

use config::path_from_environment;
use logbook::{Listing, LogbookError, SessionReader};
use survey::printable;

use crate::args::Global;
use crate::connection::LAST;
use crate::failure::{Failure, chain};
use crate::output::complain;

/// Timeout of queries; a running daemon that does not reply within this time is ignored.
const DAEMON_TIMEOUT: Duration = Duration::from_secs(2);

/// Directories of session files: only `--state` or `TACTUS_STATE` if given; otherwise the directory of the running
/// daemon, `$XDG_STATE_HOME/tactus`, `~/.local/state/tactus`, `/var/lib/tactus`.
///
/// # Errors
/// An invalid `--bus` address.
pub(crate) fn directories(global: &Global) -> Result<Vec<PathBuf>, Failure> {
    if let Some(directory) = &global.state {
        return Ok(vec![directory.clone()]);
    }
    if let Some(directory) = path_from_environment("TACTUS_STATE") {
        return Ok(vec![directory]);
    }
    let usual = [
        path_from_environment("XDG_STATE_HOME").map(|state| state.join("tactus")),
        path_from_environment("HOME").map(|home| home.join(".local/state/tactus")),
        Some(PathBuf::from("/var/lib/tactus")),
    ];
    let mut places: Vec<PathBuf> = Vec::new();
    for place in [daemon_directory(global)?].into_iter().chain(usual) {
        places.extend(place.filter(|place| !places.contains(place)));
    }
    Ok(places)
}

/// The directory in which a running daemon records; `None` if no daemon replies.
fn daemon_directory(global: &Global) -> Result<Option<PathBuf>, Failure> {
    let directory = ask_daemon(global, async |daemon| {
        let requested = daemon.manager.record_directory();
        daemon.ask("the record", requested).await
    });
    Ok(directory?.map(PathBuf::from))
}

/// The id of the baseline that a running daemon uses; `None` if no daemon replies or it has no baseline.
///
/// # Errors
/// The address of `--bus` is invalid.
pub(crate) fn baseline_in_use(global: &Global) -> Result<Option<String>, Failure> {
    ask_daemon(global, async |daemon| {
        let status = daemon.ask("the status", daemon.manager.status()).await?;
        Ok(status.baseline_id.unwrap_or_default())
    })
}

/// The result of a query to a running daemon; `None` if none replies soon.
fn ask_daemon<T>(
    global: &Global,
    query: impl AsyncFnOnce(crate::connection::Daemon) -> Result<T, Failure>,
) -> Result<Option<T>, Failure> {
    let Ok(runtime) = crate::runtime::current_thread() else {
        return Ok(None);
    };
    let hurried = Global {
        timeout: global.timeout.min(DAEMON_TIMEOUT),
        ..global.clone()
    };
    let answer = runtime.block_on(async { query(crate::connection::open(&hurried).await?).await });
    match answer {
        Ok(answer) => Ok(Some(answer)),
        Err(Failure::Usage(wrong)) => Err(Failure::Usage(wrong)),
        Err(_) => Ok(None),
    }
}

/// The failure that no session is in any of these directories.
pub(crate) fn none(places: &[PathBuf]) -> Failure {
    Failure::Missing(format!(
        "no session in {}; --state DIR names another directory of session files",
        listed(places)
    ))
}

/// Paths as text.
pub(crate) fn listed(places: &[PathBuf]) -> String {
    let places: Vec<String> = places
        .iter()
        .map(|place| place.display().to_string())
        .collect();
    places.join(", ")
}

/// The sessions in one of these directories; `None` if it does not exist, or if it cannot be read and there are others,
/// which is reported.
///
/// # Errors
/// The directory cannot be read and is the only one.
pub(crate) fn listing(
    places: &[PathBuf],
    place: &Path,
    report: impl FnOnce(&str),
) -> Result<Option<Listing>, Failure> {
    match logbook::list(place) {
        Ok(listing) => Ok(Some(listing)),
        Err(_) if !place.exists() => Ok(None),
        Err(error) if places.len() == 1 => Err(error.into()),
        Err(error) => {
            report(&left_out(place, &error));
            Ok(None)
        }
    }
}

/// Reports the files of a directory that look like sessions and cannot be read.
pub(crate) fn report_unreadable(listing: &Listing) {
    for unreadable in &listing.unreadable {
        report(&left_out(&unreadable.path, &unreadable.why));
    }
}

/// Reports on standard error what is left out of a list, a sentence of [`left_out`].
pub(crate) fn report(left_out: &str) {
    complain(&format!("tactus: {left_out}"));
}

/// Why the sessions of a folder or file are not in a list.
pub(crate) fn left_out(path: &Path, why: &LogbookError) -> String {
    let path = path.to_string_lossy();
    format!("{} is left out: {}", printable(&path), chain(why))
}

/// The first file of the session that was started last, in all directories.
fn last(places: &[PathBuf]) -> Result<PathBuf, Failure> {
    let mut all = Vec::new();
    for place in places {
        let Some(listing) = listing(places, place, report)? else {
            continue;
        };
        // a file that cannot be read may be the last session
        report_unreadable(&listing);
        all.extend(listing.sessions.into_iter().map(|session| (place, session)));
    }
    let newest = all
        .into_iter()
        .max_by(|(_, a), (_, b)| (a.started, &a.id).cmp(&(b.started, &b.id)));
    let (place, session) = newest.ok_or_else(|| none(places))?;
    // the first part, if the session has several
    Ok(logbook::find(place, session.session())?)
}

/// The prefix of the name of a session in the archive.
pub(crate) const ARCHIVE: &str = "archive:";

/// The file of a session of the archive, fetched into the cache.
fn archived(global: &Global, named: &str) -> Result<PathBuf, Failure> {
    #[cfg(feature = "archive")]
    {
        let fetched = crate::archived::fetch(global, named)?;
        // never released, because the command may read the file until it ends
        std::mem::forget(fetched.in_use);
        Ok(fetched.path)
    }
    #[cfg(not(feature = "archive"))]
    {
        let _ = global;
        Err(Failure::Usage(format!(
            "{ARCHIVE}{named}: this build reads no archive; build it with `--features archive` (the Debian package has it)"
        )))
    }
}

/// The file of a session: a path unchanged; `archive:` and the name of a session in the archive; `last`; otherwise an
/// id (or the beginning of one) in the first of [`directories`] that has it.
pub(crate) fn session_file(global: &Global, named: &str) -> Result<PathBuf, Failure> {
    if let Some(named) = named.strip_prefix(ARCHIVE) {
        return archived(global, named);
    }
    let path = Path::new(named);
    if path.is_file() {
        return Ok(path.to_owned());
    }
    if named.contains('/') || named.ends_with(".tactus") {
        return Err(Failure::Failed(format!(
            "there is no file or folder {named}; `tactus sessions` lists what is recorded"
        )));
    }
    let places = directories(global)?;
    if named == LAST {
        return last(&places);
    }
    let mut unreadable = Vec::new();
    for place in &places {
        match logbook::find(place, named) {
            Ok(file) => return Ok(file),
            Err(LogbookError::NoSuchSession { .. }) => {}
            Err(error @ (LogbookError::Ambiguous { .. } | LogbookError::BadId { .. })) => {
                return Err(error.into());
            }
            Err(_) if !place.exists() => {}
            Err(error) => unreadable.push(chain(&error)),
        }
    }
    let mut text = format!(
        "no session '{named}' in {}; --state DIR names another directory of session files",
        listed(&places)
    );
    for why in unreadable {
        text.push_str("\n  ");
        text.push_str(&why);
    }
    Err(Failure::Missing(text))
}

/// Opens a session file.
pub(crate) fn open(path: &Path) -> Result<SessionReader, Failure> {
    Ok(SessionReader::open(path)?)
}

impl From<LogbookError> for Failure {
    fn from(error: LogbookError) -> Self {
        let text = chain(&error);
        match error {
            LogbookError::NoSuchSession { .. } => Self::Missing(format!(
                "{text}; --state DIR names another directory of session files"
            )),
            LogbookError::Ambiguous { .. } | LogbookError::BadId { .. } => Self::Usage(text),
            _ => Self::Failed(text),
        }
    }
}
