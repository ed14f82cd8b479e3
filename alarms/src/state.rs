//! The state of one alarm, and how judgements change it.

use serde::{Deserialize, Serialize};

use crate::{Judgement, Level, Rule, Severity, Transition, TransitionKind};

/// Largest correction of the clock that does not end a shelving, s.
const CLOCK_TOLERANCE_S: f64 = 60.0;

/// What a person did, and when.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Note {
    /// The person.
    pub by: String,
    /// Free text, may be empty.
    pub comment: String,
    /// When, s.
    pub at_s: f64,
}

impl Note {
    /// The note as `by user 1000: comment`, without the colon if there is no comment.
    pub fn text(&self) -> String {
        match self.comment.as_str() {
            "" => format!("by {}", self.by),
            comment => format!("by {}: {comment}", self.by),
        }
    }
}

/// The shelving of an alarm: it notifies nobody, but is still judged and recorded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shelf {
    /// Until when, s; `None` until the alarm ends.
    pub until_s: Option<f64>,
    /// Who, and why.
    pub note: Note,
}

/// The properties of one alarm, independent of each other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AlarmState {
    /// Whether the alarm is active: its condition held for `on_s`, and since then has not been gone for `off_s`, or a
    /// latch holds the alarm.
    pub active: bool,
    /// Whether the condition of the active alarm is gone, and only a reset ends the alarm.
    pub held: bool,
    /// Whether a person has acknowledged the last activation; true before the first one.
    pub acknowledged: bool,
    /// The last acknowledgement.
    pub acknowledgement: Option<Note>,
    /// When it last became active or ended, s.
    pub changed_s: Option<f64>,
    /// Value and limit at the last judgement that was beyond the limit. Empty before the first activation.
    pub cause: String,
    /// Why it cannot be judged; `None` while it is judged, or is not to be judged.
    pub invalid: Option<String>,
    /// Why it is not to be judged at present.
    pub suppressed: Option<String>,
    /// Since when the condition has held (not active) or has been gone (active), s.
    pending_s: Option<f64>,
    /// Since when it has been judged without a break, while `invalid` is still reported, s.
    judged_s: Option<f64>,
    /// Whether it has not been judged since the start or a change of its rule.
    fresh: bool,
    /// Who has shelved it, and until when.
    pub shelf: Option<Shelf>,
    /// Who has taken it out of service.
    pub out_of_service: Option<Note>,
}

impl Default for AlarmState {
    /// Not judged yet.
    fn default() -> Self {
        Self {
            active: false,
            held: false,
            acknowledged: true,
            acknowledgement: None,
            changed_s: None,
            cause: String::new(),
            invalid: Some("it has not been judged yet".to_owned()),
            suppressed: None,
            pending_s: None,
            judged_s: None,
            fresh: true,
            shelf: None,
            out_of_service: None,
        }
    }
}

impl AlarmState {
    pub(crate) fn level(&self, severity: Severity) -> Option<Level> {
        match (self.active, &self.invalid) {
            (true, _) => Some(severity.into()),
            (false, _) if self.out_of_service.is_some() || self.suppressed.is_some() => None,
            (false, Some(_)) => Some(Level::Invalid),
            (false, None) => Some(Level::Ok),
        }
    }

    pub(crate) fn judge(
        &mut self,
        rule: &Rule,
        at_s: f64,
        judgement: Judgement,
        transitions: &mut Vec<Transition>,
    ) {
        let mut changed = |kind, text: String| {
            transitions.push(Transition {
                alarm: rule.name.clone(),
                kind,
                text,
            });
        };
        let fresh = std::mem::take(&mut self.fresh);
        match &judgement {
            Judgement::Suppressed(why) => {
                (self.suppressed, self.invalid) = (Some(why.clone()), None);
                (self.pending_s, self.judged_s) = (None, None);
                return;
            }
            Judgement::Unknown(why) => {
                if self.invalid.is_none() || fresh {
                    changed(TransitionKind::Invalid, format!("cannot be judged: {why}"));
                }
                self.invalid = Some(why.clone());
                (self.suppressed, self.judged_s) = (None, None);
                // unknown data do not count towards the end of an active alarm, and do not delay the begin of an
                // inactive one
                if self.active {
                    self.pending_s = None;
                }
                return;
            }
            Judgement::Beyond(_) | Judgement::Deadband | Judgement::Within => {}
        }
        self.suppressed = None;
        if fresh {
            self.invalid = None;
        } else if self.invalid.is_some() && lasts(&mut self.judged_s, at_s, rule.off_s) {
            (self.invalid, self.judged_s) = (None, None);
            changed(TransitionKind::Judged, "is judged again".to_owned());
        }
        match (judgement, self.active) {
            (Judgement::Beyond(cause), false) => {
                if lasts(&mut self.pending_s, at_s, rule.on_s) {
                    self.begin(at_s, &cause);
                    changed(TransitionKind::Active, cause);
                }
            }
            (Judgement::Beyond(cause), true) => {
                self.pending_s = None;
                if self.held {
                    self.begin(at_s, &cause);
                    changed(TransitionKind::Active, cause);
                } else {
                    self.cause = cause;
                }
            }
            (Judgement::Within, true) if !self.held => {
                if lasts(&mut self.pending_s, at_s, rule.off_s) {
                    let text = format!("over; it was: {}", self.cause);
                    if rule.latched {
                        self.held = true;
                        let text = format!("{text}; stays active until it is reset");
                        changed(TransitionKind::Held, text);
                    } else {
                        self.end(at_s);
                        changed(TransitionKind::Over, text);
                    }
                }
            }
            // in the deadband, within the limit, or held by the latch: nothing is pending
            _ => self.pending_s = None,
        }
    }

    fn begin(&mut self, at_s: f64, cause: &str) {
        (self.active, self.held, self.acknowledged) = (true, false, false);
        (self.pending_s, self.changed_s) = (None, Some(at_s));
        cause.clone_into(&mut self.cause);
    }

    /// Ends the alarm. If it is not acknowledged, it still has to be.
    pub(crate) fn end(&mut self, at_s: f64) {
        (self.active, self.held) = (false, false);
        (self.pending_s, self.changed_s) = (None, Some(at_s));
        if self
            .shelf
            .as_ref()
            .is_some_and(|shelf| shelf.until_s.is_none())
        {
            self.shelf = None;
        }
    }

    pub(crate) fn acknowledge(&mut self, note: Note) {
        self.acknowledged = true;
        self.acknowledgement = Some(note);
    }

    /// Unshelves the alarm when the time of the shelving is over, or when the clock was set back to before the
    /// shelving. Otherwise the shelving would last longer by the time that the clock was set back.
    pub(crate) fn expire(&mut self, rule: &Rule, at_s: f64, transitions: &mut Vec<Transition>) {
        let Some(shelf) = &self.shelf else {
            return;
        };
        let why = match shelf.until_s {
            Some(until_s) if at_s >= until_s => "its time is over",
            Some(_) if at_s < shelf.note.at_s - CLOCK_TOLERANCE_S => "the clock was set back",
            _ => return,
        };
        self.shelf = None;
        transitions.push(Transition {
            alarm: rule.name.clone(),
            kind: TransitionKind::Handled,
            text: format!("is no longer shelved: {why}"),
        });
    }

    /// Records that the condition was not followed for an unknown time.
    pub(crate) fn forget_condition(&mut self, why: &str) {
        (self.judged_s, self.fresh) = (None, true);
        if self.active {
            self.pending_s = None;
        }
        if self.suppressed.is_none() {
            self.invalid = Some(why.to_owned());
        }
    }
}

/// Whether something has lasted for `time_s` at the time `at_s`; the first call stores its begin. If the clock was set
/// back, the time begins again.
fn lasts(since: &mut Option<f64>, at_s: f64, time_s: f64) -> bool {
    let began = *since.get_or_insert(at_s);
    if at_s < began {
        *since = Some(at_s);
    }
    at_s - since.unwrap_or(at_s) >= time_s
}
