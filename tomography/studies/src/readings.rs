//! Voltages as a rig returns them.

use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use survey::{Reading, Volts};

/// Valid readings.
pub fn measured(volts: &[f64]) -> Vec<Reading> {
    volts.iter().map(|v| Reading::Ok(Volts(*v))).collect()
}

/// Adds white noise, standard deviation in V.
pub fn add_noise<'a>(
    volts: impl IntoIterator<Item = &'a mut f64>,
    noise_v: f64,
    random: &mut ChaCha8Rng,
) {
    let Ok(noise) = Normal::new(0.0, noise_v) else {
        return; // not a finite number: there is none to add
    };
    for value in volts {
        *value += noise.sample(random);
    }
}
