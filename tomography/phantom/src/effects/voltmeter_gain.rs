//! Gain and offset of the voltmeter: v (1 + g) + o, the same at every reading.
//!
//! Within a year of calibration: 0.0050 % of reading + 0.0040 % of range at 0.1 V, 0.0040 + 0.0007 at 1 V, 0.0035 +
//! 0.0005 at 10 V (fact sheet, section 2.1). Difference imaging within a day is not affected.

use serde::{Deserialize, Serialize};
use survey::Volts;

use super::bounds::{Bounds, Fault};
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

/// Errors of the voltmeter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VoltmeterGainSettings {
    /// Error of the reading, parts per million.
    pub gain_ppm: f64,
    /// Error of the range, parts per million.
    pub offset_ppm: f64,
}

impl Default for VoltmeterGainSettings {
    fn default() -> Self {
        Self {
            gain_ppm: 40.0,
            offset_ppm: 7.0,
        }
    }
}

impl Effect for VoltmeterGainSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("gain_ppm", self.gain_ppm, [-1e4, 1e4], "ppm")
            .within("offset_ppm", self.offset_ppm, [-1e4, 1e4], "ppm")
            .end()
    }

    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| {
            sight.exact * self.gain_ppm * 1e-6 + self.offset_ppm * 1e-6 * sight.context.range.0
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(VoltmeterGain(self.clone())));
    }
}

#[derive(Debug)]
pub(super) struct VoltmeterGain(VoltmeterGainSettings);

impl OnReading for VoltmeterGain {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let offset = self.0.offset_ppm * 1e-6 * context.range.0;
        Volts(volts.0 * (1.0 + self.0.gain_ppm * 1e-6) + offset)
    }
}
