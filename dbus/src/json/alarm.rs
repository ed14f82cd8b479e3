use serde::Serialize;

use super::utc_of_ns;

/// An alarm: a line of `tactus alarms --json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Alarm {
    /// Its name.
    pub name: String,
    /// Whether it is one of the daemon's own.
    pub built_in: bool,
    /// How bad it is when active: `minor` or `major`.
    pub severity: String,
    /// `ok`, `minor`, `major` or `invalid`; `None` while its evaluation is suppressed.
    pub level: Option<String>,
    /// Whether it is active.
    pub active: bool,
    /// Whether its last activation was acknowledged.
    pub acknowledged: bool,
    /// Whether its condition is gone and it stays active until it is reset.
    pub held: bool,
    /// When it last became active or ended.
    pub changed: Option<String>,
    /// The same in ns since 1970 UTC, for a text in local time.
    #[serde(skip)]
    pub changed_ns: Option<i64>,
    /// Value and limit at the last time the limit was exceeded; the present ones while it is active.
    pub cause: Option<String>,
    /// Why it cannot be evaluated.
    pub invalid: Option<String>,
    /// Why its evaluation is suppressed at present.
    pub suppressed: Option<String>,
    /// By whom and why it is shelved.
    pub shelved: Option<String>,
    /// End of the shelving; `None` if the alarm is shelved until it ends.
    pub shelved_until: Option<String>,
    /// The same in ns since 1970 UTC.
    #[serde(skip)]
    pub shelved_until_ns: Option<i64>,
    /// By whom and why it is out of service.
    pub out_of_service: Option<String>,
    /// By whom and with which comment it was last acknowledged.
    pub acknowledged_by: Option<String>,
    /// What to do when it is active.
    pub guidance: Option<String>,
}

impl Alarm {
    /// Whether it is active, and neither shelved nor out of service.
    pub fn notifies(&self) -> bool {
        self.active && self.shelved.is_none() && self.out_of_service.is_none()
    }

    /// Whether a person should look at it: it notifies, is not acknowledged, or cannot be evaluated.
    pub fn matters(&self) -> bool {
        self.notifies() || !self.acknowledged || self.level.as_deref() == Some("invalid")
    }

    /// Its state, and the action of a user that it waits for, a few words each.
    pub fn standing(&self) -> Vec<String> {
        let mut words = vec![match (self.active, self.level.as_deref()) {
            (true, _) => format!("ACTIVE, {}", self.severity),
            (false, Some("invalid")) => "CANNOT BE JUDGED".to_owned(),
            (false, Some(level)) => level.to_owned(),
            (false, None) => "not judged now".to_owned(),
        }];
        if !self.acknowledged {
            words.push("not acknowledged".to_owned());
        }
        if self.held {
            words.push("waits for a reset".to_owned());
        }
        words
    }

    /// As [`Alarm::standing`], with who shelved it or took it out of service, in one line.
    pub fn words(&self) -> String {
        let mut words = self.standing();
        let aside = [
            ("shelved", &self.shelved),
            ("out of service", &self.out_of_service),
        ];
        for (name, by) in aside {
            words.extend(by.as_ref().map(|by| format!("{name} {by}")));
        }
        words.join(", ")
    }
}

impl From<crate::AlarmReport> for Alarm {
    fn from(reported: crate::AlarmReport) -> Self {
        Self {
            name: reported.name.unwrap_or_default(),
            built_in: reported.built_in.unwrap_or(false),
            severity: reported.severity.unwrap_or_default(),
            level: reported.level,
            active: reported.active.unwrap_or(false),
            // false if the daemon does not report it
            acknowledged: reported.acknowledged.unwrap_or(false),
            held: reported.held.unwrap_or(false),
            changed: reported.changed_ns.map(utc_of_ns),
            changed_ns: reported.changed_ns,
            cause: reported.cause,
            invalid: reported.invalid,
            suppressed: reported.suppressed,
            shelved: reported.shelved,
            shelved_until: reported.shelved_until_ns.map(utc_of_ns),
            shelved_until_ns: reported.shelved_until_ns,
            out_of_service: reported.out_of_service,
            acknowledged_by: reported.acknowledged_by,
            guidance: reported.guidance,
        }
    }
}
