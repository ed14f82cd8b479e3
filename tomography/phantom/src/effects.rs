//! Imperfections of the readings: none, until a scene asks. Each is one file with its physics, formula and source.

mod quantisation;
mod voltmeter_noise;

use std::fmt;
use std::time::Duration;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use survey::{Relay, Volts};

pub use quantisation::QuantisationSettings;
pub use voltmeter_noise::VoltmeterNoiseSettings;

/// How a reading is taken, as far as an effect may depend on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadingContext {
    /// When.
    pub at: Duration,
    /// The voltmeter's range.
    pub range: Volts,
    /// Integration in power-line cycles.
    pub nplc: f64,
    /// The channel that leads to the voltmeter; `None` for its bare input.
    pub relay: Option<Relay>,
}

/// The effects that a scene names; the order of the fields is the order in which a reading meets them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct EffectSettings {
    /// Noise of the voltmeter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub voltmeter_noise: Option<VoltmeterNoiseSettings>,
    /// Steps of the voltmeter's converter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quantisation: Option<QuantisationSettings>,
}

impl EffectSettings {
    /// What is wrong with them, in words; `None` when nothing is.
    pub(crate) fn fault(&self) -> Option<String> {
        let noise = self.voltmeter_noise.as_ref().and_then(|noise| noise.uv);
        let step = self.quantisation.as_ref().and_then(|steps| steps.step_uv);
        [
            ("effects.voltmeter-noise.uv", noise),
            ("effects.quantisation.step_uv", step),
        ]
        .into_iter()
        .find_map(|(key, value)| {
            value
                .filter(|value| !(*value >= 0.0 && value.is_finite()))
                .map(|value| format!("{key} is {value}, it must be zero or more"))
        })
    }
}

/// One imperfection of a reading.
pub(crate) trait OnReading: fmt::Debug + Send {
    /// The voltage as it leaves the effect.
    fn bend(&mut self, volts: Volts, context: &ReadingContext) -> Volts;
}

/// The effects that a scene named, in order.
#[derive(Debug)]
pub(crate) struct Effects {
    readings: Vec<Box<dyn OnReading>>,
}

impl Effects {
    pub(crate) fn new(settings: &EffectSettings, seed: u64) -> Self {
        let mut readings: Vec<Box<dyn OnReading>> = Vec::new();
        if let Some(noise) = &settings.voltmeter_noise {
            let stream = stream(seed, "voltmeter-noise");
            readings.push(Box::new(voltmeter_noise::VoltmeterNoise::new(
                noise, stream,
            )));
        }
        if let Some(steps) = &settings.quantisation {
            readings.push(Box::new(quantisation::Quantisation::new(steps)));
        }
        Self { readings }
    }

    pub(crate) fn reading(&mut self, exact: Volts, context: &ReadingContext) -> Volts {
        self.readings
            .iter_mut()
            .fold(exact, |volts, effect| effect.bend(volts, context))
    }
}

/// An effect's own random stream: switching one on never changes another's numbers.
fn stream(seed: u64, effect: &str) -> ChaCha8Rng {
    let mut hasher = Sha256::new();
    hasher.update(seed.to_le_bytes());
    hasher.update(effect.as_bytes());
    ChaCha8Rng::from_seed(hasher.finalize().into())
}

/// The voltmeter's resolution as a share of its range, by integration time (34970A family, integration-time table; the
/// fact sheet, section 2.1, takes it as rms noise): straight lines in log-log between the table's points.
fn resolution(nplc: f64) -> f64 {
    const TABLE: [[f64; 2]; 8] = [
        [0.02, 1e-4],
        [0.2, 1e-5],
        [1.0, 3e-6],
        [2.0, 2.2e-6],
        [10.0, 1e-6],
        [20.0, 8e-7],
        [100.0, 3e-7],
        [200.0, 2.2e-7],
    ];
    let nplc = nplc.clamp(TABLE[0][0], TABLE[TABLE.len() - 1][0]);
    let upper = TABLE
        .iter()
        .position(|[at, _]| *at >= nplc)
        .unwrap_or(TABLE.len() - 1);
    let [right, high] = TABLE[upper];
    if right == nplc {
        return high;
    }
    let [left, low] = TABLE[upper - 1];
    let share = (nplc / left).ln() / (right / left).ln();
    low * (high / low).powf(share)
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn context(range: f64, nplc: f64) -> ReadingContext {
        ReadingContext {
            at: Duration::ZERO,
            range: Volts(range),
            nplc,
            relay: None,
        }
    }

    #[test]
    fn nothing_asked_changes_no_bit() {
        let mut none = Effects::new(&EffectSettings::default(), 1);
        for volts in [0.0, -0.0, 1.0 / 3.0, -5e-324, 9.9e37] {
            let got = none.reading(Volts(volts), &context(1.0, 1.0));
            assert_eq!(got.0.to_bits(), volts.to_bits());
        }
    }

    #[test]
    fn another_effect_does_not_shift_the_noise() {
        let noise = VoltmeterNoiseSettings { uv: Some(2.0) };
        let both = EffectSettings {
            voltmeter_noise: Some(noise.clone()),
            quantisation: Some(QuantisationSettings { step_uv: Some(0.0) }),
        };
        let alone = EffectSettings {
            voltmeter_noise: Some(noise),
            quantisation: None,
        };
        let draw = |settings: &EffectSettings, seed| -> Vec<u64> {
            let mut effects = Effects::new(settings, seed);
            (0..20)
                .map(|_| effects.reading(Volts(0.1), &context(1.0, 1.0)).0.to_bits())
                .collect()
        };
        assert_eq!(draw(&both, 7), draw(&alone, 7));
        assert_ne!(draw(&both, 7), draw(&both, 8));
    }

    #[test]
    fn the_table_is_met_and_joined() {
        assert_eq!(resolution(1.0), 3e-6);
        assert_eq!(resolution(0.001), 1e-4);
        assert_eq!(resolution(1000.0), 2.2e-7);
        let between = resolution(5.0);
        assert!(between < 2.2e-6 && between > 1e-6);
    }
}
