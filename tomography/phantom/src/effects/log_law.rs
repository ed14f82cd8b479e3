//! The law of force-sensing films: R = R_0 (1 - s log10(p / p_0)) from p_0 on.
//!
//! Unlike foam, the film conducts better under pressure: its loss is negative. The resistance of some films falls by
//! one decade per decade of pressure (fact sheet, section 2.4: other films). R stays above 1 % of R_0. The law replaces
//! the loss p / (p + p_half) and depends on the pressure, not on the strain.

use super::bounds::parameters;
use super::{Effect, Effects, SheetResponse};
use crate::law::Conduction;

parameters! {
    /// Dependence of the resistance on pressure.
    LogLawSettings {
        /// Decrease of the resistance per decade of pressure, % of the unloaded film's resistance.
        percent_per_decade = 20.0, in [0.0, 100.0], "% per decade";
        /// No effect below this pressure, kPa.
        from_kpa = 1.0, in [1e-6, 1e6], "kPa";
    }
}

impl Effect for LogLawSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| {
            if on {
                effects.gauge_law = None;
                effects.exponential_law = None;
                effects.foam = None;
            }
            effects.log_law = on.then(|| self.clone());
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.conduction = Some(Box::new(self.clone()));
    }
}

/// Lower limit of the resistance as a share of the unloaded film's.
const FLOOR: f64 = 0.01;

impl Conduction for LogLawSettings {
    fn loss(&self, kpa: f64, _strain: f64) -> f64 {
        let decades = (kpa / self.from_kpa).max(1.0).log10();
        let resistance = (1.0 - self.percent_per_decade / 100.0 * decades).max(FLOOR);
        1.0 - 1.0 / resistance
    }
}
