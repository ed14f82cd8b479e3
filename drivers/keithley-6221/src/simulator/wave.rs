//! A running wave: computes the current at an instant from its settings.

use std::f64::consts::TAU;
use std::time::Duration;

use survey::Amps;

use crate::Range;

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    Sine,
    /// The fraction of a period that is high.
    Square(f64),
    /// The fraction of a period that rises.
    Ramp(f64),
    /// Points held for equal parts of a period, as fractions of the amplitude.
    Arbitrary(Vec<f64>),
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum WaveDuration {
    Seconds(f64),
    Cycles(f64),
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    Ready,
    Running {
        began: Duration,
        /// Time of the last change of frequency.
        since: Duration,
        /// Number of periods before that time.
        turns: f64,
    },
    /// Stopped at the end of its duration. The other fields keep their values from running.
    Stopped {
        began: Duration,
        since: Duration,
        turns: f64,
        ended: Duration,
    },
}

/// Samples per period for the integration.
const STEPS: u32 = 4000;

/// Time from one instant to another, s; negative if the second is earlier.
fn seconds(from: Duration, to: Duration) -> f64 {
    match to.checked_sub(from) {
        Some(later) => later.as_secs_f64(),
        None => -(from - to).as_secs_f64(),
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Wave {
    pub(super) shape: Shape,
    pub(super) hertz: f64,
    pub(super) amplitude: f64,
    pub(super) offset: f64,
    pub(super) lasting: WaveDuration,
    pub(super) range: Range,
    phase: Phase,
}

impl Wave {
    /// Armed, not started.
    pub(super) fn new(
        shape: Shape,
        [hertz, amplitude, offset]: [f64; 3],
        lasting: WaveDuration,
        range: Range,
    ) -> Self {
        Self {
            shape,
            hertz,
            amplitude,
            offset,
            lasting,
            range,
            phase: Phase::Ready,
        }
    }

    pub(super) fn start(&mut self, now: Duration) {
        self.phase = Phase::Running {
            began: now,
            since: now,
            turns: 0.0,
        };
    }

    pub(super) fn is_running(&self) -> bool {
        matches!(self.phase, Phase::Running { .. })
    }

    /// Number of periods since the start of a running wave; otherwise 0.
    fn turns(&self, now: Duration) -> f64 {
        match self.phase {
            Phase::Running { since, turns, .. } => {
                turns + now.saturating_sub(since).as_secs_f64() * self.hertz
            }
            Phase::Ready | Phase::Stopped { .. } => 0.0,
        }
    }

    /// Mean of the requested current between two instants, each value limited to `most`. Zero before the start and
    /// after the end.
    pub(super) fn mean(&self, from: Duration, to: Duration, most: Amps) -> Amps {
        let (began, since, turns, ended) = match self.phase {
            Phase::Ready => return Amps(0.0),
            Phase::Running {
                began,
                since,
                turns,
            } => (began, since, turns, to),
            Phase::Stopped {
                began,
                since,
                turns,
                ended,
            } => (began, since, turns, ended),
        };
        let (first, last) = (from.max(began), to.min(ended));
        let (flows, whole) = (seconds(first, last), seconds(from, to));
        if flows <= 0.0 {
            return Amps(0.0);
        }
        let start = turns + seconds(since, first) * self.hertz;
        let made = flows * self.hertz;
        let part = made.fract();
        let sum = made.trunc() * self.mean_of_period_part(0.0, 1.0, most)
            + part * self.mean_of_period_part(start, part, most);
        Amps(sum / made * flows / whole)
    }

    /// Mean over a part of a period.
    fn mean_of_period_part(&self, start: f64, length: f64, most: Amps) -> f64 {
        self.samples(start, length, most).sum::<f64>() / f64::from(STEPS)
    }

    /// Samples over a part of a period, each limited to `most`.
    fn samples(&self, start: f64, length: f64, most: Amps) -> impl Iterator<Item = f64> {
        (0..STEPS).map(move |step| {
            let turn = start + length * (f64::from(step) + 0.5) / f64::from(STEPS);
            let Amps(value) = self.at_phase(turn.rem_euclid(1.0));
            value.clamp(-most.0, most.0)
        })
    }

    /// How often the wave has passed the marked phase so far.
    pub(super) fn marked_phases(&self, now: Duration, marked: f64) -> u64 {
        let Phase::Running { began, .. } = self.phase else {
            return 0;
        };
        let elapsed = now.saturating_sub(began).as_secs_f64();
        let turns = match self.lasting {
            WaveDuration::Cycles(whole) => self.turns(now).min(whole),
            WaveDuration::Seconds(whole) if elapsed > whole => whole * self.hertz,
            WaveDuration::Seconds(_) => self.turns(now),
        };
        let past = turns - marked;
        if past < 0.0 { 0 } else { past as u64 + 1 }
    }

    /// Changes the frequency without a jump of phase.
    pub(super) fn retune(&mut self, hertz: f64, now: Duration) {
        let so_far = self.turns(now);
        if let Phase::Running { since, turns, .. } = &mut self.phase {
            (*since, *turns) = (now, so_far);
        }
        self.hertz = hertz;
    }

    /// Largest current of either sign.
    pub(super) fn peak(&self) -> Amps {
        Amps(self.amplitude + self.offset.abs())
    }

    /// Whether a whole period, and therefore its peak, is over.
    pub(super) fn has_peaked(&self, now: Duration) -> bool {
        self.turns(now) >= 1.0
    }

    /// Remaining time of the wave; `None` for a wave without end.
    pub(super) fn remaining(&self, now: Duration) -> Option<Duration> {
        let Phase::Running { began, .. } = self.phase else {
            return Some(Duration::ZERO);
        };
        let seconds = self.seconds_left(began, now);
        seconds
            .is_finite()
            .then(|| Duration::try_from_secs_f64(seconds.max(0.0)).unwrap_or(Duration::MAX))
    }

    /// Remaining time of a running wave, s; negative after its end.
    fn seconds_left(&self, began: Duration, now: Duration) -> f64 {
        match self.lasting {
            WaveDuration::Seconds(whole) => whole - now.saturating_sub(began).as_secs_f64(),
            WaveDuration::Cycles(whole) => (whole - self.turns(now)) / self.hertz,
        }
    }

    /// Advances the time; returns true if the wave ended meanwhile.
    pub(super) fn advance(&mut self, now: Duration) -> bool {
        let Phase::Running {
            began,
            since,
            turns,
        } = self.phase
        else {
            return false;
        };
        let left = self.seconds_left(began, now);
        // tolerance of 1 ns, so that an awaited end counts as reached
        let over = left <= 1e-9;
        if over {
            let past = Duration::try_from_secs_f64(-left).unwrap_or_default();
            self.phase = Phase::Stopped {
                began,
                since,
                turns,
                ended: now.saturating_sub(past),
            };
        }
        over
    }

    /// The requested current now: zero before the start and after the end.
    pub(super) fn value(&self, now: Duration) -> Amps {
        if !self.is_running() {
            return Amps(0.0);
        }
        self.at_phase(self.turns(now).fract())
    }

    /// R.m.s. of the alternating part over one period, each value limited to `most`.
    pub(super) fn alternating(&self, most: Amps) -> Amps {
        let (mut sum, mut squares) = (0.0, 0.0);
        for value in self.samples(0.0, 1.0, most) {
            sum += value;
            squares += value * value;
        }
        let mean = sum / f64::from(STEPS);
        Amps((squares / f64::from(STEPS) - mean * mean).max(0.0).sqrt())
    }

    /// The current at a phase, as a fraction of a period.
    fn at_phase(&self, at: f64) -> Amps {
        let unit = match &self.shape {
            Shape::Sine => (TAU * at).sin(),
            Shape::Square(high) => {
                if at < *high {
                    1.0
                } else {
                    -1.0
                }
            }
            Shape::Ramp(rising) if at < *rising => 2.0 * at / rising - 1.0,
            Shape::Ramp(rising) => 1.0 - 2.0 * (at - rising) / (1.0 - rising),
            Shape::Arbitrary(points) => {
                let place = (at * points.len() as f64) as usize;
                points[place.min(points.len() - 1)]
            }
        };
        Amps(self.offset + self.amplitude * unit)
    }
}
