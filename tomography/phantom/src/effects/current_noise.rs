//! Noise of the source: v (1 + n / I), n a share of the source's range.
//!
//! 0.1 to 10 Hz, rms: 4 nA on 200 uA, 40 nA on 2 mA, 0.4 uA on 20 mA (fact sheet, section 2.2): 2e-5 of the range. It
//! scales all readings at a given time by the same factor, so it matters most for large ones.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use survey::Volts;

use super::bounds::{Bounds, Fault};
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

/// Size of the noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CurrentNoiseSettings {
    /// Rms as a share of the source's range, parts per million.
    pub range_ppm: f64,
}

impl Default for CurrentNoiseSettings {
    fn default() -> Self {
        Self { range_ppm: 20.0 }
    }
}

impl Effect for CurrentNoiseSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("range_ppm", self.range_ppm, [0.0, 1e5], "ppm")
            .end()
    }

    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        let share = self.range_ppm * 1e-6;
        response.rms(&|sight| {
            sight.exact * share * sight.context.source_range.0 / sight.context.flowing.0
        })
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(CurrentNoise::new(
            self,
            stream(seed, "current-noise"),
        )));
    }
}

#[derive(Debug)]
pub(super) struct CurrentNoise {
    share: f64,
    stream: ChaCha8Rng,
}

impl CurrentNoise {
    fn new(settings: &CurrentNoiseSettings, stream: ChaCha8Rng) -> Self {
        Self {
            share: settings.range_ppm * 1e-6,
            stream,
        }
    }
}

impl OnReading for CurrentNoise {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        // Drawn even without current, so that an additional reading shifts no other number.
        let draw: f64 = StandardNormal.sample(&mut self.stream);
        if context.flowing.0 == 0.0 {
            return volts;
        }
        let noise = self.share * context.source_range.0 * draw;
        Volts(volts.0 * (1.0 + noise / context.flowing.0))
    }
}
