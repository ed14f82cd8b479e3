//! A share of the common-mode voltage appears in the reading: v + v_common 10^(-dB / 20).
//!
//! 140 dB at direct voltage with a kilohm of imbalance (fact sheet, section 2.1): 1e-7 of the common-mode voltage.
//! Negligible unless the guard is faulty.

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Common-mode rejection of the voltmeter.
    CommonModeSettings {
        /// Rejection, dB.
        db = 140.0, in [20.0, 200.0], "dB";
        /// Resistance over which the current raises the sheet's potential against earth, kohm: about half of the
        /// source's load.
        kohm = 1.0, in [0.0, 1e3], "kohm";
    }
}

impl CommonModeSettings {
    fn volts(&self, context: &ReadingContext) -> f64 {
        let common = context.flowing.0 * self.kohm * 1e3;
        common * 10_f64.powf(-self.db / 20.0)
    }
}

impl Effect for CommonModeSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| self.volts(&sight.context))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for CommonModeSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        Volts(volts.0 + self.volts(context))
    }
}
