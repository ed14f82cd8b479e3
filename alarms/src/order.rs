//! Orders that persons give about alarms.

use crate::Rule;
use crate::state::{AlarmState, Note, Shelf};

/// Longest time for which an alarm can be shelved, s. For longer it must be taken out of service, which every status
/// shows.
pub const LONGEST_SHELF_S: f64 = 86_400.0;

/// An order of a person about an alarm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// A person has seen the alarm.
    Acknowledge,
    /// The alarm notifies nobody for this time, s; at most [`LONGEST_SHELF_S`].
    Shelve(f64),
    /// The alarm notifies nobody until it ends.
    ShelveOnce,
    /// The alarm is not shelved any more, and notifies again.
    Unshelve,
    /// Ends a latched alarm whose condition is gone.
    Reset,
    /// The alarm notifies nobody until it is in service again.
    OutOfService,
    /// The alarm is in service again.
    InService,
}

/// Why an order is not carried out.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refused {
    /// No alarm has this name.
    #[error("there is no alarm '{name}'; there are: {}", .known.join(", "))]
    NoAlarm {
        /// The name.
        name: String,
        /// All names.
        known: Vec<String>,
    },
    /// It is acknowledged already.
    #[error("alarm '{0}' has nothing to acknowledge")]
    Acknowledged(String),
    /// The time is not above 0, or is too long.
    #[error(
        "an alarm can be shelved for {:.0} h at most, and more than 0 s; take it out of service for longer",
        LONGEST_SHELF_S / 3600.0
    )]
    ShelfTime,
    /// It is not active: it has no end until which it could be shelved.
    #[error("alarm '{0}' is not active: state for how long it is shelved")]
    NotActive(String),
    /// It is not shelved.
    #[error("alarm '{0}' is not shelved")]
    NotShelved(String),
    /// There is nothing to reset: the alarm is not active, or is not latched.
    #[error(
        "alarm '{0}' has nothing to reset: it is not active, or ends by itself when its condition is gone"
    )]
    NotLatched(String),
    /// The condition still holds, or is not known to be gone.
    #[error("alarm '{0}' is not reset: its condition is not known to be gone ({1})")]
    StillBeyond(String, String),
    /// It is out of service already.
    #[error("alarm '{0}' is out of service already")]
    OutOfService(String),
    /// It is in service.
    #[error("alarm '{0}' is in service")]
    InService(String),
}

impl AlarmState {
    /// Carries out an order, and returns what was done, for the record.
    pub(crate) fn order(
        &mut self,
        rule: &Rule,
        order: &Order,
        note: Note,
    ) -> Result<String, Refused> {
        let name = || rule.name.clone();
        let (at_s, by) = (note.at_s, note.text());
        let done = match order {
            Order::Acknowledge if self.acknowledged => {
                return Err(Refused::Acknowledged(name()));
            }
            Order::Acknowledge => {
                self.acknowledge(note);
                "acknowledged".to_owned()
            }
            Order::Shelve(time_s) if !(*time_s > 0.0 && *time_s <= LONGEST_SHELF_S) => {
                return Err(Refused::ShelfTime);
            }
            Order::Shelve(time_s) => {
                let until_s = Some(at_s + time_s);
                self.shelf = Some(Shelf { until_s, note });
                format!("shelved for {time_s:.0} s")
            }
            Order::ShelveOnce if !self.active => return Err(Refused::NotActive(name())),
            Order::ShelveOnce => {
                let until_s = None;
                self.shelf = Some(Shelf { until_s, note });
                "shelved until it ends".to_owned()
            }
            Order::Unshelve => match self.shelf.take() {
                Some(_) => "not shelved any more".to_owned(),
                None => return Err(Refused::NotShelved(name())),
            },
            Order::Reset if self.held => {
                self.end(at_s);
                "reset".to_owned()
            }
            Order::Reset if self.active && rule.latched => {
                return Err(Refused::StillBeyond(name(), self.cause.clone()));
            }
            Order::Reset => return Err(Refused::NotLatched(name())),
            Order::OutOfService if self.out_of_service.is_some() => {
                return Err(Refused::OutOfService(name()));
            }
            Order::OutOfService => {
                self.out_of_service = Some(note);
                "taken out of service".to_owned()
            }
            Order::InService => match self.out_of_service.take() {
                Some(_) => "in service again".to_owned(),
                None => return Err(Refused::InService(name())),
            },
        };
        Ok(format!("{done} {by}"))
    }
}
