//! The interface of the daemon's alarms.

use zbus::{DeserializeDict, SerializeDict, Type};

use crate::Fault;

/// `org.tactus.Tactus1.Alarms1` on the root object.
#[zbus::proxy(
    interface = "org.tactus.Tactus1.Alarms1",
    default_service = "org.tactus.Tactus1",
    default_path = "/org/tactus/Tactus1"
)]
pub trait Alarms1 {
    /// All alarms, by name: the daemon's own and those of `[[alarm]]`.
    fn list(&self) -> Result<Vec<AlarmReport>, Fault>;

    /// Acknowledges an alarm (options: `comment`).
    fn acknowledge<O>(&self, name: &str, options: &O) -> Result<(), Fault>
    where
        O: Sync;

    /// Shelves an alarm: no notifications for a time, or until it ends (options: [`crate::ShelveOptions`]).
    fn shelve<O>(&self, name: &str, options: &O) -> Result<(), Fault>
    where
        O: Sync;

    /// Unshelves an alarm: it sends notifications again (options: `comment`).
    fn unshelve<O>(&self, name: &str, options: &O) -> Result<(), Fault>
    where
        O: Sync;

    /// Ends a latched alarm whose condition is gone (options: `comment`).
    fn reset<O>(&self, name: &str, options: &O) -> Result<(), Fault>
    where
        O: Sync;

    /// Takes it out of service, or into service again (options: `comment`).
    fn set_in_service<O>(&self, name: &str, in_service: bool, options: &O) -> Result<(), Fault>
    where
        O: Sync;
}

/// One alarm (`a{sv}`).
#[derive(Debug, Clone, Default, PartialEq, SerializeDict, DeserializeDict, Type)]
#[zbus(signature = "a{sv}")]
pub struct AlarmReport {
    /// Its name.
    pub name: Option<String>,
    /// Whether it is one of the daemon's own.
    pub built_in: Option<bool>,
    /// How bad it is when active: `minor` or `major`.
    pub severity: Option<String>,
    /// Present level: `ok`, `minor`, `major`, or `invalid` if it cannot be evaluated; absent while its evaluation is
    /// suppressed.
    pub level: Option<String>,
    /// Whether it is active.
    pub active: Option<bool>,
    /// Whether its last activation was acknowledged.
    pub acknowledged: Option<bool>,
    /// Whether its condition is gone and it stays active until it is reset.
    pub held: Option<bool>,
    /// When it last became active or ended, ns since 1970 UTC.
    pub changed_ns: Option<i64>,
    /// Value and limit at the last time the limit was exceeded; the present ones while it is active.
    pub cause: Option<String>,
    /// Why it cannot be evaluated.
    pub invalid: Option<String>,
    /// Why its evaluation is suppressed at present.
    pub suppressed: Option<String>,
    /// By whom and why it is shelved.
    pub shelved: Option<String>,
    /// End of the shelving, ns since 1970 UTC; absent if the alarm is shelved until it ends.
    pub shelved_until_ns: Option<i64>,
    /// By whom and why it is out of service.
    pub out_of_service: Option<String>,
    /// By whom and with which comment it was last acknowledged.
    pub acknowledged_by: Option<String>,
    /// What to do when it is active.
    pub guidance: Option<String>,
}
