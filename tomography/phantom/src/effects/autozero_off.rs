//! Zero error of a voltmeter without autozero: 2 ppm of range + 5 uV, with a correlation time of ten minutes.
//!
//! An Ornstein-Uhlenbeck process with a time constant of ten minutes. Its rms is the manual's figure (fact sheet,
//! section 2.1), and its update is exact over any step: z' = e z + sqrt(1 - e^2) n, e = exp(-dt / tau). Leave it out
//! when autozero is on.

use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use survey::Volts;

use super::bounds::{Bounds, Fault};
use super::wander::Wander;
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

/// Size of the zero error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AutozeroOffSettings {
    /// Share of the range, parts per million.
    pub range_ppm: f64,
    /// Fixed part, uV.
    pub uv: f64,
    /// Time constant, s.
    pub tau_s: f64,
}

impl Default for AutozeroOffSettings {
    fn default() -> Self {
        Self {
            range_ppm: 2.0,
            uv: 5.0,
            tau_s: 600.0,
        }
    }
}

impl AutozeroOffSettings {
    /// Rms of the zero error, V.
    fn volts(&self, context: &ReadingContext) -> f64 {
        self.range_ppm * 1e-6 * context.range.0 + self.uv * 1e-6
    }
}

impl Effect for AutozeroOffSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("range_ppm", self.range_ppm, [0.0, 1e3], "ppm")
            .within("uv", self.uv, [0.0, 1e3], "uV")
            .within("tau_s", self.tau_s, [1.0, 1e6], "s")
            .end()
    }

    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| self.volts(&sight.context))
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(AutozeroOff::new(
            self,
            stream(seed, "autozero-off"),
        )));
    }
}

#[derive(Debug)]
pub(super) struct AutozeroOff {
    settings: AutozeroOffSettings,
    zero: Wander,
}

impl AutozeroOff {
    fn new(settings: &AutozeroOffSettings, stream: ChaCha8Rng) -> Self {
        Self {
            settings: settings.clone(),
            zero: Wander::new(survey::duration(settings.tau_s), stream),
        }
    }
}

impl OnReading for AutozeroOff {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let rms = self.settings.volts(context);
        Volts(volts.0 + rms * self.zero.at(context.at))
    }
}
