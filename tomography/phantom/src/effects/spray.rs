//! Uneven spraying: the logarithm of the sheet's conductance is a Gaussian field with a Matern covariance.
//!
//! Standard deviation 0.05 to 0.3, correlation length 10 to 60 mm, nu 1 to 2 (fact sheet, section 2.3). The field is a
//! sum of waves with wave numbers drawn from the Matern spectrum (in the plane: k = sqrt(2 nu) / l sqrt(U^(-1/nu) -
//! 1)), so it is the same field on every mesh. It changes readings by about 10 %, and to first order it cancels in
//! difference imaging.

use std::f64::consts::{SQRT_2, TAU};
use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::bounds::parameters;
use super::{Effect, Effects, OnSheet, SheetResponse, stream};

/// Number of waves: the covariance is accurate to 1 / sqrt(waves).
const WAVES: usize = 512;

parameters! {
    /// Size and correlation of the field.
    SpraySettings {
        /// Standard deviation of ln(conductance).
        std = 0.1, in [0.0, 1.0];
        /// Correlation length, mm.
        correlation_mm = 30.0, in [1.0, 1000.0], "mm";
        /// Smoothness of the field.
        nu = 1.5, in [0.5, 4.0];
    }
}

impl Effect for SpraySettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.random_field(&spectrum(self))
    }

    fn add(&self, seed: u64, effects: &mut Effects) {
        effects
            .sheet
            .push(Box::new(Spray::new(self, stream(seed, "spray"))));
    }
}

/// The covariance as a function of the distance (m): the mean of cos(k x) over the spectrum, sampled at the midpoints
/// of intervals of equal probability.
fn spectrum(settings: &SpraySettings) -> impl Fn(f64) -> f64 {
    const SHARES: usize = 64;
    const TURNS: usize = 16;
    let length = settings.correlation_mm * 1e-3;
    let (std, nu) = (settings.std, settings.nu);
    let numbers: Vec<f64> = (0..SHARES)
        .map(|k| {
            let share = (k as f64 + 0.5) / SHARES as f64;
            (2.0 * nu).sqrt() / length * (share.powf(-1.0 / nu) - 1.0).sqrt()
        })
        .collect();
    let exact = move |distance: f64| {
        let sum: f64 = numbers
            .iter()
            .flat_map(|number| {
                (0..TURNS).map(move |turn| {
                    let turn = 0.25 * TAU * (turn as f64 + 0.5) / TURNS as f64;
                    (number * distance * turn.cos()).cos()
                })
            })
            .sum();
        std * std * sum / (SHARES * TURNS) as f64
    };
    // tabulated in steps of a twentieth of the correlation length, until the covariance vanishes
    let step = 0.05 * length;
    let table: Vec<f64> = (0..400).map(|k| exact(k as f64 * step)).collect();
    move |distance| {
        let place = distance / step;
        let (below, share) = (place.floor() as usize, place.fract());
        match table.get(below..below + 2) {
            Some(&[near, far]) => near + share * (far - near),
            _ => 0.0,
        }
    }
}

#[derive(Debug)]
pub(super) struct Spray {
    /// Wave vector, 1/m, and phase.
    waves: Vec<([f64; 2], f64)>,
    amplitude: f64,
    std: f64,
}

impl Spray {
    fn new(settings: &SpraySettings, mut stream: ChaCha8Rng) -> Self {
        let length = settings.correlation_mm * 1e-3;
        let waves = (0..WAVES)
            .map(|_| {
                let [share, turn, phase]: [f64; 3] = [(); 3].map(|()| stream.random());
                // 1 - share is in (0, 1], so zero is never raised to a negative power
                let number = (2.0 * settings.nu).sqrt() / length
                    * ((1.0 - share).powf(-1.0 / settings.nu) - 1.0).sqrt();
                let (sin, cos) = (TAU * turn).sin_cos();
                ([number * cos, number * sin], TAU * phase)
            })
            .collect();
        Self {
            waves,
            amplitude: settings.std * SQRT_2 / (WAVES as f64).sqrt(),
            std: settings.std,
        }
    }
}

impl OnSheet for Spray {
    fn act(&mut self, _at: Duration, places: &[[f64; 2]], sigma: &mut [f64]) {
        // E[exp(g)] = exp(std^2 / 2) is divided out, so that the mean conductance is the sheet's
        let mean = 0.5 * self.std * self.std;
        for (sigma, [x, y]) in sigma.iter_mut().zip(places) {
            let field: f64 = self
                .waves
                .iter()
                .map(|([a, b], phase)| (a * x + b * y + phase).cos())
                .sum();
            *sigma *= (self.amplitude * field - mean).exp();
        }
    }

    fn epoch(&self, _at: Duration) -> u64 {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::super::stream;
    use super::*;

    #[test]
    fn it_has_its_spread_and_its_length() {
        // the field at a point and 30 mm from it, over many sheets
        let settings = SpraySettings {
            nu: 0.5,
            ..SpraySettings::default()
        };
        let pairs: Vec<[f64; 2]> = (0..4000)
            .map(|seed| {
                let mut sigma = [1.0, 1.0];
                let places = [[0.05, 0.05], [0.08, 0.05]];
                Spray::new(&settings, stream(seed, "spray")).act(
                    Duration::ZERO,
                    &places,
                    &mut sigma,
                );
                sigma.map(|sigma| sigma.ln() + 0.005)
            })
            .collect();
        let mean = |of: fn(&[f64; 2]) -> f64| pairs.iter().map(of).sum::<f64>() / 4000.0;
        let variance = mean(|[a, _]| a * a);
        assert!((variance / 0.01 - 1.0).abs() < 0.08, "{variance}");
        // the Matern covariance with nu = 1/2 is exp(-distance / length)
        let together = mean(|[a, b]| a * b) / variance;
        assert!((together - (-1.0_f64).exp()).abs() < 0.05, "{together}");
    }
}
