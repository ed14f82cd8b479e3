//! The alarms that every daemon has: the problems of its health ([`Health::alarms`]).

use alarms::{Judgement, Rule, Severity};
use config::NotifySection;

use crate::monitoring::health::Health;
use Severity::{Major, Minor};

/// Time, s, for which a problem must be absent before its alarm ends.
const GONE_S: f64 = 60.0;

/// Kind and severity of each alarm, and whether it is notified.
const KINDS: [(&str, Severity, bool); 10] = [
    ("source-unverified", Major, true),
    ("faulted", Major, true),
    ("no-frame", Major, true),
    ("disk-days", Minor, true),
    ("relay-life", Minor, true),
    ("baseline-stale", Minor, true),
    // the daemon corrects these problems itself, or the alarms `faulted` and `no-frame` follow
    ("instrument", Minor, false),
    ("backlog", Minor, false),
    ("session", Minor, false),
    ("noise", Minor, false),
];

/// Whether a name is that of a built-in alarm.
pub(crate) fn has(name: &str) -> bool {
    KINDS.iter().any(|(kind, ..)| *kind == name)
}

/// The names of the built-in alarms whose beginning and end are notified.
pub(crate) fn notified() -> impl Iterator<Item = &'static str> {
    let of = KINDS.iter().filter(|(.., notified)| *notified);
    of.map(|(kind, ..)| *kind)
}

/// Whether an alarm is notified, built-in or of a rule.
pub(crate) fn is_notified(name: &str) -> bool {
    !has(name) || notified().any(|kind| kind == name)
}

/// The rules of all built-in alarms, which begin without delay.
pub(crate) fn rules() -> impl Iterator<Item = Rule> {
    KINDS.iter().map(|(kind, severity, _)| Rule {
        name: (*kind).to_owned(),
        severity: *severity,
        on_s: 0.0,
        off_s: GONE_S,
        latched: false,
    })
}

/// The judgement of each built-in alarm. A value that is beyond only the wider limits neither begins nor ends an alarm.
pub(crate) fn judgements(
    health: &Health,
    limits: &NotifySection,
) -> Vec<(&'static str, Judgement)> {
    let problems = health.alarms(limits);
    let lingering = health.alarms(&limits.wider());
    let judge = |kind: &'static str| {
        if let Some(problem) = problems.iter().find(|problem| problem.kind == kind) {
            return Judgement::Beyond(problem.text.clone());
        }
        match kind {
            _ if lingering.iter().any(|problem| problem.kind == kind) => Judgement::Deadband,
            // an unknown value does not end the alarm
            "disk-days" if health.space.free.is_none() => {
                Judgement::Suppressed("the free space of the record cannot be read".to_owned())
            }
            "disk-days" if health.session.is_some() && health.space.per_day.is_none() => {
                Judgement::Suppressed("the growth of the record is not known yet".to_owned())
            }
            "relay-life" if health.relays.is_none() => {
                Judgement::Suppressed("the wear of the relays has not been read".to_owned())
            }
            _ => Judgement::Within,
        }
    };
    KINDS
        .iter()
        .map(|(kind, ..)| (*kind, judge(kind)))
        .collect()
}
