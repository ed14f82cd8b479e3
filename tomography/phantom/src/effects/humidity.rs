//! Humidity: the sheet's conductance follows the room's humidity by 0.1 to 2 % per 10 % RH, with a delay of hours.
//!
//! The room's humidity is periodic; the foam absorbs water with a time constant, so that the cycle is attenuated by 1 /
//! sqrt(1 + (w tau)^2) and delayed by atan(w tau) (fact sheet, section 2.3). Leave it out in a controlled lab.

use std::f64::consts::TAU;
use std::time::Duration;

use super::bounds::parameters;
use super::{Effect, Effects, OnSheet, SheetResponse};

parameters! {
    /// The room's humidity, and the sheet's response.
    HumiditySettings {
        /// Change of conductance per 10 % RH, %.
        percent_per_10_rh = -0.5, in [-5.0, 5.0], "%";
        /// Amplitude of the room's cycle, % RH.
        room_rh = 10.0, in [0.0, 50.0], "% RH";
        /// Length of the cycle, h.
        period_h = 24.0, in [0.1, 10_000.0], "h";
        /// Time constant of the foam, h.
        tau_h = 3.0, in [0.0, 1000.0], "h";
        /// Interval at which the sheet is recomputed, s; changes in between are ignored.
        every_s = 60.0, in [0.001, 86_400.0], "s";
    }
}

impl Effect for HumiditySettings {
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
