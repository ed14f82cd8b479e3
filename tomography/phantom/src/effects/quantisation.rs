//! Steps of the voltmeter's converter: a reading is rounded to the nearest multiple of a step.
//!
//! The step is fixed, or equal to the voltmeter's resolution at its integration time. Overload is simulated by the
//! instrument.

use serde::{Deserialize, Serialize};
use survey::Volts;

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

/// Size of a step.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantisationSettings {
    /// Fixed step, uV; by default derived from range and NPLC.
    pub step_uv: Option<f64>,
}

impl QuantisationSettings {
    /// V
    fn step(&self, context: &ReadingContext) -> f64 {
        self.step_uv
            .map_or_else(|| context.resolution * context.range.0, |uv| uv * 1e-6)
    }
}

impl Parameters for QuantisationSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("step_uv", self.step_uv.unwrap_or(0.0), [0.0, 1e6], "uV")
            .end()
    }
}

impl Effect for QuantisationSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        // the rounding error is uniform between two steps; signals below half a step are lost completely
        response.rms(&|sight| match self.step(&sight.context) {
            step if sight.exact.abs() < 0.5 * step => sight.exact,
            step => step / 12_f64.sqrt(),
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for QuantisationSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let step = self.step(context);
        if step > 0.0 {
            Volts((volts.0 / step).round_ties_even() * step)
        } else {
            volts
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::context;
    use super::*;

    #[test]
    fn a_reading_falls_on_a_step() {
        let mut fixed = QuantisationSettings {
            step_uv: Some(10.0),
        };
        let got = fixed.bend(Volts(1.234_56e-3), &context(1.0, 1.0));
        assert!((got.0 - 1.23e-3).abs() < 1e-18);
        let mut by_range = QuantisationSettings::default();
        let got = by_range.bend(Volts(1.2345e-3), &context(10.0, 1.0));
        assert!((got.0 - 1.23e-3).abs() < 1e-18, "{got:?}");
    }
}
