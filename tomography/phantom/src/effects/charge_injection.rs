//! Charge injected by a switching relay: Q / C exp(-t / (R C)), t since a relay last moved.
//!
//! 1 to 50 pC into 10 to 100 pF and a kilohm: gone in less than a microsecond (fact sheet, section 2.2). Leave it out
//! with a delay of 100 us or more.

use super::bounds::parameters;
use super::{Added, Needs};
use crate::scan::ReadingContext;

parameters! {
    /// Charge and capacitance.
    ChargeInjectionSettings {
        /// Charge, pC.
        pc = 20.0, in [-1e3, 1e3], "pC";
        /// Capacitance of channel and cable, pF.
        pf = 50.0, in [1.0, 1e6], "pF";
    }
}

impl Added for ChargeInjectionSettings {
    const NEEDS: Needs = Needs::SOURCE_RESISTANCE;

    fn added(&self, context: &ReadingContext) -> f64 {
        let farad = self.pf * 1e-12;
        let tau = context.source_resistance.0 * farad;
        if !(tau > 0.0 && tau.is_finite()) {
            return 0.0;
        }
        self.pc * 1e-12 / farad * context.mean_left_after(tau)
    }
}
