//! Noise of the voltmeter: n ~ N(0, s²) on each reading.
//!
//! s is fixed, or equal to the voltmeter's resolution at its integration time, which is used as rms: 0.3 uV at 1 PLC on
//! 0.1 V, 1 mV at 0.02 PLC on 10 V.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use survey::Volts;

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnReading, SheetResponse, stream};
use crate::scan::ReadingContext;

/// Size of the noise.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VoltmeterNoiseSettings {
    /// Fixed rms of one reading, uV; by default derived from range and NPLC.
    pub uv: Option<f64>,
}

impl VoltmeterNoiseSettings {
    /// Rms of the noise of one reading, V.
    pub(crate) fn volts(&self, context: &ReadingContext) -> f64 {
        self.uv
            .map_or_else(|| context.resolution * context.range.0, |uv| uv * 1e-6)
    }
}

impl Parameters for VoltmeterNoiseSettings {
    fn check(&self) -> Result<(), Fault> {
        Bounds::new()
            .within("uv", self.uv.unwrap_or(0.0), [0.0, 1e6], "uV")
            .end()
    }
}

impl Effect for VoltmeterNoiseSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.rms(&|sight| self.volts(&sight.context))
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects.readings.push(Box::new(VoltmeterNoise {
            settings: self.clone(),
            stream: stream(seed, "voltmeter-noise"),
        }));
    }
}

#[derive(Debug)]
pub(super) struct VoltmeterNoise {
    settings: VoltmeterNoiseSettings,
    stream: ChaCha8Rng,
}

impl OnReading for VoltmeterNoise {
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts {
        let rms = self.settings.volts(context);
        let draw: f64 = StandardNormal.sample(&mut self.stream);
        Volts(volts.0 + rms * draw)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EffectSettings, Effects, tests::context};
    use super::*;

    fn rms(settings: VoltmeterNoiseSettings, range: f64, nplc: f64) -> f64 {
        let settings = EffectSettings {
            voltmeter_noise: Some(settings),
            ..EffectSettings::default()
        };
        let mut effects = Effects::new(&settings, 3);
        let count = 20_000;
        let sum: f64 = (0..count)
            .map(|_| effects.reading(Volts(0.0), &context(range, nplc)).0.powi(2))
            .sum();
        (sum / f64::from(count)).sqrt()
    }

    #[test]
    fn noise_has_the_given_strength() {
        let fixed = rms(VoltmeterNoiseSettings { uv: Some(2.0) }, 10.0, 1.0);
        assert!((fixed / 2e-6 - 1.0).abs() < 0.02, "{fixed}");
        let by_range = rms(VoltmeterNoiseSettings::default(), 0.1, 1.0);
        assert!((by_range / 0.3e-6 - 1.0).abs() < 0.02, "{by_range}");
    }
}
