//! Zero error of a voltmeter without autozero: 2 ppm of range + 5 uV, with a correlation time of ten minutes.
//!
//! An Ornstein-Uhlenbeck process with a time constant of ten minutes. Its rms is the manual's figure (fact sheet,
//! section 2.1), and its update is exact over any step: z' = e z + sqrt(1 - e^2) n, e = exp(-dt / tau). Leave it out
//! when autozero is on.

use survey::Volts;

use super::bounds::parameters;
use super::wander::Wander;
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

parameters! {
    /// Size of the zero error.
    AutozeroOffSettings {
        /// Share of the range, parts per million.
        range_ppm = 2.0, in [0.0, 1e3], "ppm";
        /// Fixed part, uV.
        uv = 5.0, in [0.0, 1e3], "uV";
        /// Time constant, s.
        tau_s = 600.0, in [1.0, 1e6], "s";
    }
}

impl AutozeroOffSettings {
    /// Rms of the zero error, V.
    fn volts(&self, context: &ReadingContext) -> f64 {
        self.range_ppm * 1e-6 * context.range.0 + self.uv * 1e-6
    }
}

impl Effect for AutozeroOffSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| self.volts(&sight.context))
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(AutozeroOff {
            settings: self.clone(),
            zero: Wander::new(survey::duration(self.tau_s), stream(seed, "autozero-off")),
        }));
    }
}

#[derive(Debug)]
pub(super) struct AutozeroOff {
    settings: AutozeroOffSettings,
    zero: Wander,
}

impl OnReading for AutozeroOff {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let rms = self.settings.volts(context);
        Volts(volts.0 + rms * self.zero.at(context.at))
    }
}
