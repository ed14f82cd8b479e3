//! The state of alarms, without clock, disk or bus: judgements and orders with their times go in, transitions come out.
//!
//! The properties of an alarm are independent of each other, as in OPC UA Part 9 (after ISA-18.2 and IEC 62682):
//! active, acknowledged, latched, shelved, suppressed, out of service. Severities are those of EPICS: minor, major, and
//! invalid for an alarm that cannot be judged. Invalid does not mean that all is well: it never ends an active alarm,
//! and an alarm that was not judged is never reported as [`Level::Ok`].
//!
//! Times are seconds of any clock that does not run backwards for long. They are stored with the state, so that the
//! state survives a restart.
//!
//! ```
//! use alarms::{Alarms, Judgement, Level, Order, Rule, Severity, TransitionKind};
//!
//! let rule = Rule { name: "heel".into(), severity: Severity::Major, on_s: 60.0, off_s: 60.0, latched: false };
//! let mut alarms = Alarms::default();
//! alarms.set_rules(vec![rule]);
//! let beyond = || Judgement::Beyond("ppi 9.1 kPa, above 8 kPa".into());
//! assert!(alarms.judge("heel", 0.0, beyond()).is_empty());
//! let begun = alarms.judge("heel", 60.0, beyond());
//! assert_eq!(begun[0].kind, TransitionKind::Active);
//! // no frame arrives, so that the condition cannot be judged: the alarm stays active
//! alarms.judge("heel", 70.0, Judgement::Unknown("no frame".into()));
//! assert_eq!(alarms.get("heel").unwrap().level(), Some(Level::Major));
//! alarms.order("heel", 80.0, &Order::Acknowledge, "user 1000", "turned")?;
//! assert!(alarms.get("heel").unwrap().state.acknowledged);
//! # Ok::<(), alarms::Refused>(())
//! ```

mod order;
mod state;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use order::{LONGEST_SHELF_S, Order, Refused};
pub use state::{AlarmState, Note, Shelf};

/// Severity of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    /// Somebody should look at it today.
    #[default]
    Minor,
    /// Somebody should look at it now.
    Major,
}

impl Severity {
    /// The word in configuration, tables and JSON.
    pub fn word(self) -> &'static str {
        Level::from(self).word()
    }
}

/// The present level of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Level {
    /// Judged, and not active.
    Ok,
    /// Active, of minor severity.
    Minor,
    /// Active, of major severity.
    Major,
    /// Not known to be active, and cannot be judged.
    Invalid,
}

impl Level {
    /// The word in tables and JSON.
    pub fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Minor => "minor",
            Self::Major => "major",
            Self::Invalid => "invalid",
        }
    }
}

impl From<Severity> for Level {
    fn from(severity: Severity) -> Self {
        match severity {
            Severity::Minor => Self::Minor,
            Severity::Major => Self::Major,
        }
    }
}

/// When an alarm becomes active and when it ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rule {
    /// Its name, different from that of any other alarm.
    pub name: String,
    /// How bad it is.
    pub severity: Severity,
    /// Time for which the condition must hold before the alarm is active, s.
    pub on_s: f64,
    /// Time for which the condition must be gone before the alarm ends, and for which the alarm must be judged before
    /// it counts as judged again, s.
    pub off_s: f64,
    /// Whether it stays active, once its condition is gone, until a person resets it.
    pub latched: bool,
}

/// The result of one evaluation of an alarm's condition.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Judgement {
    /// The condition holds; the text names value and limit.
    Beyond(String),
    /// The value is within the deadband, where an alarm neither begins nor ends.
    Deadband,
    /// The condition does not hold.
    Within,
    /// The condition cannot be judged; the text is the reason.
    Unknown(String),
    /// The condition is not to be judged at present; the text is the reason, for instance that no measurement runs.
    Suppressed(String),
}

/// Kind of a transition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TransitionKind {
    /// The alarm has become active.
    Active,
    /// Its condition is gone; it stays active until it is reset.
    Held,
    /// It has ended.
    Over,
    /// It cannot be judged any more.
    Invalid,
    /// It is judged again.
    Judged,
    /// A person acknowledged, shelved, reset or took it out of service, or the time of a shelf is over.
    Handled,
}

/// A change of one alarm, for the record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Transition {
    /// The alarm.
    pub alarm: String,
    /// What changed.
    pub kind: TransitionKind,
    /// Cause and value, without the alarm's name.
    pub text: String,
}

/// An alarm: its rule and its state.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// Its rule.
    pub rule: Rule,
    /// Whether the rule was removed from the configuration; the alarm is then kept until it is acknowledged.
    pub removed: bool,
    /// Its state.
    pub state: AlarmState,
}

impl Alarm {
    /// Its present level; `None` if it is not active and is not to be judged (suppressed, or out of service).
    pub fn level(&self) -> Option<Level> {
        self.state.level(self.rule.severity)
    }

    /// Whether it is active, not shelved and in service. The caller decides whether an alarm of this name notifies
    /// anybody at all.
    pub fn notifies(&self) -> bool {
        self.state.active && !self.is_put_aside()
    }

    /// Whether it cannot be judged, is not shelved and is in service.
    pub fn cannot_judge(&self) -> bool {
        self.state.invalid.is_some() && !self.is_put_aside()
    }

    /// The end of an alarm that is no longer kept because its rule was removed; `None` if it is not active.
    fn end_without_rule(&self) -> Option<Transition> {
        self.state.active.then(|| Transition {
            alarm: self.rule.name.clone(),
            kind: TransitionKind::Over,
            text: format!(
                "over: its rule is no longer in the configuration; it was: {}",
                self.state.cause
            ),
        })
    }

    /// Whether a person has shelved it or taken it out of service.
    pub fn is_put_aside(&self) -> bool {
        self.state.shelf.is_some() || self.state.out_of_service.is_some()
    }
}

/// All alarms, by name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Alarms(BTreeMap<String, Alarm>);

impl Alarms {
    /// Replaces all rules. The state of a rule with the same name is kept; an alarm without a rule stays until it is
    /// acknowledged. Returns the ends of active alarms that are acknowledged already.
    pub fn set_rules(&mut self, rules: Vec<Rule>) -> Vec<Transition> {
        for alarm in self.0.values_mut() {
            alarm.removed = true;
        }
        for rule in rules {
            match self.0.get_mut(&rule.name) {
                Some(alarm) => {
                    alarm.removed = false;
                    alarm.rule = rule;
                }
                None => {
                    let alarm = Alarm {
                        rule: rule.clone(),
                        removed: false,
                        state: AlarmState::default(),
                    };
                    self.0.insert(rule.name, alarm);
                }
            }
        }
        for alarm in self.0.values_mut().filter(|alarm| alarm.removed) {
            alarm
                .state
                .forget_condition("its rule is no longer in the configuration");
        }
        let mut ends = Vec::new();
        self.0.retain(|_, alarm| {
            let kept = !alarm.removed || !alarm.state.acknowledged;
            if !kept {
                ends.extend(alarm.end_without_rule());
            }
            kept
        });
        ends
    }

    /// Continues with a stored state after a restart. The conditions were not followed meanwhile, so that no time
    /// before now counts towards the end of an alarm.
    pub fn restarted(&mut self) {
        for alarm in self.0.values_mut() {
            alarm
                .state
                .forget_condition("it has not been judged since the restart");
        }
    }

    /// Applies a judgement, made at `at_s` (s), to the alarm `name`; returns its transitions. An unknown name changes
    /// nothing.
    pub fn judge(&mut self, name: &str, at_s: f64, judgement: Judgement) -> Vec<Transition> {
        let Some(alarm) = self.0.get_mut(name).filter(|alarm| !alarm.removed) else {
            return Vec::new();
        };
        let mut transitions = Vec::new();
        alarm.state.expire(&alarm.rule, at_s, &mut transitions);
        alarm
            .state
            .judge(&alarm.rule, at_s, judgement, &mut transitions);
        transitions
    }

    /// Carries out an order of a person. `by`: who; `comment`: free text. Acknowledging an active alarm whose rule was
    /// removed also ends it.
    ///
    /// # Errors
    /// There is no such alarm, or its state does not allow the order.
    pub fn order(
        &mut self,
        name: &str,
        at_s: f64,
        order: &Order,
        by: &str,
        comment: &str,
    ) -> Result<Vec<Transition>, Refused> {
        let Some(alarm) = self.0.get_mut(name) else {
            return Err(Refused::NoAlarm {
                name: name.to_owned(),
                known: self.0.keys().cloned().collect(),
            });
        };
        let note = Note {
            by: by.to_owned(),
            comment: comment.to_owned(),
            at_s,
        };
        let text = alarm.state.order(&alarm.rule, order, note)?;
        let mut transitions = vec![Transition {
            alarm: name.to_owned(),
            kind: TransitionKind::Handled,
            text,
        }];
        if alarm.removed && alarm.state.acknowledged {
            transitions.extend(alarm.end_without_rule());
            self.0.remove(name);
        }
        Ok(transitions)
    }

    /// The alarm with this name.
    pub fn get(&self, name: &str) -> Option<&Alarm> {
        self.0.get(name)
    }

    /// All alarms, by name.
    pub fn iter(&self) -> impl Iterator<Item = &Alarm> {
        self.0.values()
    }
}
