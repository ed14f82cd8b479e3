use serde::Serialize;

use super::utc_of_ns;

/// An alarm: a line of `tactus alarms --json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alarm {
    /// Its name.
    pub name: String,
    /// Whether it is one of the daemon's own.
    pub built_in: bool,
    /// How bad it is when active: `minor` or `major`.
    pub severity: String,
    /// `ok`, `minor`, `major` or `invalid`; `None` while it is not to be judged.
    pub level: Option<String>,
    /// Whether it is active.
    pub active: bool,
    /// Whether its last activation was acknowledged.
    pub acknowledged: bool,
    /// Whether its condition is gone and it stays active until it is reset.
    pub held: bool,
    /// When it last became active or ended.
    pub changed: Option<String>,
    /// Value and limit at the last time the limit was exceeded; the present ones while it is active.
    pub cause: Option<String>,
    /// Why it cannot be judged.
    pub invalid: Option<String>,
    /// Why it is not to be judged at present.
    pub suppressed: Option<String>,
    /// By whom and why it is shelved.
    pub shelved: Option<String>,
    /// Until when it is shelved; `None` if until it ends.
    pub shelved_until: Option<String>,
    /// By whom and why it is out of service.
    pub out_of_service: Option<String>,
    /// By whom and with which comment it was last acknowledged.
    pub acknowledged_by: Option<String>,
    /// What to do when it is active.
    pub guidance: Option<String>,
}

impl From<crate::AlarmReport> for Alarm {
    fn from(reported: crate::AlarmReport) -> Self {
        Self {
            name: reported.name.unwrap_or_default(),
            built_in: reported.built_in.unwrap_or(false),
            severity: reported.severity.unwrap_or_default(),
            level: reported.level,
            active: reported.active.unwrap_or(false),
            // of a daemon that does not report it nothing is claimed
            acknowledged: reported.acknowledged.unwrap_or(false),
            held: reported.held.unwrap_or(false),
            changed: reported.changed_ns.map(utc_of_ns),
            cause: reported.cause,
            invalid: reported.invalid,
            suppressed: reported.suppressed,
            shelved: reported.shelved,
            shelved_until: reported.shelved_until_ns.map(utc_of_ns),
            out_of_service: reported.out_of_service,
            acknowledged_by: reported.acknowledged_by,
            guidance: reported.guidance,
        }
    }
}
