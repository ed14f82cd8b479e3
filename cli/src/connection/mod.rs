//! The connection to the daemon, and the conversion of its errors to messages and exit codes.

#[cfg(test)]
mod tests;

use std::time::Duration;

use dbus::{
    Address, Alarms1Proxy, ConnectError, Fault, Instrument1Proxy, Manager1Proxy, Session1Proxy,
};
use zbus::DBusError;
use zbus::proxy::Defaults;
use zbus::{Connection, ObjectPath};

use crate::args::Global;
use crate::failure::Failure;

/// The name of the session that was started last.
pub(crate) const LAST: &str = "last";

/// A connection to a running daemon.
pub(crate) struct Daemon {
    connection: Connection,
    /// Its address.
    pub(crate) address: Address,
    /// Timeout of one call.
    pub(crate) patience: Duration,
    pub(crate) manager: Manager1Proxy<'static>,
}

/// Connects to the daemon at `--bus` or `TACTUS_BUS`, or to the first of the default addresses that has a daemon.
///
/// # Errors
/// No daemon (the message explains how to start one); no permission; an invalid address.
pub(crate) async fn open(global: &Global) -> Result<Daemon, Failure> {
    let wanted = wanted(global)?;
    let reached = tokio::time::timeout(global.timeout, dbus::connect(wanted.as_ref()))
        .await
        .map_err(|_| timed_out("the daemon", global.timeout))?;
    let (connection, address) = reached.map_err(|error| unreached(&error))?;
    let manager = dbus::proxy(&connection, dbus::ROOT_PATH)
        .await
        .map_err(|error| fault("the daemon", &error.into()))?;
    Ok(Daemon {
        connection,
        address,
        patience: global.timeout,
        manager,
    })
}

/// The address that `--bus` or `TACTUS_BUS` gives; `None` if neither is set.
///
/// # Errors
/// The text is not an address.
pub(crate) fn wanted(global: &Global) -> Result<Option<Address>, Failure> {
    let named = match &global.bus {
        Some(text) => Some(text.clone()),
        None => std::env::var("TACTUS_BUS")
            .ok()
            .filter(|text| !text.is_empty()),
    };
    named
        .map(|text| text.parse::<Address>())
        .transpose()
        .map_err(|error| Failure::Usage(error.to_string()))
}

impl Daemon {
    /// Awaits one reply, at most for `--timeout`.
    ///
    /// # Errors
    /// The daemon's error as a [`Failure`] with advice, or [`Failure::Timeout`].
    pub(crate) async fn ask<T>(
        &self,
        what: &str,
        answer: impl Future<Output = Result<T, Fault>>,
    ) -> Result<T, Failure> {
        tokio::time::timeout(self.patience, answer)
            .await
            .map_err(|_| timed_out(what, self.patience))?
            .map_err(|error| fault(what, &error))
    }

    /// The proxy of an object, which queries the daemon for each property and does not cache it.
    async fn object<P>(&self, what: &str, path: ObjectPath<'static>) -> Result<P, Failure>
    where
        P: Defaults + From<zbus::Proxy<'static>>,
    {
        dbus::proxy(&self.connection, path)
            .await
            .map_err(|error| fault(what, &error.into()))
    }

    /// The proxy of a session.
    pub(crate) async fn session(
        &self,
        path: ObjectPath<'static>,
    ) -> Result<Session1Proxy<'static>, Failure> {
        self.object("the session", path).await
    }

    /// The proxy of the alarms.
    pub(crate) async fn alarms(&self) -> Result<Alarms1Proxy<'static>, Failure> {
        let root = ObjectPath::from_static_str_unchecked(dbus::ROOT_PATH);
        self.object("the alarms", root).await
    }

    /// The proxy of an instrument.
    pub(crate) async fn instrument(
        &self,
        path: ObjectPath<'static>,
    ) -> Result<Instrument1Proxy<'static>, Failure> {
        self.object("the instrument", path).await
    }

    /// The running session, if any.
    pub(crate) async fn active(&self) -> Result<Option<Session1Proxy<'static>>, Failure> {
        let path = self
            .ask("the running session", self.manager.active_session())
            .await?;
        if path.as_str() == "/" {
            return Ok(None);
        }
        self.session(path.into()).await.map(Some)
    }

    /// The session with this id, with an id that begins so, or the last one (`last`), if it runs or ended a short while
    /// ago.
    ///
    /// # Errors
    /// [`Failure::Usage`] if several ids begin so; [`Failure::Missing`] if none does, or if the daemon no longer has
    /// the session.
    pub(crate) async fn named(&self, named: &str) -> Result<Session1Proxy<'static>, Failure> {
        let id = self.session_id(named, |_| true).await?;
        let id = id.as_deref().unwrap_or(named);
        let path = dbus::session_path(id).map_err(|error| Failure::Usage(error.to_string()))?;
        let session = self.session(path).await?;
        match self.ask("the session", session.id()).await {
            Ok(_) => Ok(session),
            Err(Failure::Missing(_)) => Err(Failure::Missing(format!(
                "the daemon runs no session '{id}'; `tactus status` shows the running one, `tactus sessions` lists the recorded ones"
            ))),
            Err(other) => Err(other),
        }
    }

    /// The id that `named` stands for: the id itself, that of the newest `wanted` session (`last`), or the only one
    /// that begins with `named`; `None` if there is none.
    ///
    /// # Errors
    /// [`Failure::Usage`] if several ids begin so.
    pub(crate) async fn session_id(
        &self,
        named: &str,
        wanted: impl Fn(&dbus::SessionSummary) -> bool,
    ) -> Result<Option<String>, Failure> {
        let none = dbus::Options::new();
        let sessions = self
            .ask("the sessions", self.manager.list_sessions(&none))
            .await?;
        let ids = sessions.iter().filter(|session| wanted(session));
        let ids: Vec<&str> = ids.map(|session| session.id.as_str()).collect();
        resolve_id(named, &ids).map(|id| id.map(str::to_owned))
    }

    /// The id of the baseline that `named` stands for. An unknown name is returned unchanged, and the daemon refuses
    /// it.
    ///
    /// # Errors
    /// As for [`Daemon::session_id`]; and `last` if no baseline is recorded.
    pub(crate) async fn baseline_id(&self, named: &str) -> Result<String, Failure> {
        let is_baseline = |session: &dbus::SessionSummary| {
            session.kind == "baseline" && session.state == "closed"
        };
        match self.session_id(named, is_baseline).await? {
            Some(id) => Ok(id),
            None if named == LAST => Err(Failure::Missing(
                "no baseline is recorded; record one with `tactus baseline record`".to_owned(),
            )),
            None => Ok(named.to_owned()),
        }
    }
}

/// The id that `named` stands for; `ids` are in order, the newest first.
fn resolve_id<'a>(named: &str, ids: &[&'a str]) -> Result<Option<&'a str>, Failure> {
    let mut matching = ids.iter().copied().filter(|id| match named {
        LAST => true,
        _ => id.starts_with(named),
    });
    if let Some(exact) = ids.iter().copied().find(|id| *id == named) {
        return Ok(Some(exact));
    }
    let first = matching.next();
    let others: Vec<&str> = matching.collect();
    if named == LAST || others.is_empty() {
        return Ok(first);
    }
    let listed: Vec<&str> = first.into_iter().chain(others).collect();
    Err(Failure::Usage(format!(
        "'{named}' is the beginning of several session ids: {}{}; write more characters of the id",
        listed[..listed.len().min(5)].join(", "),
        if listed.len() > 5 { ", ..." } else { "" }
    )))
}

fn timed_out(what: &str, patience: Duration) -> Failure {
    Failure::Timeout(format!(
        "{what}: no reply within {}; read the daemon's journal, or wait longer with --timeout",
        crate::options::duration::display_span(patience)
    ))
}

fn unreached(error: &ConnectError) -> Failure {
    match error {
        ConnectError::NotAuthorized { .. } => Failure::NotAuthorised(format!(
            "{error}; `sudo usermod -aG tactus USER` adds a user"
        )),
        ConnectError::Busy { .. } => Failure::Busy(format!("{error}; try again")),
        ConnectError::NoDaemon { address, cause } => no_daemon(&[format!("{address} ({cause})")]),
        ConnectError::Nowhere { tried } => no_daemon(tried),
    }
}

/// The failure after all attempts, one per line, with advice how to start a daemon.
fn no_daemon(tried: &[String]) -> Failure {
    let mut text = "no daemon answers at".to_owned();
    for place in tried {
        text.push_str("\n  ");
        text.push_str(&readable_reason(place));
    }
    text.push_str(
        "\nStart one with `tactusd --config config.toml` (installed: `systemctl start tactusd`), or give its address \
         with --bus; recorded sessions need no daemon: `tactus sessions`, `tactus export`, `tactus replay`",
    );
    Failure::Missing(text)
}

/// A reason without the error numbers and names of the operating system.
fn readable_reason(reason: &str) -> String {
    let mut text = reason.to_owned();
    while let Some(from) = text.find(" (os error ") {
        let Some(length) = text[from..].find(')') else {
            break;
        };
        text.replace_range(from..=from + length, "");
    }
    text.replace("I/O error: ", "")
        .replace("No such file or directory", "nothing is there")
        .replace("Connection refused", "no program listens there")
}

/// The daemon's error, with advice if its text has none.
pub(crate) fn fault(what: &str, fault: &Fault) -> Failure {
    let message = fault.text();
    let advise = |advice: &str| {
        if message.contains("`tactus") || message.contains(advice) {
            message.clone()
        } else {
            format!("{message}; {advice}")
        }
    };
    match fault {
        Fault::SessionActive(_) => {
            Failure::Failed(advise("`tactus stop` ends the running session"))
        }
        Fault::NoSession(_) => Failure::Missing(advise(
            "`tactus start` starts one, `tactus sessions` lists the recorded ones",
        )),
        Fault::NoBaseline(_) => Failure::Missing(advise(
            "take all loads off the sheet and run `tactus baseline record`",
        )),
        Fault::BaselineMismatch(_) => Failure::Configuration(advise(
            "take all loads off the sheet and run `tactus baseline record`",
        )),
        Fault::ModelMismatch(_) | Fault::ModelFile(_) => Failure::Configuration(advise(
            "name a model made for this sheet with --model, or use --model one-step",
        )),
        Fault::RecordingFault(_) | Fault::Configuration(_) => Failure::Configuration(message),
        Fault::InstrumentFault(_) => {
            Failure::Instrument(advise("`tactus instruments` shows which ones answer"))
        }
        Fault::DiskRefused(_) => Failure::Failed(advise("free space, then `tactus start` again")),
        Fault::NotAuthorized(_) => Failure::NotAuthorised(advise(
            "ask the administrator to add you to the group tactus, or run as root",
        )),
        Fault::LimitsExceeded(_) => Failure::Busy(advise(
            "end connections or calls that are no longer needed, or try again",
        )),
        Fault::InvalidOption(_) => Failure::Usage(message),
        Fault::NoFrame(_) => Failure::Failed(advise("`tactus watch` waits for the first")),
        Fault::Unsupported(_) | Fault::Failed(_) => Failure::Failed(message),
        Fault::Connection(zbus::Error::FDO(standard)) => {
            let name = standard.name();
            let message = standard.description().unwrap_or_default();
            undelivered(what, name.as_str(), message)
        }
        Fault::Connection(zbus::Error::MethodError(name, message, _)) => {
            undelivered(what, name.as_str(), message.as_deref().unwrap_or_default())
        }
        Fault::Connection(zbus::Error::InputOutput(_)) => no_longer_running(what, &message),
        Fault::Connection(_) => Failure::Failed(format!("{what}: {message}")),
    }
}

/// An error from the bus or the library, and not from the daemon.
fn undelivered(what: &str, name: &str, message: &str) -> Failure {
    match name.rsplit('.').next().unwrap_or(name) {
        "AccessDenied" | "AuthFailed" | "InteractiveAuthorizationRequired" => {
            Failure::NotAuthorised(format!(
                "{what}: {message}; ask the administrator to add you to the group tactus, or run as root"
            ))
        }
        "UnknownObject" => Failure::Missing(format!("{what}: {message}")),
        "UnknownMethod" | "UnknownInterface" | "UnknownProperty" => Failure::Missing(format!(
            "{what}: the daemon does not have this call ({message}); if `tactus --version` and `tactusd --version` differ, install the same version of both"
        )),
        "ServiceUnknown" | "NameHasNoOwner" | "NoReply" | "Disconnected" | "NoServer" => {
            no_longer_running(what, message)
        }
        "LimitsExceeded" | "NoMemory" => Failure::Busy(format!("{what}: {message}; try again")),
        "Timeout" | "TimedOut" => Failure::Timeout(format!("{what}: {message}")),
        _ => Failure::Failed(format!("{what}: {message} ({name})")),
    }
}

fn no_longer_running(what: &str, message: &str) -> Failure {
    Failure::Missing(format!(
        "{what}: the daemon ended ({message}); read the daemon's journal, then start it with `systemctl start tactusd`"
    ))
}
