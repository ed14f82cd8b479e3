//! The state of the simulated source: front-panel settings, operating mode, and the outcome of the last sweep or wave.

use scpi::format_nr3;
use survey::{Amps, Ohms, Volts};

use super::sweep::Sweep;
use super::wave::Wave;
use crate::Range;
use crate::command::{Ask, Shield, Speed};
use crate::kind::DECIMALS;
use crate::range::{LARGEST_CURRENT, LARGEST_LIMIT, RANGES, SMALLEST_LIMIT};

/// The settings that `*RST` resets (fact sheet, section 4; range and autorange assumed).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ResettableSettings {
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

pub(super) const RESET: ResettableSettings = ResettableSettings {
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

/// Whether the voltage limit reduces the current. True for NaN.
pub(super) fn is_limited(level: Amps, resistance: Ohms, limit: Volts) -> bool {
    let drop = level.abs() * resistance;
    level != Amps(0.0) && (drop.0.is_nan() || drop > limit)
}

/// The current for a level under the voltage limit, and whether the limit reduces it (fact sheet, section 9).
pub(super) fn limited(level: Amps, resistance: Ohms, limit: Volts) -> (Amps, bool) {
    if !is_limited(level, resistance, limit) {
        (level, false)
    } else if resistance.0.is_finite() {
        ((limit / resistance) * level.0.signum(), true)
    } else {
        (Amps(0.0), true)
    }
}

impl ResettableSettings {
    pub(super) fn read_level(&self, ask: Ask) -> String {
        let most = LARGEST_CURRENT.0;
        in_limits(ask, [self.level.0, -most, most, RESET.level.0])
    }

    pub(super) fn read_range(&self, ask: Ask) -> String {
        let [least, .., most] = RANGES.map(|range| range.full_scale.0);
        let now = self.range.full_scale.0;
        in_limits(ask, [now, least, most, RESET.range.full_scale.0])
    }

    pub(super) fn read_compliance(&self, ask: Ask) -> String {
        let limits = [SMALLEST_LIMIT.0, LARGEST_LIMIT.0];
        let [least, most] = limits;
        in_limits(ask, [self.compliance.0, least, most, RESET.compliance.0])
    }
}

fn in_limits(ask: Ask, [now, min, max, def]: [f64; 4]) -> String {
    let value = match ask {
        Ask::Now => now,
        Ask::Min => min,
        Ask::Max => max,
        Ask::Def => def,
    };
    format_nr3(value, DECIMALS)
}

/// The operating mode.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Mode {
    /// A constant level.
    Source,
    /// A sweep: armed, running, or finished and staying on its last point.
    Sweep(Box<Sweep>),
    /// A wave: armed, running or ended.
    Wave(Box<Wave>),
}

/// Outcome of the last sweep or wave; shown in the operation register until the next is armed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Outcome {
    None,
    SweepDone,
    SweepAborted,
    WaveStopped,
}
