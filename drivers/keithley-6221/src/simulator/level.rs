//! Level, range, voltage limit, output: what flows.

use std::time::Duration;

use scpi::ParseError;
use survey::{Amps, Volts};

use super::Simulator6221;
use super::plan::Point;
use super::state::{Mode, Outcome, limited};
use crate::command::COMPLIANCE_BIT;
use crate::range::{LIMIT_STEP, RANGES};
use crate::{Load, Range};

/// Changes of the current that are remembered; the longest aperture is a few seconds.
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
            // A level that has been accepted lies on some range.
            self.panel.range = Range::holding(self.panel.level).unwrap_or(self.panel.range);
        }
        Ok(())
    }

    pub(super) fn set_compliance(&mut self, limit: Volts) -> Result<(), ParseError> {
        if self.is_sweeping() {
            return Err(ParseError::SettingsConflict);
        }
        // Divided, not multiplied by 0.01: 10 mV steps read back to the bits of their decimals.
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

    /// What is asked to flow when the output is on.
    pub(super) fn requested(&self) -> Amps {
        match &self.mode {
            Mode::Wave(wave) => wave.value(self.now),
            Mode::Source | Mode::Sweep(_) => self.panel.level,
        }
    }

    /// The range that the current is made on.
    pub(super) fn made_on(&self) -> Range {
        match &self.mode {
            Mode::Wave(wave) => wave.range,
            Mode::Source | Mode::Sweep(_) => self.panel.range,
        }
    }

    /// The mean of what flowed between two instants, the second of which is the time told last: of waves, sweeps, and
    /// levels that messages have set. What the load changes counts as of when it was seen.
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

    /// Remembers that a message has changed what flows.
    pub(super) fn note_step(&mut self, before: Amps) {
        if before == self.flowing {
            return;
        }
        if self.steps.len() == MOST_STEPS {
            self.steps.pop_front();
        }
        self.steps.push_back((self.now, before));
    }

    /// Works out what flows: the level, or what the voltage limit lets through.
    pub(super) fn flow(&mut self, load: &mut dyn Load) {
        let level = self.requested();
        let (flowing, held_back) = if !self.panel.output || level == Amps(0.0) {
            (Amps(0.0), false)
        } else {
            limited(level, load.resistance(self.now), self.panel.compliance)
        };
        self.status.measurement.set(COMPLIANCE_BIT, held_back);
        let range = self.made_on();
        if flowing != self.flowing || range != self.reported_range {
            (self.flowing, self.reported_range) = (flowing, range);
            load.drive(flowing, range.full_scale, self.now);
        }
        self.show();
    }

    /// Ends what is armed or done, so that the level is the source's again.
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

    /// Ends whatever is armed or running.
    pub(super) fn stop_mode(&mut self) {
        if self.is_sweeping() {
            self.outcome = Outcome::SweepAborted;
        } else if self.is_waving() {
            self.outcome = Outcome::WaveStopped;
        }
        self.mode = Mode::Source;
    }
}
