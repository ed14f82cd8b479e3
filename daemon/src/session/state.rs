//! The state of the daemon as a pure state machine: no clock, no instrument, no bus.

use std::fmt;

/// The purpose of a running session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Work {
    /// A baseline is being recorded.
    Baseline,
    /// Frames are being measured.
    Measurement,
    /// The rig is being tested.
    Test,
}

/// The state of the daemon.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum State {
    /// Nothing; the source is off.
    Idle,
    /// Recording a baseline.
    Baseline,
    /// Measuring.
    Acquiring,
    /// Testing the rig.
    Testing,
    /// A session pauses between frames; the source is off.
    Suspended(Work),
    /// The last session ended with a fault, or the rig could not be made safe. A new session may be started.
    Faulted(String),
}

/// An event that may change the state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Trigger {
    /// A session is requested.
    Start(Work),
    /// A pause is requested, or the logbook cannot keep up.
    Suspend,
    /// Continuing is requested, or the logbook has caught up.
    Resume,
    /// The session has ended as requested or scheduled; its record is closed, the source off.
    Ended,
    /// The session, or the rig, has failed.
    Fault(String),
    /// The rig has been verified off again after a fault.
    Recovered,
}

/// Why an event is rejected; the state stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Refusal {
    #[error("a session is running; stop it first")]
    SessionActive,
    #[error("the rig is being tested; `tactus status` shows when that is done")]
    Testing,
    #[error("no session is running")]
    NoSession,
}

impl State {
    /// The state after the event.
    pub(crate) fn after(self, event: Trigger) -> Result<Self, (Self, Refusal)> {
        use Trigger::{Ended, Fault, Recovered, Resume, Start, Suspend};
        match (self, event) {
            (Self::Idle | Self::Faulted(_), Start(Work::Baseline)) => Ok(Self::Baseline),
            (Self::Idle | Self::Faulted(_), Start(Work::Measurement)) => Ok(Self::Acquiring),
            (Self::Idle | Self::Faulted(_), Start(Work::Test)) => Ok(Self::Testing),
            (Self::Testing, Start(_)) => Err((Self::Testing, Refusal::Testing)),
            (state, Start(_)) => Err((state, Refusal::SessionActive)),

            (Self::Baseline, Suspend) => Ok(Self::Suspended(Work::Baseline)),
            (Self::Acquiring, Suspend) => Ok(Self::Suspended(Work::Measurement)),
            (state @ Self::Suspended(_), Suspend) => Ok(state),
            (Self::Suspended(Work::Baseline), Resume) => Ok(Self::Baseline),
            (Self::Suspended(Work::Measurement), Resume) => Ok(Self::Acquiring),
            (state @ (Self::Baseline | Self::Acquiring), Resume) => Ok(state),
            (state, Suspend | Resume) => Err((state, Refusal::NoSession)),

            (Self::Baseline | Self::Acquiring | Self::Testing | Self::Suspended(_), Ended) => {
                Ok(Self::Idle)
            }
            (state, Ended) => Err((state, Refusal::NoSession)),
            (_, Fault(why)) => Ok(Self::Faulted(why)),
            (Self::Faulted(_), Recovered) => Ok(Self::Idle),
            (state, Recovered) => Ok(state),
        }
    }

    /// The state's name on D-Bus.
    pub(crate) fn word(&self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Baseline => "baseline",
            Self::Acquiring => "acquiring",
            Self::Testing => "testing",
            Self::Suspended(_) => "suspended",
            Self::Faulted(_) => "faulted",
        }
    }

    /// Whether a session is running.
    pub(crate) fn is_busy(&self) -> bool {
        matches!(
            self,
            Self::Baseline | Self::Acquiring | Self::Testing | Self::Suspended(_)
        )
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Faulted(why) => write!(f, "faulted: {why}"),
            other => f.write_str(other.word()),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::session::state::*;

    fn states() -> Vec<State> {
        vec![
            State::Idle,
            State::Baseline,
            State::Acquiring,
            State::Testing,
            State::Suspended(Work::Baseline),
            State::Suspended(Work::Measurement),
            State::Faulted("disk".into()),
        ]
    }

    fn events() -> Vec<Trigger> {
        vec![
            Trigger::Start(Work::Baseline),
            Trigger::Start(Work::Measurement),
            Trigger::Start(Work::Test),
            Trigger::Suspend,
            Trigger::Resume,
            Trigger::Ended,
            Trigger::Fault("lost".into()),
            Trigger::Recovered,
        ]
    }

    /// The complete table: one row for each state, in the order of `events`. `!`, `t` and `?` are the three rejections.
    #[test]
    fn every_state_answers_every_event() {
        let table = [
            "baseline acquiring testing ? ? ? faulted:lost idle",
            "! ! ! suspended(b) baseline idle faulted:lost baseline",
            "! ! ! suspended(m) acquiring idle faulted:lost acquiring",
            "t t t ? ? idle faulted:lost testing",
            "! ! ! suspended(b) baseline idle faulted:lost suspended(b)",
            "! ! ! suspended(m) acquiring idle faulted:lost suspended(m)",
            "baseline acquiring testing ? ? ? faulted:lost idle",
        ];
        let name = |state: &State| match state {
            State::Suspended(Work::Baseline) => "suspended(b)".to_owned(),
            State::Suspended(Work::Measurement) => "suspended(m)".to_owned(),
            State::Faulted(why) => format!("faulted:{why}"),
            other => other.word().to_owned(),
        };
        for (state, row) in states().into_iter().zip(table) {
            let got: Vec<String> = events()
                .into_iter()
                .map(|event| match state.clone().after(event) {
                    Ok(next) => name(&next),
                    Err((kept, error)) => {
                        assert_eq!(kept, state, "a refusal changes nothing");
                        match error {
                            Refusal::SessionActive => "!".to_owned(),
                            Refusal::Testing => "t".to_owned(),
                            Refusal::NoSession => "?".to_owned(),
                        }
                    }
                })
                .collect();
            assert_eq!(got.join(" "), row, "from {state}");
        }
    }

    #[test]
    fn five_events_never_run_two_sessions_or_lose_a_fault() {
        let mut reached = vec![(State::Idle, 0_i32)];
        for _ in 0..5 {
            reached = reached
                .into_iter()
                .flat_map(|(state, running)| {
                    events().into_iter().filter_map(move |event| {
                        let started = matches!(event, Trigger::Start(_));
                        let ended = matches!(event, Trigger::Ended)
                            || (matches!(event, Trigger::Fault(_)) && state.is_busy());
                        let next = state.clone().after(event).ok()?;
                        Some((next, running + i32::from(started) - i32::from(ended)))
                    })
                })
                .collect();
            for (state, running) in &reached {
                assert_eq!(*running, i32::from(state.is_busy()), "{state}");
            }
        }
    }
}
