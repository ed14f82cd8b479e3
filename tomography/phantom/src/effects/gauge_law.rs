//! Piezoresistance of small strains: sigma_0 / (1 + G e), e the strain across the foam.
//!
//! G = 1 to 10 for carbon nanotubes in latex (fact sheet, section 2.4). Replaces the loss p / (p + p_half); combine it
//! with `foam`, or with a linear foam (`pressure.modulus_kpa`).

use super::bounds::parameters;
use super::{Effect, Effects, SheetResponse};
use crate::law::Conduction;

parameters! {
    /// Dependence of the conductance on strain.
    GaugeLawSettings {
        /// Gauge factor.
        factor = 3.0, in [0.0, 1000.0];
    }
}

impl Effect for GaugeLawSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| {
            if on {
                effects.exponential_law = None;
                effects.log_law = None;
            }
            effects.gauge_law = on.then(|| self.clone());
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.conduction = Some(Box::new(self.clone()));
    }
}

impl Conduction for GaugeLawSettings {
    fn loss(&self, _kpa: f64, strain: f64) -> f64 {
        let change = self.factor * strain;
        change / (1.0 + change)
    }
}
