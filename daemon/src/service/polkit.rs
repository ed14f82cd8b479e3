//! Asks polkit whether a caller of the system bus may do something. The caller is told by its unique name on that bus,
//! which nobody can take over while it is asked about.

use std::collections::HashMap;
use std::time::Duration;

use zbus::names::UniqueName;
use zbus::{Connection, DBusError, Variant};

const SERVICE: &str = "org.freedesktop.PolicyKit1";
const PATH: &str = "/org/freedesktop/PolicyKit1/Authority";
const INTERFACE: &str = "org.freedesktop.PolicyKit1.Authority";

/// `AllowUserInteraction`.
const ASK_THE_USER: u32 = 1;
/// For an answer that needs nobody; callers give up after 25 s by default.
const TO_ANSWER: Duration = Duration::from_secs(10);
/// For a person who types a password.
const TO_TYPE: Duration = Duration::from_secs(120);

/// What polkit says.
#[derive(Debug)]
pub(super) enum Answer {
    Granted,
    Refused,
    /// There is no polkit on this bus.
    Absent,
    /// There is one, and it gave no answer: as good as a refusal.
    Broken(String),
}

/// `interactive`: the caller said that its user may be asked for a password.
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
        true => (ASK_THE_USER, TO_TYPE),
        false => (0, TO_ANSWER),
    };
    let question = (subject, action, details, flags, "");
    let requested = connection.call_method(
        Some(SERVICE),
        PATH,
        Some(INTERFACE),
        "CheckAuthorization",
        &question,
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

/// Whether the bus says that nobody has the name, and nobody can be started for it.
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
