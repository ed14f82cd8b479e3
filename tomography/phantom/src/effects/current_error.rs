//! Gain and offset of the source: the current is I (1 + g) + o.
//!
//! 0.05 % + 1 uA on the 2 mA range, 0.05 % + 100 nA on 200 uA, 0.05 % + 10 uA on 20 mA (fact sheet, section 2.2). A
//! constant gain, which difference imaging cancels.

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Errors of the current.
    CurrentErrorSettings {
        /// Error as a share of the current, %.
        gain_percent = 0.05, in [-5.0, 5.0], "%";
        /// Error as a share of the range, %: 0.05 is 1 uA on 2 mA.
        offset_percent = 0.05, in [-5.0, 5.0], "%";
    }
}

impl CurrentErrorSettings {
    /// Ratio of the actual to the requested current; readings scale by it because sheet and wires are linear.
    fn times(&self, context: &ReadingContext) -> f64 {
        let (requested, range) = (context.flowing.0, context.source_range.0);
        if requested == 0.0 {
            return 1.0;
        }
        let flows =
            requested * (1.0 + self.gain_percent / 100.0) + range * self.offset_percent / 100.0;
        flows / requested
    }
}

impl Effect for CurrentErrorSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| sight.exact * (self.times(&sight.context) - 1.0))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for CurrentErrorSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        Volts(volts.0 * self.times(context))
    }
}
