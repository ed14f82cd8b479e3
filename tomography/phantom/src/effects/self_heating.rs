//! Self-heating: the injected current warms the sheet, and the sheet's resistance follows.
//!
//! The reading is v / (1 - alpha dT) with the mean warming dT: C d(dT)/dt = I² R - dT / R_th, solved exactly from
//! reading to reading. The power is that of the reading since current or relays last changed, and zero before. 1 mW
//! over 492 cm2 (fact sheet, section 2.3); with 10 W / (m2 K) on both sides R_th is 1 degC / W: 2e-6 of a reading.
//! Leave it out up to 5 mA.

use std::time::Duration;

use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, Needs, OnReading, SheetResponse};
use crate::scan::ReadingContext;

parameters! {
    /// Warming of the sheet, and its effect on the resistance.
    SelfHeatingSettings {
        /// Final warming per power, degC per W.
        c_per_w = 1.0, in [0.0, 1000.0], "degC per W";
        /// Time constant, s.
        tau_s = 60.0, in [0.1, 1e5], "s";
        /// Coefficient of resistance, % per degC.
        percent_per_c = -0.2, in [-1.0, 1.0], "% per degC";
    }
}

impl Effect for SelfHeatingSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        // duration of the heating before a frame: zero with pauses between frames, otherwise half of the scan
        let scan = response.scan();
        let warm = if scan.every > scan.frame_time() {
            0.0
        } else {
            scan.frame_time().as_secs_f64() * 0.5 * scan.frames.saturating_sub(1) as f64
        };
        response.rms(&|sight| {
            let power = sight.context.flowing.0.powi(2) * sight.context.load_resistance.0;
            let heated = sight.context.at.as_secs_f64() + warm;
            let warmer = self.c_per_w * power * -(-heated / self.tau_s).exp_m1();
            sight.exact * self.percent_per_c / 100.0 * warmer
        })
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(SelfHeating {
            settings: self.clone(),
            last: Duration::ZERO,
            warmer: 0.0,
        }));
    }
}

#[derive(Debug)]
struct SelfHeating {
    settings: SelfHeatingSettings,
    last: Duration,
    /// degC
    warmer: f64,
}

impl OnReading for SelfHeating {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let power = context.flowing.0.powi(2) * context.load_resistance.0;
        let power = if power.is_finite() { power } else { 0.0 };
        let past = context.at.saturating_sub(self.last);
        self.last = self.last.max(context.at);
        let heated = past.min(context.since_change);
        let over = |time: Duration| time.as_secs_f64() / self.settings.tau_s;
        self.warmer *= (-over(past - heated)).exp();
        let end = self.settings.c_per_w * power;
        self.warmer += (end - self.warmer) * -(-over(heated)).exp_m1();
        // the model is valid for small changes; the lower limit keeps the result finite for impossible warming
        let left = (1.0 - self.settings.percent_per_c / 100.0 * self.warmer).max(0.1);
        Volts(volts.0 / left)
    }

    fn needs(&self) -> Needs {
        Needs::LOAD_RESISTANCE
    }
}

#[cfg(test)]
mod tests {
    use survey::Ohms;

    use super::super::tests::context;
    use super::*;

    #[test]
    fn self_heating_approaches_power_times_thermal_resistance() {
        let mut effects = Effects::default();
        let settings = SelfHeatingSettings {
            c_per_w: 1000.0,
            tau_s: 50.0,
            percent_per_c: -0.2,
        };
        settings.add(1, &mut effects);
        let mut reading = |seconds: u64, since: u64| {
            let context = ReadingContext {
                at: Duration::from_secs(seconds),
                since_change: Duration::from_secs(since),
                load_resistance: Ohms(2e3),
                ..context(1.0, 1.0)
            };
            1.0 / effects.reading(Volts(1.0), &context).0
        };
        // the final warming by 2 mW is 2 degC
        for seconds in [0, 7, 50, 51, 2000] {
            let warmer = 2.0 * (1.0 - (-(seconds as f64) / 50.0).exp());
            let wanted = 1.0 + 0.002 * warmer;
            assert!((reading(seconds, seconds) - wanted).abs() < 1e-14);
        }
        // 100 s without current, then 10 s with it
        let warmer = 2.0 * ((-110.0_f64 / 50.0).exp() + 1.0 - (-0.2_f64).exp());
        assert!((reading(2110, 10) - 1.0 - 0.002 * warmer).abs() < 1e-14);
    }
}
