//! Piezoresistance of small strains: sigma_0 / (1 + G e), e the strain across the foam.
//!
//! G = 1 to 10 for carbon nanotubes in latex (fact sheet, section 2.4). Replaces the loss p / (p + p_half); combine it
//! with `foam`, or with a linear foam (`pressure.modulus_kpa`).

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault};
use super::{Effect, Effects, SheetResponse};
use crate::law::Conduction;

/// Dependence of the conductance on strain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GaugeLawSettings {
    /// Gauge factor.
    pub factor: f64,
}

impl Default for GaugeLawSettings {
    fn default() -> Self {
        Self { factor: 3.0 }
    }
}

impl Effect for GaugeLawSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("factor", self.factor, [0.0, 1000.0], "")
            .end()
    }

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
