//! Humidity: the sheet's conductance follows the room's humidity by 0.1 to 2 % per 10 % RH, with a delay of hours.
//!
//! The room's humidity is periodic; the foam absorbs water with a time constant, so that the cycle is attenuated by 1 /
//! sqrt(1 + (w tau)^2) and delayed by atan(w tau) (fact sheet, section 2.3). Leave it out in a controlled lab.

use std::f64::consts::TAU;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault};
use super::{Effect, Effects, OnSheet, SheetResponse};

/// The room's humidity, and the sheet's response.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HumiditySettings {
    /// Change of conductance per 10 % RH, %.
    pub percent_per_10_rh: f64,
    /// Amplitude of the room's cycle, % RH.
    pub room_rh: f64,
    /// Length of the cycle, h.
    pub period_h: f64,
    /// Time constant of the foam, h.
    pub tau_h: f64,
    /// Interval at which the sheet is recomputed, s; changes in between are ignored.
    pub every_s: f64,
}

impl Default for HumiditySettings {
    fn default() -> Self {
        Self {
            percent_per_10_rh: -0.5,
            room_rh: 10.0,
            period_h: 24.0,
            tau_h: 3.0,
            every_s: 60.0,
        }
    }
}

impl Effect for HumiditySettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within(
                "percent_per_10_rh",
                self.percent_per_10_rh,
                [-5.0, 5.0],
                "%",
            )
            .within("room_rh", self.room_rh, [0.0, 50.0], "% RH")
            .within("period_h", self.period_h, [0.1, 10_000.0], "h")
            .within("tau_h", self.tau_h, [0.0, 1000.0], "h")
            .within("every_s", self.every_s, [0.001, 86_400.0], "s")
            .end()
    }

    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        let turn = TAU / (self.period_h * 3600.0);
        let slow = turn * self.tau_h * 3600.0;
        let size = self.percent_per_10_rh / 1000.0 * self.room_rh / slow.hypot(1.0);
        response.uniform() * response.over_time(&|at| size * (turn * at - slow.atan()).sin())
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.sheet.push(Box::new(self.clone()));
    }
}

impl OnSheet for HumiditySettings {
    fn act(&mut self, at: Duration, _places: &[[f64; 2]], sigma: &mut [f64]) {
        let hours = self.epoch(at) as f64 * self.every_s / 3600.0;
        let turn = TAU / self.period_h;
        let slow = turn * self.tau_h;
        let wetter = self.room_rh * (turn * hours - slow.atan()).sin() / (1.0 + slow * slow).sqrt();
        let factor = 1.0 + self.percent_per_10_rh / 100.0 * wetter / 10.0;
        for sigma in sigma {
            *sigma *= factor;
        }
    }

    fn epoch(&self, at: Duration) -> u64 {
        (at.as_secs_f64() / self.every_s) as u64
    }
}
