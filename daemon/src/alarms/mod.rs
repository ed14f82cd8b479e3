//! The daemon's alarms: its own problems and the rules of `[[alarm]]` are judged by one state machine (crate `alarms`),
//! whose state is stored in the record's folder and survives a restart. A change is stored before it is reported.

mod judged;
pub(crate) mod sink;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use alarms::{Alarms, Judgement, Order, Refused, Transition, TransitionKind};
use config::{AlarmSettings, Config, NotifySection};
use outfile::Existing;
use survey::error_chain as chain;
use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::alarms::sink::JudgedFrame;
use crate::events::kind::EventKind;
use crate::locked::locked;
use crate::monitoring::built_in;
use crate::monitoring::health::Health;
use crate::monitoring::notices::{Message, Notices};

/// In the directory of the record.
const FILE: &str = "alarms.json";
/// Name of a file that could not be read, kept for people.
const DAMAGED: &str = "alarms.json.damaged";
/// Maximum number of frames that wait to be judged. A frame that arrives while the queue is full is not judged.
const QUEUE: usize = 64;

/// All alarms of the daemon.
#[derive(Debug)]
pub(crate) struct AlarmDesk {
    path: PathBuf,
    desk: tokio::sync::Mutex<Desk>,
    /// The alarms after the last change, readable without waiting for a change in progress.
    shown: Mutex<Arc<Shown>>,
    frames: mpsc::Sender<JudgedFrame>,
    waiting: Mutex<Option<mpsc::Receiver<JudgedFrame>>>,
}

#[derive(Debug, Default)]
struct Desk {
    alarms: Alarms,
    rules: Arc<[AlarmSettings]>,
    notices: Notices,
    /// Session and time of the last frame with quantities.
    last_frame: Option<(String, Instant)>,
    /// Whether the state could not be stored, which is reported once.
    unstored: bool,
}

/// Alarms and their rules.
#[derive(Debug, Default, Clone)]
pub(crate) struct Shown {
    pub alarms: Alarms,
    pub rules: Arc<[AlarmSettings]>,
}

/// A change, with the kind of its event.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Change {
    pub kind: EventKind,
    /// Name of the alarm, cause and value.
    pub text: String,
    /// Whether it is written to the record of the running session.
    pub of_session: bool,
}

impl AlarmDesk {
    /// Loads the stored state from this directory. Also returns the changes to report: the state could not be read, and
    /// alarms ended because their rules were removed meanwhile.
    pub(crate) fn open(directory: &Path, config: &Config) -> (Self, Vec<Change>) {
        let path = directory.join(FILE);
        let mut changes = Vec::new();
        let mut alarms = recall(&path).unwrap_or_else(|text| {
            changes.push(Change::invalid(text));
            Alarms::default()
        });
        alarms.restarted();
        let (frames, waiting) = mpsc::channel(QUEUE);
        let desk = Self {
            path,
            desk: tokio::sync::Mutex::new(Desk {
                alarms,
                ..Desk::default()
            }),
            shown: Mutex::default(),
            frames,
            waiting: Mutex::new(Some(waiting)),
        };
        if let Ok(mut open) = desk.desk.try_lock() {
            let ended = open.take_rules(&config.alarm);
            if !ended.is_empty()
                && let Err(why) = store(&desk.path, &open.alarms)
            {
                changes.push(Change::unstored(&why));
                open.unstored = true;
            }
            changes.extend(ended.into_iter().map(Change::of));
            desk.show(&open);
        }
        (desk, changes)
    }

    /// Replaces the rules by those of this configuration. Returns the ends of alarms whose rules were removed.
    pub(crate) async fn take_rules(&self, config: &Config) -> Vec<Change> {
        let mut desk = self.desk.lock().await;
        let ended = desk.take_rules(&config.alarm);
        self.keep(&mut desk, ended).await
    }

    /// The sender for the frames to be judged.
    pub(crate) fn frames(&self) -> mpsc::Sender<JudgedFrame> {
        self.frames.clone()
    }

    /// The frames to judge; `None` after the first call.
    pub(crate) fn take_frames(&self) -> Option<mpsc::Receiver<JudgedFrame>> {
        locked(&self.waiting).take()
    }

    /// All alarms with their rules.
    pub(crate) fn shown(&self) -> Arc<Shown> {
        let shown = locked(&self.shown);
        Arc::clone(&shown)
    }

    /// Judges the rules on quantities by a frame at this time, s of the Unix epoch.
    pub(crate) async fn judge_frame(&self, at_s: f64, frame: &JudgedFrame) -> Vec<Change> {
        let Some(found) = frame.published.quantities.as_ref() else {
            return Vec::new();
        };
        let mut desk = self.desk.lock().await;
        desk.last_frame = Some((frame.session.clone(), Instant::now()));
        let judgements: Vec<_> = desk
            .rules
            .iter()
            .filter_map(|rule| Some((rule.name.clone(), judged::by_frame(rule, found)?)))
            .collect();
        let transitions = desk.judge(at_s, judgements);
        self.keep(&mut desk, transitions).await
    }

    /// Judges all alarms by the health of the daemon. Returns the changes and the notifications that are due.
    pub(crate) async fn judge_health(
        &self,
        at_s: f64,
        health: &Health,
        limits: &NotifySection,
        map_every: u64,
    ) -> (Vec<Change>, Vec<Message>) {
        let mut desk = self.desk.lock().await;
        let quiet_s = desk.quiet_s(health, limits, map_every);
        let mut judgements: Vec<_> = desk
            .rules
            .iter()
            .filter_map(|rule| Some((rule.name.clone(), judged::by_health(rule, health, quiet_s)?)))
            .collect();
        let own = built_in::judgements(health, limits).into_iter();
        judgements.extend(own.map(|(kind, judgement)| (kind.to_owned(), judgement)));
        let transitions = desk.judge(at_s, judgements);
        let changes = self.keep(&mut desk, transitions).await;
        let again = survey::duration(limits.again_s);
        let Desk {
            alarms, notices, ..
        } = &mut *desk;
        let due = notices.due(Instant::now(), alarms, again);
        (changes, due)
    }

    /// Carries out an operator's order.
    ///
    /// # Errors
    /// There is no such alarm, or its state does not allow the order.
    pub(crate) async fn order(
        &self,
        name: &str,
        at_s: f64,
        order: Order,
        by: &str,
        comment: &str,
    ) -> Result<Vec<Change>, Refused> {
        let mut desk = self.desk.lock().await;
        let done = desk.alarms.order(name, at_s, &order, by, comment)?;
        Ok(self.keep(&mut desk, done).await)
    }

    /// Stores the state after a change, and returns the changes to report.
    async fn keep(&self, desk: &mut Desk, transitions: Vec<Transition>) -> Vec<Change> {
        self.show(desk);
        if transitions.is_empty() {
            return Vec::new();
        }
        let mut changes: Vec<Change> = transitions.into_iter().map(Change::of).collect();
        let (path, alarms) = (self.path.clone(), desk.alarms.clone());
        let stored = tokio::task::spawn_blocking(move || store(&path, &alarms)).await;
        let failed = match stored {
            Ok(Ok(())) => None,
            Ok(Err(why)) => Some(why),
            Err(failed) => Some(failed.to_string()),
        };
        if let Some(why) = &failed
            && !desk.unstored
        {
            changes.push(Change::unstored(why));
        }
        desk.unstored = failed.is_some();
        changes
    }

    fn show(&self, desk: &Desk) {
        let shown = Arc::new(Shown {
            alarms: desk.alarms.clone(),
            rules: Arc::clone(&desk.rules),
        });
        *locked(&self.shown) = shown;
    }
}

impl Desk {
    fn take_rules(&mut self, rules: &[AlarmSettings]) -> Vec<Transition> {
        self.rules = rules.into();
        let own = rules.iter().map(AlarmSettings::rule);
        self.alarms
            .set_rules(built_in::rules().chain(own).collect())
    }

    fn judge(&mut self, at_s: f64, judgements: Vec<(String, Judgement)>) -> Vec<Transition> {
        let each = judgements.into_iter();
        each.flat_map(|(name, judgement)| self.alarms.judge(&name, at_s, judgement))
            .collect()
    }

    /// The time without a map, s, if it is longer than the limit of `[notify]`; `None` otherwise.
    fn quiet_s(&mut self, health: &Health, limits: &NotifySection, map_every: u64) -> Option<f64> {
        let session = health.session.as_ref()?;
        let now = Instant::now();
        let since = match &self.last_frame {
            Some((id, at)) if *id == session.id => *at,
            // a new session
            _ => {
                self.last_frame = Some((session.id.clone(), now));
                now
            }
        };
        let quiet = now.duration_since(since);
        let period = session.period.as_secs_f64() * map_every as f64;
        let patience = (period * limits.no_frame_periods).max(limits.no_frame_s);
        (quiet > survey::duration(patience)).then_some(quiet.as_secs_f64())
    }
}

impl Change {
    fn of(transition: Transition) -> Self {
        let own = built_in::has(&transition.alarm);
        let kind = match transition.kind {
            TransitionKind::Active if own => EventKind::Trouble,
            TransitionKind::Over if own => EventKind::TroubleOver,
            TransitionKind::Active => EventKind::AlarmActive,
            TransitionKind::Over => EventKind::AlarmOver,
            TransitionKind::Held => EventKind::AlarmHeld,
            TransitionKind::Invalid => EventKind::AlarmInvalid,
            TransitionKind::Judged => EventKind::AlarmJudged,
            TransitionKind::Handled => EventKind::AlarmHandled,
        };
        Self {
            kind,
            text: format!("{}: {}", transition.alarm, transition.text),
            of_session: !own,
        }
    }

    /// A problem of the stored state.
    fn invalid(text: String) -> Self {
        Self {
            kind: EventKind::AlarmInvalid,
            text,
            of_session: false,
        }
    }

    fn unstored(why: &str) -> Self {
        Self::invalid(format!(
            "the state of the alarms cannot be stored, and is lost when the daemon ends: {why}"
        ))
    }
}

impl Shown {
    /// The rule of an alarm; `None` for a built-in one.
    pub(crate) fn rule(&self, name: &str) -> Option<&AlarmSettings> {
        self.rules.iter().find(|rule| rule.name == name)
    }

    /// Name and text of the active alarms of rules, most severe first, then of the rules that cannot be judged. Shelved
    /// alarms and those out of service are left out.
    pub(crate) fn of_rules(&self) -> Vec<(String, String)> {
        let own = |alarm: &&alarms::Alarm| !built_in::has(&alarm.rule.name);
        let mut raised: Vec<_> = self
            .alarms
            .iter()
            .filter(own)
            .filter(|alarm| alarm.notifies())
            .collect();
        raised.sort_by_key(|alarm| std::cmp::Reverse(alarm.rule.severity));
        let invalid = self
            .alarms
            .iter()
            .filter(own)
            .filter(|alarm| !alarm.state.active && alarm.cannot_judge());
        let sentence = |alarm: &alarms::Alarm| {
            let text = match &alarm.state.invalid {
                Some(why) if !alarm.state.active => format!("cannot be judged: {why}"),
                _ => alarm.state.cause.clone(),
            };
            (alarm.rule.name.clone(), text)
        };
        raised.into_iter().chain(invalid).map(sentence).collect()
    }
}

/// The stored state; a file that cannot be read is renamed, so that it is not overwritten.
fn recall(path: &Path) -> Result<Alarms, String> {
    let cause = match std::fs::read(path) {
        Ok(text) => match serde_json::from_slice(&text) {
            Ok(alarms) => return Ok(alarms),
            Err(cause) => cause.to_string(),
        },
        Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(Alarms::default()),
        Err(cause) => cause.to_string(),
    };
    let kept = path.with_file_name(DAMAGED);
    let outcome = match std::fs::rename(path, &kept) {
        Ok(()) => format!("the file is kept as {}", kept.display()),
        Err(refused) => format!(
            "the file cannot be renamed to {}: {refused}",
            kept.display()
        ),
    };
    Err(format!(
        "the stored state of the alarms cannot be read ({}: {cause}), and every alarm starts without a state; {outcome}",
        path.display()
    ))
}

fn store(path: &Path, alarms: &Alarms) -> Result<(), String> {
    let text = serde_json::to_vec(alarms).map_err(|cause| cause.to_string())?;
    outfile::write(path, Existing::Replace, &text).map_err(|error| chain(&error))?;
    Ok(())
}
