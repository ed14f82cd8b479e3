//! Conversion of voltages to readings and frames.

use std::time::{Duration, SystemTime};

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Amps, Frame, Precautions, Reading, Settings, Volts};

/// Valid readings with these voltages, V.
pub fn measured(volts: &[f64]) -> Vec<Reading> {
    volts.iter().map(|v| Reading::Ok(Volts(*v))).collect()
}

/// A frame with these readings, as a rig would return it.
pub(crate) fn plain_frame(
    readings: Vec<Reading>,
    protocol_hash: String,
    current: Amps,
    range: Volts,
) -> Frame {
    Frame {
        sequence: 0,
        readings,
        extra: Vec::new(),
        monotonic: Duration::ZERO,
        wall: SystemTime::UNIX_EPOCH.into(),
        duration: Duration::ZERO,
        settings: Settings {
            protocol_hash,
            current,
            range,
            nplc: 1.0,
            settle: Duration::ZERO,
            wiring: "simulated".into(),
            precautions: Precautions::default(),
        },
        compliance: Vec::new(),
        simulated: true,
    }
}

/// Adds white noise with a standard deviation of `noise_v`, V.
pub fn add_noise<'a>(
    volts: impl IntoIterator<Item = &'a mut f64>,
    noise_v: f64,
    random: &mut ChaCha8Rng,
) {
    let Ok(noise) = Normal::new(0.0, noise_v) else {
        return; // `noise_v` is not finite; nothing is added
    };
    for value in volts {
        *value += noise.sample(random);
    }
}
