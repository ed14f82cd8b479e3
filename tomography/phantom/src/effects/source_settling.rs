//! Settling of the current: it reaches 1 - exp(-t / tau), t since the source or a relay last changed, averaged over the
//! integration.
//!
//! 1 % in 100 us at most, 2 us in the fast mode: tau = 100 us / ln 100 = 22 us (fact sheet, section 2.2). Leave it out
//! with a delay of a millisecond or more.

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Settling of the current.
    SourceSettlingSettings {
        /// Time constant, us.
        tau_us = 22.0, in [0.01, 1e6], "us";
    }
}

impl SourceSettlingSettings {
    /// Mean of exp(-t / tau) over the integration.
    fn missing(&self, context: &ReadingContext) -> f64 {
        context.mean_left_after(self.tau_us * 1e-6)
    }
}

impl Effect for SourceSettlingSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| sight.exact * self.missing(&sight.context))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(self.clone()));
    }
}

impl OnReading for SourceSettlingSettings {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        Volts(volts.0 * (1.0 - self.missing(context)))
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::tests::context;
    use super::*;

    #[test]
    fn settling_leaves_a_hundredth_and_integration_averages_it() {
        let mut settling = SourceSettlingSettings {
            tau_us: 100.0 / 100_f64.ln(),
        };
        let mut missing = |settled_us: u64, nplc: f64| {
            let context = context(1.0, nplc);
            let since_change = context.integration + Duration::from_micros(settled_us);
            let context = ReadingContext {
                since_change,
                ..context
            };
            1.0 - settling.bend(Volts(1.0), &context).0
        };
        assert!((missing(100, 1e-6) - 0.01).abs() < 1e-5);
        // tau / T of the current missing at the start: 21.7 us of 20 ms.
        assert!((missing(0, 1.0) - 1.0857e-3).abs() < 1e-6);
        assert!(missing(1000, 0.02) < 1e-20);
    }
}
