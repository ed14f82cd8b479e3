//! The errors of the D-Bus contract: one error name for each kind.

use std::fmt;

/// An error of the daemon. The text is for people and states what to do; the name (`org.tactus.Tactus1.Error.` and
/// the variant) is for programs.
#[derive(Debug, zbus::DBusError)]
#[zbus(prefix = "org.tactus.Tactus1.Error", impl_display = false)]
pub enum Fault {
    /// A session is running; stop it first.
    SessionActive(String),
    /// No session is running, or none has this id.
    NoSession(String),
    /// No baseline has been recorded, or the named session has none; for a name without a session see
    /// [`Fault::NoSession`].
    NoBaseline(String),
    /// The baseline was recorded with other settings, or with another kind of rig.
    BaselineMismatch(String),
    /// The model is for another survey or geometry.
    ModelMismatch(String),
    /// The model file cannot be read.
    ModelFile(String),
    /// An instrument failed, is missing, or could not be made safe.
    InstrumentFault(String),
    /// The recording cannot be read.
    RecordingFault(String),
    /// Writing to the disk failed; the source is off.
    DiskRefused(String),
    /// The caller may not do this.
    NotAuthorized(String),
    /// The limit of simultaneous objects or calls is reached, for the caller or in total.
    LimitsExceeded(String),
    /// An option that does not exist, has the wrong type, or a value out of range.
    InvalidOption(String),
    /// No frame or map yet.
    NoFrame(String),
    /// The configuration has problems; the text is a line for each, with file, line and column.
    Configuration(String),
    /// The rig or the model does not support this (such as stepping a session that has a schedule, or pressure with a
    /// method that is not calibrated).
    Unsupported(String),
    /// Any other error; the text is the only information.
    Failed(String),
    /// The connection failed, or the error has another name.
    #[zbus(error)]
    Connection(zbus::Error),
}

impl Fault {
    /// The text without the error's name.
    pub fn text(&self) -> String {
        match self {
            Self::Connection(zbus::Error::MethodError(_, Some(text), _)) => text.clone(),
            Self::Connection(cause) => cause.to_string(),
            other => zbus::DBusError::description(other)
                .unwrap_or_default()
                .to_owned(),
        }
    }

    /// A reply; `None` if the daemon has no data: no frame or map yet, a session that no longer exists, an interface
    /// that this daemon does not implement.
    ///
    /// # Errors
    /// Every other error. A reply that cannot be decoded is an error too, because it does not mean that there are no
    /// data.
    pub fn available<T>(reply: Result<T, Self>) -> Result<Option<T>, Self> {
        match reply {
            Ok(reply) => Ok(Some(reply)),
            Err(fault) if fault.is_absence() => Ok(None),
            Err(fault) => Err(fault),
        }
    }

    fn is_absence(&self) -> bool {
        match self {
            Self::NoFrame(_) | Self::NoSession(_) | Self::Unsupported(_) => true,
            Self::Connection(zbus::Error::MethodError(name, _, _)) => matches!(
                name.as_str(),
                "org.freedesktop.DBus.Error.UnknownObject"
                    | "org.freedesktop.DBus.Error.UnknownInterface"
                    | "org.freedesktop.DBus.Error.UnknownMethod"
            ),
            _ => false,
        }
    }

    /// Whether the daemon could not be reached, or disconnected during the call.
    pub fn is_connection(&self) -> bool {
        match self {
            Self::Connection(zbus::Error::MethodError(name, _, _)) => matches!(
                name.as_str(),
                "org.freedesktop.DBus.Error.ServiceUnknown"
                    | "org.freedesktop.DBus.Error.NameHasNoOwner"
                    | "org.freedesktop.DBus.Error.NoReply"
                    | "org.freedesktop.DBus.Error.Disconnected"
            ),
            Self::Connection(_) => true,
            _ => false,
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_its_name_and_keeps_its_text() {
        let fault = Fault::BaselineMismatch("current 1 mA against 2 mA".into());
        assert_eq!(
            zbus::DBusError::name(&fault).as_str(),
            "org.tactus.Tactus1.Error.BaselineMismatch"
        );
        assert_eq!(fault.to_string(), "current 1 mA against 2 mA");
        assert!(!fault.is_connection());
        assert!(Fault::Connection(zbus::Error::InterfaceNotFound).is_connection());
    }

    #[test]
    fn only_a_reply_that_names_an_absence_is_none() {
        let none = Fault::NoFrame("the session has no map yet".into());
        assert!(matches!(Fault::available::<()>(Err(none)), Ok(None)));
        let unreadable = Fault::Connection(zbus::Error::IncorrectEndian);
        assert!(Fault::available::<()>(Err(unreadable)).is_err());
        let refused = Fault::LimitsExceeded("16 calls wait".into());
        assert!(Fault::available::<()>(Err(refused)).is_err());
        assert!(matches!(Fault::available(Ok(7)), Ok(Some(7))));
    }
}
