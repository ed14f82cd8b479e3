//! Level, range, voltage limit and output, and the current that results from them.

use std::time::Duration;

use scpi::ParseError;
use survey::{Amps, Volts};

use super::Simulator6221;
use super::plan::Point;
use super::state::{Mode, Outcome, limited};
use crate::command::COMPLIANCE_BIT;
use crate::range::{LIMIT_STEP, RANGES};
use crate::{Load, Range};

/// Number of changes of the current that are kept, enough for a reading, whose longest aperture is a few seconds.
const MOST_STEPS: usize = 4096;

impl Simulator6221 {
    pub(super) fn set_level(&mut self, level: Amps) -> Result<(), ParseError> {
        self.leave_mode()?;
        let panel = &mut self.panel;
        if panel.autorange {
            panel.range = Range::holding(level).ok_or(ParseError::OutOfRange)?;
        } else if !panel.range.holds(level) {
            return Err(ParseError::OutOfRange);
        }
        panel.level = level;
        Ok(())
    }

    pub(super) fn set_range(&mut self, level: Amps) -> Result<(), ParseError> {
        self.leave_mode()?;
        let range = Range::holding(level).ok_or(ParseError::OutOfRange)?;
        if !range.holds(self.panel.level) {
            return Err(ParseError::SettingsConflict);
        }
        (self.panel.range, self.panel.autorange) = (range, false);
        Ok(())
    }

    pub(super) fn set_autorange(&mut self, on: bool) -> Result<(), ParseError> {
        self.leave_mode()?;
        self.panel.autorange = on;
        if on {
            // every accepted level is within a range
            self.panel.range = Range::holding(self.panel.level).unwrap_or(self.panel.range);
        }
        Ok(())
    }

    pub(super) fn set_compliance(&mut self, limit: Volts) -> Result<(), ParseError> {
        if self.is_sweeping() {
            return Err(ParseError::SettingsConflict);
        }
        // divided, not multiplied by 0.01: 10 mV steps then read back as exactly the bits of their decimals
        let steps_per_volt = (1.0 / LIMIT_STEP.0).round();
        self.panel.compliance = Volts((limit.0 * steps_per_volt).round() / steps_per_volt);
        Ok(())
    }

    pub(super) fn clear_source(&mut self) {
        self.stop_mode();
        (self.panel.level, self.panel.output) = (Amps(0.0), false);
        if self.panel.autorange {
            self.panel.range = RANGES[0];
        }
    }

    pub(super) fn set_output(&mut self, on: bool) -> Result<(), ParseError> {
        if on && !self.interlock_closed {
            return Err(ParseError::SettingsConflict);
        }
        if !on {
            self.stop_mode();
        }
        self.panel.output = on;
        Ok(())
    }

    /// The current requested while the output is on.
    pub(super) fn requested(&self) -> Amps {
        match &self.mode {
            Mode::Wave(wave) => wave.value(self.now),
            Mode::Source | Mode::Sweep(_) => self.panel.level,
        }
    }

    /// The range in use.
    pub(super) fn range_in_use(&self) -> Range {
        match &self.mode {
            Mode::Wave(wave) => wave.range,
            Mode::Source | Mode::Sweep(_) => self.panel.range,
        }
    }

    /// Mean current between two instants, over waves, sweeps, and levels set by messages. `to` is the simulator's
    /// present time. A change of current by the load takes effect at the time at which it was evaluated.
    pub fn mean_current(&self, from: Duration, to: Duration, load: &mut dyn Load) -> Amps {
        if to <= from {
            return self.flowing;
        }
        match &self.mode {
            Mode::Wave(wave) if self.panel.output || !wave.is_running() => {
                let most = (self.panel.compliance / load.resistance(self.now)).abs();
                wave.mean(from, to, if most.0.is_nan() { Amps(0.0) } else { most })
            }
            Mode::Sweep(sweep) if self.panel.output => {
                let ohms = load.resistance(self.now);
                let flows = |point: &Point| {
                    let limit = point.limit.unwrap_or(self.panel.compliance);
                    limited(point.level, ohms, limit).0.0
                };
                sweep.mean(from, to, flows).map_or(self.flowing, Amps)
            }
            _ => self.mean_of_steps(from, to),
        }
    }

    fn mean_of_steps(&self, from: Duration, to: Duration) -> Amps {
        let mut sum = 0.0;
        let mut end = to;
        let mut flowing = self.flowing;
        for (at, before) in self.steps.iter().rev() {
            if *at <= from {
                break;
            }
            let at = (*at).min(end);
            sum += flowing.0 * (end - at).as_secs_f64();
            (end, flowing) = (at, *before);
        }
        if end == to && flowing == self.flowing {
            return flowing;
        }
        sum += flowing.0 * (end - from).as_secs_f64();
        Amps(sum / (to - from).as_secs_f64())
    }

    /// Records that a message has changed the current.
    pub(super) fn record_step(&mut self, before: Amps) {
        if before == self.flowing {
            return;
        }
        if self.steps.len() == MOST_STEPS {
            self.steps.pop_front();
        }
        self.steps.push_back((self.now, before));
    }

    /// Computes the current: the level, or the smaller current that the voltage limit allows.
    pub(super) fn flow(&mut self, load: &mut dyn Load) {
        let level = self.requested();
        let (flowing, held_back) = if !self.panel.output || level == Amps(0.0) {
            (Amps(0.0), false)
        } else {
            limited(level, load.resistance(self.now), self.panel.compliance)
        };
        self.status.measurement.set(COMPLIANCE_BIT, held_back);
        let range = self.range_in_use();
        if flowing != self.flowing || range != self.reported_range {
            (self.flowing, self.reported_range) = (flowing, range);
            load.drive(flowing, range.full_scale, self.now);
        }
        self.show();
    }

    /// Ends an armed or finished mode, so that the level applies again.
    ///
    /// # Errors
    /// -221 while a sweep or wave is running.
    fn leave_mode(&mut self) -> Result<(), ParseError> {
        if self.is_sweeping() || self.is_waving() {
            return Err(ParseError::SettingsConflict);
        }
        self.mode = Mode::Source;
        Ok(())
    }

    /// Ends an armed or running mode.
    pub(super) fn stop_mode(&mut self) {
        if self.is_sweeping() {
            self.outcome = Outcome::SweepAborted;
        } else if self.is_waving() {
            self.outcome = Outcome::WaveStopped;
        }
        self.mode = Mode::Source;
    }
}
