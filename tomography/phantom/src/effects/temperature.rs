//! Temperature: the conductance is sigma (1 - alpha (T - T0)) in a room with periodic temperature; alpha is the
//! temperature coefficient of resistance.
//!
//! alpha = -0.05 to -0.4 % per degC for carbon nanotubes in latex; a room cycles by 1 to 5 degC a day (fact sheet,
//! section 2.3): 3e-4 of the largest reading per degC at 0.2 %. Leave it out below a minute.

use std::f64::consts::TAU;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault};
use super::{Effect, Effects, OnSheet, SheetResponse};

/// The room's temperature, and the sheet's response.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TemperatureSettings {
    /// Temperature coefficient of resistance, % per degC.
    pub percent_per_c: f64,
    /// Amplitude of the room's cycle, degC: half the difference between the highest and the lowest temperature.
    pub room_c: f64,
    /// Length of the cycle, h.
    pub period_h: f64,
    /// Interval at which the sheet is recomputed, s; changes in between are ignored.
    pub every_s: f64,
}

impl Default for TemperatureSettings {
    fn default() -> Self {
        Self {
            percent_per_c: -0.2,
            room_c: 1.5,
            period_h: 24.0,
            every_s: 60.0,
        }
    }
}

impl Effect for TemperatureSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within(
                "percent_per_c",
                self.percent_per_c,
                [-1.0, 1.0],
                "% per degC",
            )
            .within("room_c", self.room_c, [0.0, 20.0], "degC")
            .within("period_h", self.period_h, [0.1, 10_000.0], "h")
            .within("every_s", self.every_s, [0.001, 86_400.0], "s")
            .end()
    }

    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        // to first order in a change of the whole sheet's conductance
        let Self {
            percent_per_c,
            room_c,
            period_h,
            ..
        } = self;
        let turn = TAU / (period_h * 3600.0);
        response.uniform()
            * response.over_time(&|at| percent_per_c / 100.0 * room_c * (turn * at).sin())
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.sheet.push(Box::new(self.clone()));
    }
}

impl OnSheet for TemperatureSettings {
    fn act(&mut self, at: Duration, _places: &[[f64; 2]], sigma: &mut [f64]) {
        let at = self.epoch(at) as f64 * self.every_s;
        let warmer = self.room_c * (TAU * at / (self.period_h * 3600.0)).sin();
        let factor = 1.0 - self.percent_per_c / 100.0 * warmer;
        for sigma in sigma {
            *sigma *= factor;
        }
    }

    fn epoch(&self, at: Duration) -> u64 {
        (at.as_secs_f64() / self.every_s) as u64
    }
}
