//! Commands of the page and of the terminal's dashboard: calls of the same names on the daemon's bus. The daemon
//! decides by the rights of the user who runs the program.

use std::time::Duration;

use dbus::{Address, Alarms1Proxy, Fault, Manager1Proxy, Options, Session1Proxy, Simulation1Proxy};
use serde::Deserialize;
use zbus::Connection;

/// Longest wait for a reply: a start reads a baseline and prepares a method.
const PATIENCE: Duration = Duration::from_secs(30);

/// A command, as the page sends it: `{"call": "start", "every_s": 1.0}`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(tag = "call", rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) enum Call {
    /// `Manager1.StartSession`.
    Start { every_s: Option<f64> },
    /// `Session1.Stop` of the running session.
    Stop,
    /// `Manager1.RecordBaseline`.
    Baseline { frames: Option<u64> },
    /// `Simulation1.Press` with a disc: position and size in m, loss as a share.
    Press {
        x_m: f64,
        y_m: f64,
        size_m: f64,
        loss: f64,
    },
    /// `Simulation1.Release`.
    Release,
    /// `Alarms1.Acknowledge`.
    Acknowledge {
        name: String,
        comment: Option<String>,
    },
    /// `Alarms1.Shelve`; without a time until the alarm ends.
    Shelve {
        name: String,
        for_s: Option<f64>,
        comment: Option<String>,
    },
    /// `Alarms1.Unshelve`.
    Unshelve { name: String },
    /// `Alarms1.Reset`.
    Reset {
        name: String,
        comment: Option<String>,
    },
}

/// Acknowledges an alarm, with the rights of this process.
///
/// # Errors
/// A sentence: the daemon cannot be reached, or refuses.
pub async fn acknowledge(address: Option<&Address>, name: String) -> Result<(), String> {
    let comment = None;
    carry_out(address, Call::Acknowledge { name, comment }).await
}

/// Carries out a command.
///
/// # Errors
/// A sentence: the daemon cannot be reached, or refuses.
pub(crate) async fn carry_out(address: Option<&Address>, call: Call) -> Result<(), String> {
    let done = tokio::time::timeout(PATIENCE, async {
        let connected = dbus::connect(address).await;
        let (connection, _) = connected.map_err(|error| format!("no daemon: {error}"))?;
        ask(&connection, call).await.map_err(|fault| fault.text())
    });
    done.await.unwrap_or_else(|_| {
        Err(format!(
            "the daemon did not reply within {} s",
            PATIENCE.as_secs()
        ))
    })
}

async fn ask(connection: &Connection, call: Call) -> Result<(), Fault> {
    let with = |comment: Option<String>| match comment {
        Some(comment) => Options::new().with("comment", comment.as_str()),
        None => Options::new(),
    };
    let manager: Manager1Proxy<'_> = dbus::proxy(connection, dbus::ROOT_PATH).await?;
    match call {
        Call::Start { every_s } => {
            let options = every_s.map_or_else(Options::new, |s| Options::new().with("every_s", s));
            manager.start_session(&options).await?;
        }
        Call::Stop => {
            let path = manager.active_session().await?;
            if path.as_str() == "/" {
                return Err(Fault::NoSession("no session runs".to_owned()));
            }
            let session: Session1Proxy<'_> = dbus::proxy(connection, path).await?;
            session.stop().await?;
        }
        Call::Baseline { frames } => {
            let options = frames.map_or_else(Options::new, |n| Options::new().with("frames", n));
            manager.record_baseline(&options).await?;
        }
        Call::Press {
            x_m,
            y_m,
            size_m,
            loss,
        } => {
            let sheet = Simulation1Proxy::new(connection).await?;
            sheet.press("disc", x_m, y_m, size_m, loss).await?;
        }
        Call::Release => Simulation1Proxy::new(connection).await?.release().await?,
        Call::Acknowledge { name, comment } => {
            let alarms = Alarms1Proxy::new(connection).await?;
            alarms.acknowledge(&name, &with(comment)).await?;
        }
        Call::Shelve {
            name,
            for_s,
            comment,
        } => {
            let mut options = with(comment);
            if let Some(for_s) = for_s {
                options = options.with("for_s", for_s);
            }
            let alarms = Alarms1Proxy::new(connection).await?;
            alarms.shelve(&name, &options).await?;
        }
        Call::Unshelve { name } => {
            let alarms = Alarms1Proxy::new(connection).await?;
            alarms.unshelve(&name, &Options::new()).await?;
        }
        Call::Reset { name, comment } => {
            let alarms = Alarms1Proxy::new(connection).await?;
            alarms.reset(&name, &with(comment)).await?;
        }
    }
    Ok(())
}
