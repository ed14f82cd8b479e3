//! A share of the common-mode voltage appears in the reading: v + v_common 10^(-dB / 20).
//!
//! 140 dB at direct voltage with a kilohm of imbalance (fact sheet, section 2.1): 1e-7 of the common-mode voltage.
//! Negligible unless the guard is faulty.

use super::bounds::parameters;
use super::{Added, Needs};
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

impl Added for CommonModeSettings {
    const NEEDS: Needs = Needs::NONE;

    fn added(&self, context: &ReadingContext) -> f64 {
        let common = context.flowing.0 * self.kohm * 1e3;
        common * 10_f64.powf(-self.db / 20.0)
    }
}
