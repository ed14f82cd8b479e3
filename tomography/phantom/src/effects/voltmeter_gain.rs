//! Gain and offset of the voltmeter: v (1 + g) + o, the same at every reading.
//!
//! Within a year of calibration: 0.0050 % of reading + 0.0040 % of range at 0.1 V, 0.0040 + 0.0007 at 1 V, 0.0035 +
//! 0.0005 at 10 V (fact sheet, section 2.1). Difference imaging within a day is not affected. With `by_range` each
//! range has its own errors; readings on two ranges then differ by more than their noise.

use serde::{Deserialize, Serialize};
use survey::Volts;

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

/// Errors of the voltmeter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VoltmeterGainSettings {
    /// Error as a share of the reading, parts per million.
    pub gain_ppm: f64,
    /// Error as a share of the range, parts per million.
    pub offset_ppm: f64,
    /// Ranges with separate errors, which replace those above: V, ppm of reading, ppm of range.
    pub by_range: Vec<[f64; 3]>,
}

impl Default for VoltmeterGainSettings {
    fn default() -> Self {
        Self {
            gain_ppm: 40.0,
            offset_ppm: 7.0,
            by_range: Vec::new(),
        }
    }
}

impl VoltmeterGainSettings {
    /// The voltmeter's reading for a voltage on a range.
    fn given(&self, volts: f64, range: f64) -> f64 {
        let own = (self.by_range.iter()).find(|[of, ..]| (of - range).abs() <= 1e-6 * range);
        let (gain, offset) = own.map_or((self.gain_ppm, self.offset_ppm), |[_, gain, offset]| {
            (*gain, *offset)
        });
        let offset = offset * 1e-6 * range;
        volts * (1.0 + gain * 1e-6) + offset
    }
}

impl Parameters for VoltmeterGainSettings {
    fn check(&self) -> Result<(), Fault> {
        let bounds = Bounds::new()
            .within("gain_ppm", self.gain_ppm, [-1e4, 1e4], "ppm")
            .within("offset_ppm", self.offset_ppm, [-1e4, 1e4], "ppm");
        let ranges = self.by_range.iter();
        ranges
            .fold(bounds, |bounds, [range, gain, offset]| {
                bounds
                    .within("by_range", *range, [1e-3, 1e3], "V")
                    .within("by_range", *gain, [-1e4, 1e4], "ppm")
                    .within("by_range", *offset, [-1e4, 1e4], "ppm")
            })
            .end()
    }
}

impl Effect for VoltmeterGainSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| self.given(sight.exact, sight.context.range.0) - sight.exact)
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for VoltmeterGainSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        Volts(self.given(volts.0, context.range.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_range_has_its_own_gain_and_offset() {
        let settings: VoltmeterGainSettings =
            toml::from_str("by_range = [[0.1, 50, 40], [1, 40, 7], [10, 35, 5]]\ngain_ppm = 45")
                .unwrap();
        settings.check().unwrap();
        for (range, volts, wanted) in [
            (0.1, 0.1, 5e-6 + 4e-6),
            (1.0, 0.1, 4e-6 + 7e-6),
            (10.0, -5.0, -175e-6 + 50e-6),
            // a range that is not listed
            (100.0, 10.0, 450e-6 + 700e-6),
        ] {
            let off = settings.given(volts, range) - volts;
            assert!((off - wanted).abs() < 1e-12, "{range}: {off}");
        }
        let wrong: VoltmeterGainSettings = toml::from_str("by_range = [[1, 40, 1e5]]").unwrap();
        assert_eq!(wrong.check().unwrap_err().key, "by_range");
    }
}
