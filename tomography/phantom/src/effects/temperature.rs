//! Temperature: the conductance is sigma (1 - alpha (T - T0)) in a room with periodic temperature; alpha is the
//! temperature coefficient of resistance.
//!
//! alpha = -0.05 to -0.4 % per degC for carbon nanotubes in latex; a room cycles by 1 to 5 degC a day (fact sheet,
//! section 2.3): 3e-4 of the largest reading per degC at 0.2 %. Leave it out below a minute.

use std::f64::consts::TAU;
use std::time::Duration;

use super::bounds::parameters;
use super::{Effect, Effects, OnSheet, SheetResponse};

parameters! {
    /// The room's temperature, and the sheet's response.
    TemperatureSettings {
        /// Temperature coefficient of resistance, % per degC.
        percent_per_c = -0.2, in [-1.0, 1.0], "% per degC";
        /// Amplitude of the room's cycle, degC: half the difference between the highest and the lowest temperature.
        room_c = 1.5, in [0.0, 20.0], "degC";
        /// Length of the cycle, h.
        period_h = 24.0, in [0.1, 10_000.0], "h";
        /// Interval at which the sheet is recomputed, s; changes in between are ignored.
        every_s = 60.0, in [0.001, 86_400.0], "s";
    }
}

impl Effect for TemperatureSettings {
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
