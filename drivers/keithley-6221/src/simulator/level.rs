//! Level, range, voltage limit, output: what flows.

use scpi::{ParseError, format_nr3};
use survey::{Amps, Ohms, Volts};

use super::Simulator6221;
use super::modes::{Mode, Outcome};
use crate::command::{Ask, COMPLIANCE_BIT, Shield, Speed};
use crate::kind::DECIMALS;
use crate::range::{LARGEST_CURRENT, LARGEST_LIMIT, LIMIT_STEP, RANGES, SMALLEST_LIMIT};
use crate::{Load, Range};

/// What `*RST` sets (fact sheet, section 4; range and autorange assumed).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Panel {
    pub(super) level: Amps,
    pub(super) range: Range,
    pub(super) autorange: bool,
    pub(super) compliance: Volts,
    pub(super) filter: bool,
    pub(super) output: bool,
    pub(super) shield: Shield,
    pub(super) low_to_earth: bool,
    pub(super) speed: Speed,
}

pub(super) const RESET: Panel = Panel {
    level: Amps(0.0),
    range: RANGES[RANGES.len() - 1],
    autorange: false,
    compliance: Volts(10.0),
    filter: false,
    output: false,
    shield: Shield::OutputLow,
    low_to_earth: false,
    speed: Speed::Fast,
};

/// Whether the voltage limit holds a current back. What is no number does.
pub(super) fn is_limited(level: Amps, resistance: Ohms, limit: Volts) -> bool {
    let drop = level.abs() * resistance;
    level != Amps(0.0) && (drop.0.is_nan() || drop > limit)
}

impl Panel {
    pub(super) fn read_level(&self, ask: Ask) -> String {
        let most = LARGEST_CURRENT.0;
        told(ask, [self.level.0, -most, most, RESET.level.0])
    }

    pub(super) fn read_range(&self, ask: Ask) -> String {
        let [least, .., most] = RANGES.map(|range| range.full_scale.0);
        let now = self.range.full_scale.0;
        told(ask, [now, least, most, RESET.range.full_scale.0])
    }

    pub(super) fn read_compliance(&self, ask: Ask) -> String {
        let limits = [SMALLEST_LIMIT.0, LARGEST_LIMIT.0];
        let [least, most] = limits;
        told(ask, [self.compliance.0, least, most, RESET.compliance.0])
    }
}

fn told(ask: Ask, [now, min, max, def]: [f64; 4]) -> String {
    let value = match ask {
        Ask::Now => now,
        Ask::Min => min,
        Ask::Max => max,
        Ask::Def => def,
    };
    format_nr3(value, DECIMALS)
}

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
    pub(super) fn asked(&self) -> Amps {
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

    /// Works out what flows: the level, or what the voltage limit lets through (fact sheet, section 9).
    pub(super) fn flow(&mut self, load: &mut dyn Load) {
        let level = self.asked();
        let (flowing, limited) = if !self.panel.output || level == Amps(0.0) {
            (Amps(0.0), false)
        } else {
            let resistance = load.resistance(self.now);
            let limit = self.panel.compliance;
            if !is_limited(level, resistance, limit) {
                (level, false)
            } else if resistance.0.is_finite() {
                ((limit / resistance) * level.0.signum(), true)
            } else {
                (Amps(0.0), true)
            }
        };
        self.status.measurement.set(COMPLIANCE_BIT, limited);
        let range = self.made_on();
        if flowing != self.flowing || range != self.told_range {
            (self.flowing, self.told_range) = (flowing, range);
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
