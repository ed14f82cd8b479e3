//! Crosstalk: a step of the driven wires reaches the measuring wires through the capacitance between them.
//!
//! C_x / (C_x + C) I R_load exp(-t / tau), tau = R_source (C_x + C), t since current or relays last changed, averaged
//! over the integration: with 10 to 100 pF and kilohms it decays within a microsecond (fact sheet, section 2.2). Leave
//! it out with a delay of 100 us or more. `charge-injection` covers the charge of a relay's own drive.

use super::bounds::parameters;
use super::{Added, Needs};
use crate::scan::ReadingContext;

parameters! {
    /// Capacitances of the wires.
    CrosstalkSettings {
        /// Capacitance between a driven and a measuring wire, pF.
        between_pf = 20.0, in [0.0, 1e5], "pF";
        /// Capacitance of the measuring wire to everything at constant potential, pF.
        wire_pf = 100.0, in [1.0, 1e6], "pF";
    }
}

impl Added for CrosstalkSettings {
    const NEEDS: Needs = Needs {
        source_resistance: true,
        load_resistance: true,
    };

    fn added(&self, context: &ReadingContext) -> f64 {
        let (between, wire) = (self.between_pf * 1e-12, self.wire_pf * 1e-12);
        let step = context.flowing.0 * context.load_resistance.0;
        let tau = context.source_resistance.0 * (between + wire);
        if !(tau > 0.0 && tau.is_finite() && step.is_finite()) {
            return 0.0;
        }
        between / (between + wire) * step * context.mean_left_after(tau)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::tests::context;
    use super::*;

    #[test]
    fn the_step_comes_divided_and_is_gone_within_its_time() {
        let crosstalk = CrosstalkSettings::default();
        let seen = |settled_ns: u64| {
            let context = context(1.0, 1e-9);
            let since_change = context.integration + Duration::from_nanos(settled_ns);
            let context = ReadingContext {
                since_change,
                ..context
            };
            crosstalk.added(&context)
        };
        // 1 mA through 1 kohm is 1 V, a sixth of which is coupled; the time constant is 1 kohm x 120 pF = 120 ns
        assert!((seen(0) - 1.0 / 6.0).abs() < 1e-4);
        assert!((seen(120) * 6.0 - (-1.0_f64).exp()).abs() < 1e-4);
        assert!(seen(100_000) < 1e-300);
    }
}
