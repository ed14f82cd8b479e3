//! A running sweep: arm layer, trigger layer and points as a function of time.
//!
//! An arm event starts each pass over the points, and a trigger event starts each point (fact sheet, section 4). Any
//! length of time is advanced in one step, because passes that need no new arm event are identical.

mod mean;
mod pulses;

use std::time::Duration;

use super::plan::Point;
use super::values::Values;
use crate::Parameter;
use pulses::{ArmOutput, PulseCounts, TriggerOutput};

/// An event that the trigger model may wait for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trigger {
    /// `*TRG`.
    Bus,
    /// A pulse on this line (1 to 6) of the trigger link.
    Link(u8),
    /// The TRIG key.
    Key,
    /// An edge on the start-of-test line.
    StartOfTest {
        /// Rising, or falling.
        rising: bool,
    },
}

/// The event that the arm layer waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Arm {
    Immediate,
    Timer(u128),
    Event(Trigger),
    EitherEdge,
}

/// Nanoseconds since power on.
type Nanos = u128;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Ready,
    AwaitArm,
    AwaitTimer { until: Nanos },
    AwaitTrigger { point: usize },
    Point { point: usize, since: Nanos },
    Pass { since: Nanos },
    Done,
}

/// Events during an advance of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Progress {
    /// The voltage limit started to reduce the current.
    pub(super) limited: bool,
    /// The sweep was aborted because of compliance.
    pub(super) aborted: bool,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sweep {
    points: Vec<Point>,
    /// Time from the start of a pass to the end of each point.
    ends: Vec<Nanos>,
    passes: Option<u64>,
    abort_on_compliance: bool,
    arm: Arm,
    bypass_arm: bool,
    /// The trigger line that each point waits for.
    line: Option<u8>,
    bypass_trigger: bool,
    /// Output lines, and when each gets a pulse.
    arm_output: Option<(u8, ArmOutput)>,
    trigger_output: Option<(u8, TriggerOutput)>,
    phase: Phase,
    passes_done: u64,
    pass_since: Nanos,
    /// The first point of the pass that has not been checked for compliance yet.
    unseen: usize,
    /// Whether a point of the pass has been checked.
    looked: bool,
    counted: PulseCounts,
    now_at: Option<usize>,
    /// Whether the point checked last was in compliance.
    was_limited: bool,
}

impl Sweep {
    /// Armed, not started.
    pub(super) fn new(points: Vec<Point>, values: &Values) -> Self {
        let mut end = 0;
        let ends = points.iter().map(|point| {
            end += point.delay.as_nanos();
            end
        });
        let count = values.get(Parameter::Count);
        // Trigger lines are 1 to 6.
        let line = |parameter| values.get(parameter) as u8;
        let arm = match values.get(Parameter::ArmSource) as u8 {
            0 => Arm::Immediate,
            1 => Arm::Timer(survey::duration(values.get(Parameter::ArmTimer)).as_nanos()),
            2 => Arm::Event(Trigger::Bus),
            3 => Arm::Event(Trigger::Link(line(Parameter::ArmInput))),
            4 => Arm::EitherEdge,
            5 => Arm::Event(Trigger::StartOfTest { rising: true }),
            6 => Arm::Event(Trigger::StartOfTest { rising: false }),
            _ => Arm::Event(Trigger::Key),
        };
        Self {
            ends: ends.collect(),
            points,
            // a finite count is 1 to 9999
            passes: count.is_finite().then_some(count as u64),
            abort_on_compliance: values.is_on(Parameter::AbortOnCompliance),
            arm,
            bypass_arm: values.is_on(Parameter::ArmDirection),
            line: values
                .is_on(Parameter::TriggerSource)
                .then(|| line(Parameter::TriggerInput)),
            bypass_trigger: values.is_on(Parameter::TriggerDirection),
            arm_output: match values.get(Parameter::ArmOutput) as u8 {
                1 => Some((line(Parameter::ArmOutputLine), ArmOutput::Entering)),
                2 => Some((line(Parameter::ArmOutputLine), ArmOutput::Leaving)),
                _ => None,
            },
            trigger_output: match values.get(Parameter::TriggerOutput) as u8 {
                1 => Some((line(Parameter::TriggerOutputLine), TriggerOutput::Source)),
                2 => Some((line(Parameter::TriggerOutputLine), TriggerOutput::Delay)),
                _ => None,
            },
            phase: Phase::Ready,
            passes_done: 0,
            pass_since: 0,
            unseen: 0,
            looked: false,
            counted: [0; 2],
            now_at: None,
            was_limited: false,
        }
    }

    pub(super) fn start(&mut self, now: Duration) {
        self.passes_done = 0;
        self.counted = [0; 2];
        self.now_at = None;
        self.was_limited = false;
        self.phase = Phase::AwaitArm;
        if self.bypass_arm || matches!(self.arm, Arm::Immediate | Arm::Timer(_)) {
            self.begin_pass(now.as_nanos());
        }
        if self.bypass_trigger && self.phase == (Phase::AwaitTrigger { point: 0 }) {
            self.begin_point(0, now.as_nanos());
        }
    }

    pub(super) fn is_running(&self) -> bool {
        !matches!(self.phase, Phase::Ready | Phase::Done)
    }

    pub(super) fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }

    pub(super) fn awaits_arm(&self) -> bool {
        matches!(self.phase, Phase::AwaitArm | Phase::AwaitTimer { .. })
    }

    pub(super) fn awaits_trigger(&self) -> bool {
        matches!(self.phase, Phase::AwaitTrigger { .. })
    }

    /// The present or last point.
    pub(super) fn point(&self) -> Option<Point> {
        self.now_at.map(|at| self.points[at])
    }

    /// Receives an event; returns false if it is not awaited.
    pub(super) fn receive(&mut self, event: Trigger, now: Duration) -> bool {
        match self.phase {
            Phase::AwaitArm => {
                let received = match self.arm {
                    Arm::Event(awaited) => awaited == event,
                    Arm::EitherEdge => matches!(event, Trigger::StartOfTest { .. }),
                    Arm::Immediate | Arm::Timer(_) => false,
                };
                received && self.signal_arm(now)
            }
            Phase::AwaitTrigger { .. } => match (event, self.line) {
                (Trigger::Link(line), Some(awaited)) => line == awaited && self.signal_trigger(now),
                _ => false,
            },
            _ => false,
        }
    }

    /// Bypasses the event that the arm layer waits for; returns false if it waits for none.
    pub(super) fn signal_arm(&mut self, now: Duration) -> bool {
        let waits = self.awaits_arm();
        if waits {
            self.begin_pass(now.as_nanos());
        }
        waits
    }

    /// Bypasses the event that the trigger layer waits for; returns false if it waits for none.
    pub(super) fn signal_trigger(&mut self, now: Duration) -> bool {
        let Phase::AwaitTrigger { point } = self.phase else {
            return false;
        };
        self.begin_point(point, now.as_nanos());
        true
    }

    fn begin_pass(&mut self, at: Nanos) {
        self.looked = false;
        self.unseen = 0;
        self.pass_since = at;
        self.phase = match self.line {
            Some(_) => Phase::AwaitTrigger { point: 0 },
            None => Phase::Pass { since: at },
        };
    }

    fn begin_point(&mut self, point: usize, since: Nanos) {
        self.now_at = Some(point);
        self.phase = Phase::Point { point, since };
    }

    fn pass_time(&self) -> Nanos {
        self.ends.last().copied().unwrap_or(0)
    }

    /// Time from the start of one pass to the start of the next, if no event is awaited.
    fn period(&self) -> Nanos {
        match self.arm {
            Arm::Timer(interval) => interval.max(self.pass_time()),
            _ => self.pass_time(),
        }
    }

    /// Advances the time. `is_limited` returns whether the voltage limit reduces the current of a point.
    pub(super) fn advance(
        &mut self,
        now: Duration,
        is_limited: impl Fn(&Point) -> bool,
    ) -> Progress {
        let now = now.as_nanos();
        let mut progress = Progress::default();
        loop {
            match self.phase {
                Phase::Ready | Phase::Done | Phase::AwaitArm | Phase::AwaitTrigger { .. } => break,
                Phase::AwaitTimer { until } if now < until => break,
                Phase::AwaitTimer { until } => self.begin_pass(until),
                Phase::Point { point, since } => {
                    if self.check_points(point..point + 1, &is_limited, &mut progress) {
                        break;
                    }
                    let end = since + self.points[point].delay.as_nanos();
                    if now < end {
                        break;
                    }
                    if point + 1 < self.points.len() {
                        self.phase = Phase::AwaitTrigger { point: point + 1 };
                    } else {
                        self.end_pass(end, now, false);
                    }
                }
                Phase::Pass { since } => {
                    let elapsed = now.saturating_sub(since);
                    let reached = self.ends.partition_point(|end| *end <= elapsed);
                    let reached = reached.min(self.points.len() - 1);
                    let whole = self.unseen == 0;
                    // The present point is checked again: its load may have changed.
                    let from = self.unseen.min(reached);
                    if self.check_points(from..reached + 1, &is_limited, &mut progress) {
                        break;
                    }
                    self.unseen = reached;
                    if elapsed < self.pass_time() {
                        break;
                    }
                    self.end_pass(since + self.pass_time(), now, whole);
                }
            }
        }
        progress
    }

    /// Checks points in turn; returns true if one of them ends the sweep.
    fn check_points(
        &mut self,
        points: std::ops::Range<usize>,
        is_limited: &impl Fn(&Point) -> bool,
        progress: &mut Progress,
    ) -> bool {
        for at in points {
            self.now_at = Some(at);
            self.looked = true;
            let limited = is_limited(&self.points[at]);
            progress.limited |= limited && !self.was_limited;
            self.was_limited = limited;
            if limited && self.abort_on_compliance {
                progress.aborted = true;
                self.phase = Phase::Done;
                return true;
            }
        }
        false
    }

    /// Ends a pass at `end`, and begins the next if it needs no event. If the pass was checked from its first point,
    /// all further passes up to `now` are like it and are only counted.
    fn end_pass(&mut self, end: Nanos, now: Nanos, looked_at_whole: bool) {
        self.passes_done += 1;
        let left = self
            .passes
            .map(|passes| passes.saturating_sub(self.passes_done));
        if left == Some(0) {
            self.phase = Phase::Done;
            return;
        }
        let mut next = match self.arm {
            Arm::Immediate => end,
            Arm::Timer(interval) => end.max(self.pass_since + interval),
            Arm::Event(_) | Arm::EitherEdge => {
                self.phase = Phase::AwaitArm;
                return;
            }
        };
        if looked_at_whole && now > next {
            let past = (now - next) / self.period();
            let past = past.min(left.map_or(u128::from(u64::MAX), |left| u128::from(left - 1)));
            // At most u64::MAX.
            self.passes_done = self.passes_done.saturating_add(past as u64);
            next += past * self.period();
        }
        self.phase = Phase::AwaitTimer { until: next };
    }

    /// Remaining time of the sweep; `None` if it waits for an event first, or has no end.
    pub(super) fn remaining(&self, now: Duration) -> Option<Duration> {
        let left = self.passes?.saturating_sub(self.passes_done);
        let needs_event = matches!(self.arm, Arm::Event(_) | Arm::EitherEdge) && left > 1;
        let later = self.period() * u128::from(left.saturating_sub(1));
        let end = match self.phase {
            Phase::Ready | Phase::Done => return Some(Duration::ZERO),
            Phase::AwaitArm | Phase::AwaitTrigger { .. } => return None,
            Phase::AwaitTimer { .. } if self.line.is_some() => return None,
            Phase::AwaitTimer { until } => until + later + self.pass_time(),
            Phase::Pass { .. } if needs_event => return None,
            Phase::Pass { since } => since + later + self.pass_time(),
            Phase::Point { point, since } if point + 1 == self.points.len() && left == 1 => {
                since + self.points[point].delay.as_nanos()
            }
            Phase::Point { .. } => return None,
        };
        Some(duration(end.saturating_sub(now.as_nanos())))
    }
}

fn duration(nanos: Nanos) -> Duration {
    const SECOND: Nanos = 1_000_000_000;
    let seconds = u64::try_from(nanos / SECOND).unwrap_or(u64::MAX);
    // Less than a second.
    Duration::new(seconds, (nanos % SECOND) as u32)
}
