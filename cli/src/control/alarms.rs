//! `tactus alarms`: lists alarms that are active, not acknowledged or cannot be judged; and gives the orders of a
//! person.

use std::io::Write;

use chrono::DateTime;
use dbus::Options;
use dbus::json::Alarm;

use crate::args::{AlarmOrder, AlarmsCommand};
use crate::connection::Daemon;
use crate::failure::Failure;
use crate::output::Printer;
use crate::output::table::columns;
use crate::output::time::local;

/// Whether the alarm is listed without `--all`.
fn is_listed(alarm: &Alarm) -> bool {
    let aside = alarm.shelved.is_some() || alarm.out_of_service.is_some();
    let invalid = alarm.level.as_deref() == Some("invalid");
    alarm.active || !alarm.acknowledged || aside || invalid
}

/// The state as text.
fn state(alarm: &Alarm) -> String {
    let mut words = alarm.standing();
    if let Some(by) = &alarm.shelved {
        words.push(match alarm.shelved_until_ns {
            Some(ns) => format!(
                "shelved until {} {by}",
                local(DateTime::from_timestamp_nanos(ns))
            ),
            None => format!("shelved until it ends {by}"),
        });
    }
    if let Some(by) = &alarm.out_of_service {
        words.push(format!("out of service {by}"));
    }
    words.join(", ")
}

fn row(alarm: &Alarm) -> [String; 4] {
    let changed = alarm
        .changed_ns
        .map(|ns| local(DateTime::from_timestamp_nanos(ns)));
    let why = match (alarm.active, &alarm.invalid, &alarm.suppressed) {
        (false, Some(why), _) | (false, None, Some(why)) => Some(why.clone()),
        _ => alarm.cause.clone(),
    };
    let mut text = why.unwrap_or_default();
    if let Some(guidance) = alarm.guidance.as_ref().filter(|_| alarm.active) {
        text = format!("{text}. {guidance}");
    }
    [
        alarm.name.clone(),
        state(alarm),
        changed.unwrap_or_default(),
        text,
    ]
}

/// Lists the alarms, or carries out an order.
///
/// # Errors
/// [`Failure::Failed`] if an alarm is active, after all were printed; a refusal of the daemon.
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
        let of = listed.iter().find(|alarm| alarm.name == order.name());
        return match of {
            Some(alarm) => {
                printer.record(alarm, |alarm| format!("{}: {}", alarm.name, state(alarm)))
            }
            None => printer.text(&format!("{}: this alarm no longer exists", order.name())),
        };
    }
    print(&listed, requested.all, printer)?;
    let raised: Vec<&str> = listed
        .iter()
        .filter(|alarm| alarm.notifies())
        .map(|alarm| alarm.name.as_str())
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
        .filter(|alarm| all || is_listed(alarm))
        .map(row)
        .collect();
    if shown.is_empty() {
        let judged = listed.iter().filter(|alarm| alarm.level.is_some()).count();
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
    if let AlarmOrder::Shelve {
        span: Some(span), ..
    } = order
    {
        options = options.with("for_s", span.as_secs_f64());
    }
    let (name, options) = (order.name(), &options);
    let carried_out = async {
        match order {
            AlarmOrder::Ack(_) => alarms.acknowledge(name, options).await,
            AlarmOrder::Shelve { .. } => alarms.shelve(name, options).await,
            AlarmOrder::Unshelve(_) => alarms.unshelve(name, options).await,
            AlarmOrder::Reset(_) => alarms.reset(name, options).await,
            AlarmOrder::OutOfService(_) => alarms.set_in_service(name, false, options).await,
            AlarmOrder::InService(_) => alarms.set_in_service(name, true, options).await,
        }
    };
    daemon.ask("the alarm", carried_out).await
}

#[cfg(test)]
mod tests {
    use dbus::AlarmReport;

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
        assert!(!alarm.notifies() && is_listed(&alarm));
        assert!(state(&alarm).ends_with("shelved until it ends by user 1000: known"));
        assert!(Alarm::from(reported("heel", Some("major"))).notifies());
    }
}
