//! The input bias current of the voltmeter flows through the measured resistance: v + I R_source.
//!
//! Less than 50 pA at 25 degC (fact sheet, section 2.1): 50 nV on a kilohm. It is negligible on the sheet, but not on a
//! detached contact.

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Size of the bias current.
    BiasCurrentSettings {
        /// Bias current, pA.
        pa = 50.0, in [-1e6, 1e6], "pA";
    }
}

impl Effect for BiasCurrentSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| self.pa * 1e-12 * sight.context.source_resistance.0)
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for BiasCurrentSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        // for an open input the result is beyond any range, so the voltmeter reports an overload
        Volts(volts.0 + self.pa * 1e-12 * context.source_resistance.0)
    }

    fn needs_source_resistance(&self) -> bool {
        true
    }
}
