//! The D-Bus interface of the daemon's alarms.

use std::sync::Arc;

use alarms::{Alarm, Order, Refused};
use chrono::DateTime;
use dbus::{AlarmReport, Fault, Options, ShelveOptions};
use rig::Clock;
use survey::nanoseconds;
use zbus::message::Header;
use zbus::{Connection, interface};

use crate::alarms::Shown;
use crate::monitoring::built_in;
use crate::service::gate::Gate;
use crate::session::controller::Controller;
use crate::session::option_values;

/// The alarms on one connection, and the gate of the connection.
pub(crate) struct Alarms1(pub(crate) Arc<Controller>, pub(crate) Arc<Gate>);

/// The daemon's alarms: its own problems and the rules of `[[alarm]]`.
#[interface(name = "org.tactus.Tactus1.Alarms1")]
impl Alarms1 {
    /// All alarms, by name. Keys: `name` (s), `built_in` (b), `severity` (s), `level` (s, `ok`, `minor`, `major`, or
    /// `invalid` if it cannot be evaluated; absent while its evaluation is suppressed), `active` (b), `acknowledged` (b), `held`
    /// (b, its condition is gone and it waits for a reset), `changed_ns` (x), `cause` (s), `invalid` (s), `suppressed` (s),
    /// `shelved` (s), `shelved_until_ns` (x), `out_of_service` (s), `acknowledged_by` (s), `guidance` (s).
    #[zbus(out_args("alarms"))]
    async fn list(&self) -> Vec<AlarmReport> {
        let shown = self.0.alarms.shown();
        let alarms = shown.alarms.iter();
        alarms.map(|alarm| report(alarm, &shown)).collect()
    }

    /// Records that somebody has seen the alarm. Options: `comment` (s).
    async fn acknowledge(
        &self,
        name: &str,
        options: Options,
        #[zbus(connection)] connection: &Connection,
        #[zbus(header)] header: Header<'_>,
    ) -> Result<(), Fault> {
        self.order(
            name,
            Order::Acknowledge,
            comment(&options)?,
            connection,
            &header,
        )
        .await
    }

    /// Shelves the alarm: no notifications for a time; it is still evaluated and recorded. Options: `for_s` (d; if absent, until the
    /// alarm ends), `comment` (s).
    async fn shelve(
        &self,
        name: &str,
        options: Options,
        #[zbus(connection)] connection: &Connection,
        #[zbus(header)] header: Header<'_>,
    ) -> Result<(), Fault> {
        let options: ShelveOptions = option_values::read(&options, |_| None)?;
        let order = options.for_s.map_or(Order::ShelveOnce, Order::Shelve);
        let comment = options.comment.unwrap_or_default();
        self.order(name, order, comment, connection, &header).await
    }

    /// Unshelves the alarm: it sends notifications again. Options: `comment` (s).
    async fn unshelve(
        &self,
        name: &str,
        options: Options,
        #[zbus(connection)] connection: &Connection,
        #[zbus(header)] header: Header<'_>,
    ) -> Result<(), Fault> {
        self.order(
            name,
            Order::Unshelve,
            comment(&options)?,
            connection,
            &header,
        )
        .await
    }

    /// Ends a latched alarm whose condition is gone. Options: `comment` (s).
    async fn reset(
        &self,
        name: &str,
        options: Options,
        #[zbus(connection)] connection: &Connection,
        #[zbus(header)] header: Header<'_>,
    ) -> Result<(), Fault> {
        self.order(name, Order::Reset, comment(&options)?, connection, &header)
            .await
    }

    /// Takes the alarm out of service (`false`) or returns it to service (`true`). Options: `comment` (s).
    async fn set_in_service(
        &self,
        name: &str,
        in_service: bool,
        options: Options,
        #[zbus(connection)] connection: &Connection,
        #[zbus(header)] header: Header<'_>,
    ) -> Result<(), Fault> {
        let order = match in_service {
            true => Order::InService,
            false => Order::OutOfService,
        };
        self.order(name, order, comment(&options)?, connection, &header)
            .await
    }
}

impl Alarms1 {
    async fn order(
        &self,
        name: &str,
        order: Order,
        comment: String,
        connection: &Connection,
        header: &Header<'_>,
    ) -> Result<(), Fault> {
        let by = self.1.caller_words(connection, header).await?;
        let at_s = imaging::tracking::seconds(self.0.runtime().clock.wall());
        let ordered = self.0.alarms.order(name, at_s, order, &by, &comment).await;
        let changes = ordered.map_err(|refused| match refused {
            Refused::NoAlarm { .. } | Refused::ShelfTime => {
                Fault::InvalidOption(refused.to_string())
            }
            _ => Fault::Failed(refused.to_string()),
        })?;
        self.0.report_changes(changes);
        Ok(())
    }
}

fn comment(options: &Options) -> Result<String, Fault> {
    options.only(&["comment"])?;
    let options: ShelveOptions = option_values::read(options, |_| None)?;
    Ok(options.comment.unwrap_or_default())
}

fn report(alarm: &Alarm, shown: &Shown) -> AlarmReport {
    let state = &alarm.state;
    let some = |text: &str| (!text.is_empty()).then(|| text.to_owned());
    let at_ns = |at_s: f64| DateTime::from_timestamp_millis((1e3 * at_s) as i64).map(nanoseconds);
    let rule = shown.rule(&alarm.rule.name);
    AlarmReport {
        name: Some(alarm.rule.name.clone()),
        built_in: Some(built_in::has(&alarm.rule.name)),
        severity: Some(alarm.rule.severity.word().to_owned()),
        level: alarm.level().map(|level| level.word().to_owned()),
        active: Some(state.active),
        acknowledged: Some(state.acknowledged),
        held: Some(state.held),
        changed_ns: state.changed_s.and_then(at_ns),
        cause: some(&state.cause),
        invalid: state.invalid.clone(),
        suppressed: state.suppressed.clone(),
        shelved: state.shelf.as_ref().map(|shelf| shelf.note.text()),
        shelved_until_ns: state.shelf.as_ref().and_then(|shelf| at_ns(shelf.until_s?)),
        out_of_service: state.out_of_service.as_ref().map(alarms::Note::text),
        acknowledged_by: state.acknowledgement.as_ref().map(alarms::Note::text),
        guidance: rule.and_then(|rule| some(&rule.guidance)),
    }
}
