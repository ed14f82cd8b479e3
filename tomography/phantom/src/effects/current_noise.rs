//! Noise of the source: v (1 + n / I), n a share of the source's range.
//!
//! 0.1 to 10 Hz, rms: 4 nA on 200 uA, 40 nA on 2 mA, 0.4 uA on 20 mA (fact sheet, section 2.2): 2e-5 of the range. It
//! scales all readings at a given time by the same factor, so it matters most for large ones.
//!
//! Above 10 Hz, rms to the full bandwidth B: 0.2 uA on 200 uA, 1 uA on 2 mA, 4 uA on 20 mA, B = 1 MHz (specification of
//! the 6221): 1000, 500, 200 ppm of the range. The integration over T averages it: noise that is white up to B is
//! reduced to the share 1 / sqrt(2 B T), 1 uA to 5 nA in 20 ms.

use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use survey::Volts;

use super::bounds::parameters;
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

parameters! {
    /// Size of the noise.
    CurrentNoiseSettings {
        /// Rms as a share of the source's range, parts per million.
        range_ppm = 20.0, in [0.0, 1e5], "ppm";
        /// Rms of the band above 10 Hz as a share of the source's range, parts per million, before the integration
        /// averages it; 0 for none.
        wide_ppm = 0.0, in [0.0, 1e5], "ppm";
        /// Width of that band, kHz.
        wide_khz = 1000.0, in [1.0, 1e5], "kHz";
    }
}

impl CurrentNoiseSettings {
    /// Rms in one reading as a share of the source's range.
    fn share(&self, integration: Duration) -> f64 {
        let slow = self.range_ppm * 1e-6;
        if self.wide_ppm == 0.0 {
            return slow;
        }
        let samples = 2.0 * self.wide_khz * 1e3 * integration.as_secs_f64();
        slow.hypot(self.wide_ppm * 1e-6 / samples.max(1.0).sqrt())
    }
}

impl Effect for CurrentNoiseSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| {
            let share = self.share(sight.context.integration);
            sight.exact * share * sight.context.source_range.0 / sight.context.flowing.0
        })
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(CurrentNoise {
            settings: self.clone(),
            stream: stream(seed, "current-noise"),
        }));
    }
}

#[derive(Debug)]
pub(super) struct CurrentNoise {
    settings: CurrentNoiseSettings,
    stream: ChaCha8Rng,
}

impl OnReading for CurrentNoise {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        // drawn even without current, so that the other readings get the same numbers
        let draw: f64 = StandardNormal.sample(&mut self.stream);
        if context.flowing.0 == 0.0 {
            return volts;
        }
        let noise = self.settings.share(context.integration) * context.source_range.0 * draw;
        Volts(volts.0 * (1.0 + noise / context.flowing.0))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EffectSettings, Effects, tests::context};
    use super::*;

    /// Rms of readings of 1 V at 1 mA on the 2 mA range, as a share of the range.
    fn rms(settings: CurrentNoiseSettings, nplc: f64) -> f64 {
        let settings = EffectSettings {
            current_noise: Some(settings),
            ..EffectSettings::default()
        };
        let mut effects = Effects::new(&settings, 3);
        let count = 20_000;
        let sum: f64 = (0..count)
            .map(|_| (effects.reading(Volts(1.0), &context(1.0, nplc)).0 - 1.0).powi(2))
            .sum();
        0.5 * (sum / f64::from(count)).sqrt()
    }

    #[test]
    fn the_band_above_10_hz_averages_with_the_integration() {
        let wide = |nplc| {
            let settings = CurrentNoiseSettings {
                range_ppm: 0.0,
                wide_ppm: 500.0,
                wide_khz: 1000.0,
            };
            rms(settings, nplc)
        };
        // 1 uA of 2 mA: 5 nA in 20 ms, 35 nA in 0.4 ms
        for (nplc, amps) in [(1.0, 5e-9), (0.02, 35.4e-9)] {
            let seen = wide(nplc) * 2e-3;
            assert!((seen / amps - 1.0).abs() < 0.02, "{nplc}: {seen}");
        }
        let both = CurrentNoiseSettings {
            wide_ppm: 500.0,
            ..CurrentNoiseSettings::default()
        };
        let wanted = 40e-9_f64.hypot(35.4e-9);
        let seen = rms(both, 0.02) * 2e-3;
        assert!((seen / wanted - 1.0).abs() < 0.02, "{seen}");
    }
}
