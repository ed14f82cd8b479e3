//! Piezoresistance of large strains: sigma_0 exp(-k e), e the strain across the foam.
//!
//! The conductance remains above zero; for small strains the law equals the gauge law with G = k (fact sheet, section
//! 2.4). Replaces the loss p / (p + p_half); combine it with `foam`, or with a linear foam (`pressure.modulus_kpa`).

use super::bounds::parameters;
use super::{Effect, Effects, SheetResponse};
use crate::law::Conduction;

parameters! {
    /// Dependence of the conductance on strain.
    ExponentialLawSettings {
        /// Loss of ln(conductance) at a strain of 1.
        per_strain = 3.0, in [0.0, 18.0];
    }
}

impl Effect for ExponentialLawSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| {
            if on {
                effects.gauge_law = None;
                effects.log_law = None;
            }
            effects.exponential_law = on.then(|| self.clone());
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.conduction = Some(Box::new(self.clone()));
    }
}

impl Conduction for ExponentialLawSettings {
    fn loss(&self, _kpa: f64, strain: f64) -> f64 {
        -(-self.per_strain * strain).exp_m1()
    }
}
