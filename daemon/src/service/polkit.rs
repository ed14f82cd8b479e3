//! Queries polkit whether a caller on the system bus is authorised. The caller is identified by its unique name, which
//! cannot be reused during the query.

use std::collections::HashMap;
use std::time::Duration;

use zbus::names::UniqueName;
use zbus::{Connection, DBusError, Variant};

const SERVICE: &str = "org.freedesktop.PolicyKit1";
const PATH: &str = "/org/freedesktop/PolicyKit1/Authority";
const INTERFACE: &str = "org.freedesktop.PolicyKit1.Authority";

/// The flag `AllowUserInteraction`.
const ASK_THE_USER: u32 = 1;
/// Timeout without user interaction. Callers give up after 25 s by default. A busy polkit needs more than 10 s, which
/// must not lead to the refusal of a stop.
const REPLY_TIMEOUT: Duration = Duration::from_secs(20);
/// Timeout if a user types a password.
const DIALOG_TIMEOUT: Duration = Duration::from_secs(120);

/// Result of a query.
#[derive(Debug)]
pub(super) enum Answer {
    Granted,
    Refused,
    /// There is no polkit on this bus.
    Absent,
    /// polkit gave no valid reply: counts as a refusal.
    Broken(String),
}

/// Queries whether the sender is authorised for an action. `interactive`: the caller allows a password dialog.
pub(super) async fn ask(
    connection: &Connection,
    sender: &UniqueName<'_>,
    action: &str,
    interactive: bool,
) -> Answer {
    let subject = (
        "system-bus-name",
        HashMap::from([("name", Variant::from(sender.as_str()))]),
    );
    let details: HashMap<&str, &str> = HashMap::new();
    let (flags, wait) = match interactive {
        true => (ASK_THE_USER, DIALOG_TIMEOUT),
        false => (0, REPLY_TIMEOUT),
    };
    let query = (subject, action, details, flags, "");
    let requested = connection.call_method(
        Some(SERVICE),
        PATH,
        Some(INTERFACE),
        "CheckAuthorization",
        &query,
    );
    match tokio::time::timeout(wait, requested).await {
        Ok(Ok(reply)) => {
            let body = reply.body();
            match body.deserialize::<(bool, bool, HashMap<String, String>)>() {
                Ok((true, _, _)) => Answer::Granted,
                Ok((false, _, _)) => Answer::Refused,
                Err(error) => Answer::Broken(error.to_string()),
            }
        }
        Ok(Err(error)) if is_absent(&error) => Answer::Absent,
        Ok(Err(error)) => Answer::Broken(error.to_string()),
        Err(_) => Answer::Broken(format!("within {} s", wait.as_secs())),
    }
}

/// Whether the bus reports that the name has no owner and cannot be activated.
fn is_absent(error: &zbus::Error) -> bool {
    let name = match error {
        zbus::Error::MethodError(name, _, _) => name.to_string(),
        zbus::Error::FDO(error) => error.name().to_string(),
        _ => return false,
    };
    matches!(
        name.as_str(),
        "org.freedesktop.DBus.Error.ServiceUnknown" | "org.freedesktop.DBus.Error.NameHasNoOwner"
    )
}
