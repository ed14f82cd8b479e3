//! `tactus alarms`: what is active, what nobody has acknowledged, what cannot be judged; and the orders of a person.

use std::io::Write;

use chrono::DateTime;
use dbus::{AlarmReport, Options};
use serde::Serialize;
use web::AlarmState;

use crate::args::{AlarmOrder, AlarmsCommand};
use crate::connection::Daemon;
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::table::columns;
use crate::output::time::local;

/// An alarm, and what only people read of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Alarm {
    #[serde(flatten)]
    line: dbus::json::Alarm,
    /// The same as the page and the dashboard see it.
    #[serde(skip)]
    seen: AlarmState,
    #[serde(skip)]
    changed_ns: Option<i64>,
    #[serde(skip)]
    shelved_until_ns: Option<i64>,
}

impl From<AlarmReport> for Alarm {
    fn from(reported: AlarmReport) -> Self {
        Self {
            seen: AlarmState::from(reported.clone()),
            changed_ns: reported.changed_ns,
            shelved_until_ns: reported.shelved_until_ns,
            line: reported.into(),
        }
    }
}

impl Alarm {
    /// Whether a person should see it without `--all`.
    fn matters(&self) -> bool {
        let aside = self.line.shelved.is_some() || self.line.out_of_service.is_some();
        let invalid = self.line.level.as_deref() == Some("invalid");
        self.line.active || !self.line.acknowledged || aside || invalid
    }

    /// The state in a few words.
    fn state(&self) -> String {
        let mut words = self.seen.standing();
        if let Some(by) = &self.line.shelved {
            words.push(match self.shelved_until_ns {
                Some(ns) => format!(
                    "shelved until {} {by}",
                    local(DateTime::from_timestamp_nanos(ns))
                ),
                None => format!("shelved until it ends {by}"),
            });
        }
        if let Some(by) = &self.line.out_of_service {
            words.push(format!("out of service {by}"));
        }
        words.join(", ")
    }

    fn row(&self) -> [String; 4] {
        let changed = self
            .changed_ns
            .map(|ns| local(DateTime::from_timestamp_nanos(ns)));
        let why = match (self.line.active, &self.line.invalid, &self.line.suppressed) {
            (false, Some(why), _) | (false, None, Some(why)) => Some(why.clone()),
            _ => self.line.cause.clone(),
        };
        let mut text = why.unwrap_or_default();
        if let Some(guidance) = self.line.guidance.as_ref().filter(|_| self.line.active) {
            text = format!("{text}. {guidance}");
        }
        [
            self.line.name.clone(),
            self.state(),
            changed.unwrap_or_default(),
            text,
        ]
    }
}

/// Lists the alarms, or carries out an order.
///
/// # Errors
/// [`Failure::Failed`] where an alarm is active, after all were printed; the daemon refuses the order.
pub(crate) async fn run(
    daemon: &Daemon,
    requested: &AlarmsCommand,
    printer: &mut Printer<impl Write>,
) -> Result<(), Failure> {
    let alarms = daemon.alarms().await?;
    if let Some(order) = &requested.order {
        carry_out(daemon, &alarms, order).await?;
    }
    let listed = daemon.ask("the alarms", alarms.list()).await?;
    let listed: Vec<Alarm> = listed.into_iter().map(Alarm::from).collect();
    if let Some(order) = &requested.order {
        let of = listed.iter().find(|alarm| alarm.line.name == order.name());
        return match of {
            Some(alarm) => printer.record(alarm, |alarm| {
                format!("{}: {}", alarm.line.name, alarm.state())
            }),
            None => printer.text(&format!("{}: is gone", order.name())),
        };
    }
    print(&listed, requested.all, printer)?;
    let raised: Vec<&str> = listed
        .iter()
        .filter(|alarm| alarm.seen.notifies())
        .map(|alarm| alarm.line.name.as_str())
        .collect();
    match raised.len() {
        0 => Ok(()),
        1 => Err(Failure::Failed(format!("alarm {} is active", raised[0]))),
        number => Err(Failure::Failed(format!(
            "{number} alarms are active: {}",
            raised.join(", ")
        ))),
    }
}

fn print(listed: &[Alarm], all: bool, printer: &mut Printer<impl Write>) -> Result<(), Failure> {
    if printer.is_json() {
        for alarm in listed {
            printer.record(alarm, |_| String::new())?;
        }
        return Ok(());
    }
    let shown: Vec<[String; 4]> = listed
        .iter()
        .filter(|alarm| all || alarm.matters())
        .map(Alarm::row)
        .collect();
    if shown.is_empty() {
        let judged = listed
            .iter()
            .filter(|alarm| alarm.line.level.is_some())
            .count();
        return printer.text(&format!(
            "no alarm is active or waits to be acknowledged; {judged} of {} are judged now (--all lists them)",
            listed.len()
        ));
    }
    let table = columns(["ALARM", "STATE", "SINCE", "CAUSE"], &shown);
    printer.text(table.trim_end())
}

async fn carry_out(
    daemon: &Daemon,
    alarms: &dbus::Alarms1Proxy<'static>,
    order: &AlarmOrder,
) -> Result<(), Failure> {
    let mut options = Options::new();
    if let Some(comment) = order.comment() {
        options = options.with("comment", comment);
    }
    let name = order.name();
    match order {
        AlarmOrder::Ack(_) => {
            daemon
                .ask("the alarm", alarms.acknowledge(name, &options))
                .await
        }
        AlarmOrder::Shelve { span, .. } => {
            if let Some(span) = span {
                options = options.with("for_s", span.as_secs_f64());
            }
            daemon.ask("the alarm", alarms.shelve(name, &options)).await
        }
        AlarmOrder::Unshelve(_) => {
            daemon
                .ask("the alarm", alarms.unshelve(name, &options))
                .await
        }
        AlarmOrder::Reset(_) => daemon.ask("the alarm", alarms.reset(name, &options)).await,
        AlarmOrder::OutOfService(_) => {
            let set = alarms.set_in_service(name, false, &options);
            daemon.ask("the alarm", set).await
        }
        AlarmOrder::InService(_) => {
            let set = alarms.set_in_service(name, true, &options);
            daemon.ask("the alarm", set).await
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::control::alarms::*;

    fn reported(name: &str, level: Option<&str>) -> AlarmReport {
        AlarmReport {
            name: Some(name.to_owned()),
            built_in: Some(false),
            severity: Some("major".to_owned()),
            level: level.map(str::to_owned),
            active: Some(level == Some("major")),
            acknowledged: Some(level != Some("major")),
            held: Some(false),
            cause: Some("ppi 9.1 kPa, above 8 kPa".to_owned()),
            guidance: Some("turn".to_owned()),
            ..AlarmReport::default()
        }
    }

    fn printed(reports: &[AlarmReport], all: bool) -> String {
        let listed: Vec<Alarm> = reports.iter().cloned().map(Alarm::from).collect();
        let mut printer = Printer::into(false, Vec::new());
        print(&listed, all, &mut printer).unwrap();
        String::from_utf8(printer.sink()).unwrap()
    }

    #[test]
    fn what_matters_is_listed_and_nothing_else() {
        let well = reported("seat", Some("ok"));
        let heel = reported("heel", Some("major"));
        let invalid = AlarmReport {
            invalid: Some("no map has come for 20 s".to_owned()),
            ..reported("hip", Some("invalid"))
        };
        let text = printed(&[well.clone(), heel, invalid], false);
        for wanted in [
            "heel   ACTIVE, major, not acknowledged",
            "ppi 9.1 kPa, above 8 kPa. turn",
            "hip    CANNOT BE JUDGED",
            "no map has come for 20 s",
        ] {
            assert!(text.contains(wanted), "{wanted}\n{text}");
        }
        assert!(!text.contains("seat"), "{text}");
        let text = printed(&[well.clone(), reported("idle", None)], false);
        assert!(text.contains("1 of 2 are judged now"), "{text}");
        assert!(printed(&[well], true).contains("seat   ok"));
    }

    #[test]
    fn a_shelved_alarm_does_not_call() {
        let shelved = AlarmReport {
            shelved: Some("by user 1000: known".to_owned()),
            ..reported("heel", Some("major"))
        };
        let alarm = Alarm::from(shelved);
        assert!(!alarm.seen.notifies() && alarm.matters());
        assert!(
            alarm
                .state()
                .ends_with("shelved until it ends by user 1000: known")
        );
        assert!(Alarm::from(reported("heel", Some("major"))).seen.notifies());
    }
}
