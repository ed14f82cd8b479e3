//! Drift over hours to months: fluctuations on every time scale, a random walk, and running-in.
//!
//! ln(sigma) = sum of Ornstein-Uhlenbeck processes with time constants an octave and a half apart from 1 h to 30 d
//! (about 1/f) + a random walk of 0.01 to 0.1 % per square root of a day + running-in, 1 to 10 % that decay
//! exponentially over the first days (fact sheet, section 2.3). It dominates over months; leave it out below an hour.

use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::bounds::parameters;
use super::wander::Wander;
use super::{Effect, Effects, OnSheet, SheetResponse, stream};

/// Time constants, h.
const HOURS: [f64; 7] = [1.0, 3.0, 9.0, 27.0, 81.0, 243.0, 720.0];

parameters! {
    /// Sizes of the parts of the drift.
    LongDriftSettings {
        /// Rms of the sum of the Ornstein-Uhlenbeck processes, %.
        wander_percent = 0.3, in [0.0, 10.0], "%";
        /// Random walk, % per square root of a day.
        walk_percent = 0.05, in [0.0, 5.0], "%";
        /// Running-in: total gain of conductance, %.
        running_in_percent = 3.0, in [-20.0, 20.0], "%";
        /// Time constant of the running-in, d.
        running_in_days = 2.0, in [0.01, 100.0], "d";
        /// Interval at which the sheet is recomputed, s; changes in between are ignored.
        every_s = 60.0, in [0.001, 86_400.0], "s";
    }
}

impl Effect for LongDriftSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        // the variances of the parts depend on time differently
        let size = response.over_time(&|at| {
            let days = at / 86_400.0;
            let ran_in = -self.running_in_percent * (-days / self.running_in_days).exp_m1();
            (self.wander_percent.powi(2) + self.walk_percent.powi(2) * days + ran_in.powi(2)).sqrt()
        });
        response.uniform() * size / 100.0
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.sheet.push(Box::new(LongDrift::new(self, seed)));
    }
}

#[derive(Debug)]
pub(super) struct LongDrift {
    settings: LongDriftSettings,
    wander: Vec<Wander>,
    walk: RandomWalk,
}

/// A random walk whose standard deviation grows with the square root of time; time must not decrease.
#[derive(Debug)]
struct RandomWalk {
    stream: ChaCha8Rng,
    at_s: f64,
    value: f64,
}

impl LongDrift {
    fn new(settings: &LongDriftSettings, seed: u64) -> Self {
        let wander = HOURS.map(|hours| {
            let tau = survey::duration(hours * 3600.0);
            Wander::new(tau, stream(seed, &format!("long-drift {hours} h")))
        });
        Self {
            settings: settings.clone(),
            wander: wander.into(),
            walk: RandomWalk {
                stream: stream(seed, "long-drift walk"),
                at_s: 0.0,
                value: 0.0,
            },
        }
    }
}

impl OnSheet for LongDrift {
    fn act(&mut self, at: Duration, _places: &[[f64; 2]], sigma: &mut [f64]) {
        let settings = &self.settings;
        let seconds = self.epoch(at) as f64 * settings.every_s;
        let at = survey::duration(seconds);
        let share = settings.wander_percent / 100.0 / (HOURS.len() as f64).sqrt();
        let wandered: f64 = self
            .wander
            .iter_mut()
            .map(|wander| share * wander.at(at))
            .sum();
        if seconds > self.walk.at_s {
            let days = (seconds - self.walk.at_s) / 86_400.0;
            let draw: f64 = StandardNormal.sample(&mut self.walk.stream);
            self.walk.value += settings.walk_percent / 100.0 * days.sqrt() * draw;
            self.walk.at_s = seconds;
        }
        let gone = -(-seconds / 86_400.0 / settings.running_in_days).exp_m1();
        let factor =
            (wandered + self.walk.value + settings.running_in_percent / 100.0 * gone).exp();
        for sigma in sigma {
            *sigma *= factor;
        }
    }

    fn epoch(&self, at: Duration) -> u64 {
        (at.as_secs_f64() / self.settings.every_s) as u64
    }
}
