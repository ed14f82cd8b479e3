//! The source's output resistance takes a share of the current: I / (1 + R_load / R_out).
//!
//! More than 1e14 ohm on the lowest ranges; at a milliampere effectively about 1e10 ohm, from the load regulation of
//! 0.01 % of range (fact sheet, section 2.2). Almost always negligible.

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, Needs, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Output resistance of the source.
    OutputResistanceSettings {
        /// Output resistance, Mohm.
        mohm = 1e4, in [0.01, 1e9], "Mohm";
    }
}

impl Effect for OutputResistanceSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| sight.exact * sight.context.load_resistance.0 / (self.mohm * 1e6))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for OutputResistanceSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let load = context.load_resistance.0;
        if load.is_infinite() {
            return volts;
        }
        Volts(volts.0 / (1.0 + load / (self.mohm * 1e6)))
    }

    fn needs(&self) -> Needs {
        Needs::LOAD_RESISTANCE
    }
}
