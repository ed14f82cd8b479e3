//! Leakage of a FET multiplexer's channels into the measured resistance: v + I_leak R_source.
//!
//! 20 nA below 30 degC, doubling with each 10 degC (fact sheet, section 2.2): 20 uV on a kilohm. Does not reverse with
//! the current, so current reversal removes it. Leave it out with mechanical relays.

use super::bounds::parameters;
use super::{Added, Needs};
use crate::scan::ReadingContext;

parameters! {
    /// Size of the leakage.
    LeakageSettings {
        /// Leakage up to 30 degC, nA.
        na = 20.0, in [-1e4, 1e4], "nA";
        /// Temperature of the module, degC.
        celsius = 23.0, in [0.0, 70.0], "degC";
    }
}

impl Added for LeakageSettings {
    const NEEDS: Needs = Needs::SOURCE_RESISTANCE;

    fn added(&self, context: &ReadingContext) -> f64 {
        let amps = self.na * 1e-9 * 2_f64.powf((self.celsius - 30.0).max(0.0) / 10.0);
        amps * context.source_resistance.0
    }
}
