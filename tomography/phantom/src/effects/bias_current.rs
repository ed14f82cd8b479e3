//! The input bias current of the voltmeter flows through the measured resistance: v + I R_source.
//!
//! Less than 50 pA at 25 degC (fact sheet, section 2.1): 50 nV on a kilohm. It is negligible on the sheet, but not on a
//! detached contact.

use super::bounds::parameters;
use super::{Added, Needs};
use crate::scan::ReadingContext;

parameters! {
    /// Size of the bias current.
    BiasCurrentSettings {
        /// Bias current, pA.
        pa = 50.0, in [-1e6, 1e6], "pA";
    }
}

impl Added for BiasCurrentSettings {
    const NEEDS: Needs = Needs::SOURCE_RESISTANCE;

    fn added(&self, context: &ReadingContext) -> f64 {
        // for an open input the result is beyond any range, so the voltmeter reports an overload
        self.pa * 1e-12 * context.source_resistance.0
    }
}
