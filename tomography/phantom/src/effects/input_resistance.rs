//! The voltmeter's input resistance loads the measured voltage: v R_in / (R_in + R_source).
//!
//! 10 Mohm, or more than 10 Gohm on the ranges up to 10 V if high input impedance is selected (fact sheet, section
//! 2.1): 1e-4 or 1e-7 of a reading on a sheet of a kilohm.

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, Needs, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Input resistance of the voltmeter.
    InputResistanceSettings {
        /// Input resistance, Mohm.
        mohm = 10.0, in [0.01, 1e7], "Mohm";
    }
}

impl Effect for InputResistanceSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| {
            let source = sight.context.source_resistance.0;
            sight.exact * source / (self.mohm * 1e6 + source)
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for InputResistanceSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let input = self.mohm * 1e6;
        if context.source_resistance.0.is_infinite() {
            return Volts(0.0);
        }
        Volts(volts.0 * input / (input + context.source_resistance.0))
    }

    fn needs(&self) -> Needs {
        Needs::SOURCE_RESISTANCE
    }
}
