//! Power-law creep: under a constant load the loss grows by the same factor in every decade of time.
//!
//! Stress relaxes as t^-n, strain grows as t^n, n = 0.02 to 0.1 (fact sheet, section 2.4): a step of the log loss e
//! becomes e (1 + t / t_0)^n, without a final time constant. Changes are superposed (Boltzmann), so the loss decays as
//! slowly after the load is removed.
//!
//! The law is approximated by a sum of exponentials: (1 + s)^n is 1 plus n / Gamma(1 - n) times the integral of
//! u^(-n-1) e^-u (1 - e^-su) du, computed by the trapezoid rule in ln u with three points per decade. The error is below
//! 1e-5 for t up to a century. The update of each exponential is exact for any step, as in `creep`.

use super::bounds::parameters;
use super::creep::PronySeries;
use super::{Effect, Effects, SheetResponse};

parameters! {
    /// Size and start of the creep.
    PowerLawCreepSettings {
        /// n: the loss grows by 10^n per decade of time.
        exponent = 0.03, in [0.0, 0.3];
        /// t_0, the time up to which the loss hardly grows, s.
        from_s = 1.0, in [0.001, 86_400.0], "s";
        /// Interval at which the sheet is recomputed, s; changes in between are ignored.
        every_s = 10.0, in [0.001, 86_400.0], "s";
    }
}

/// Longest time for which the approximation holds, s: a century.
const LONGEST: f64 = 3.2e9;
/// Number of points of the integral per decade.
const POINTS: f64 = 3.0;

impl PowerLawCreepSettings {
    /// Share and time constant (s) of the exponentials that approximate the law.
    fn terms(&self) -> Vec<[f64; 2]> {
        let step = std::f64::consts::LN_10 / POINTS;
        // e^-u is negligible for u beyond e^4; terms with u far below t_0 / LONGEST do not grow within the longest time
        let lowest = (self.from_s / LONGEST).ln() - 5.0 * std::f64::consts::LN_10;
        let count = ((4.0 - lowest) / step).ceil() as u32;
        let front = self.exponent / gamma(1.0 - self.exponent);
        (0..=count)
            .map(|k| {
                let u = (lowest + step * f64::from(k)).exp();
                let share = front * step * u.powf(-self.exponent) * (-u).exp();
                [share, self.from_s / u]
            })
            .collect()
    }
}

/// Gamma function for 0.5 to 1, by Stirling's series at x + 8.
fn gamma(x: f64) -> f64 {
    let y = x + 8.0;
    let series = 1.0 / (12.0 * y) - 1.0 / (360.0 * y.powi(3)) + 1.0 / (1260.0 * y.powi(5));
    let stirling = (y - 0.5) * y.ln() - y + 0.5 * std::f64::consts::TAU.ln() + series;
    let down: f64 = (0..8).map(|k| x + f64::from(k)).product();
    stirling.exp() / down
}

impl Effect for PowerLawCreepSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| effects.power_law_creep = on.then(|| self.clone()))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        let every = survey::duration(self.every_s);
        effects
            .losses
            .push(Box::new(PronySeries::new(self.terms(), every)));
    }
}

#[cfg(test)]
mod tests {
    use super::super::{OnLoss, Places};
    use super::*;

    fn follow(creep: &mut PronySeries, past: f64, input: f64) -> f64 {
        let mut losses = [input];
        creep.follow(past, &Places::default(), &mut losses);
        losses[0]
    }

    fn creep(exponent: f64, from_s: f64) -> PronySeries {
        let settings = PowerLawCreepSettings {
            exponent,
            from_s,
            every_s: 1.0,
        };
        PronySeries::new(settings.terms(), survey::duration(1.0))
    }

    #[test]
    fn gamma_is_that_of_the_tables() {
        for (x, wanted) in [
            (1.0, 1.0),
            (0.5, std::f64::consts::PI.sqrt()),
            (0.9, 1.068_628_702_119_319),
        ] {
            assert!((gamma(x) - wanted).abs() < 1e-9, "{x}: {}", gamma(x));
        }
    }

    #[test]
    fn a_step_grows_by_the_power_law_from_seconds_to_years() {
        for (exponent, from_s) in [(0.02, 1.0), (0.1, 1.0), (0.05, 60.0)] {
            let mut foam = creep(exponent, from_s);
            assert_eq!(follow(&mut foam, 0.0, 0.4), 0.4);
            let mut t = 0.0;
            for past in [1.0, 9.0, 3590.0, 82_800.0, 2.5e6, 6e7] {
                t += past;
                let seen = follow(&mut foam, past, 0.4);
                let wanted = 0.4 * (1.0 + t / from_s).powf(exponent);
                assert!(
                    (seen - wanted).abs() < 1e-5 * wanted,
                    "{exponent} {t}: {seen} {wanted}"
                );
            }
        }
    }

    #[test]
    fn a_load_that_is_taken_away_leaves_a_trail_by_superposition() {
        let law = |t: f64| (1.0 + t).powf(0.1);
        for t in [10.0, 1000.0] {
            let mut later = creep(0.1, 1.0);
            follow(&mut later, 0.0, 0.4);
            follow(&mut later, 3600.0, 0.4);
            follow(&mut later, 0.0, 0.0);
            let seen = follow(&mut later, t, 0.0);
            let wanted = 0.4 * (law(3600.0 + t) - law(t));
            assert!((seen - wanted).abs() < 1e-5, "{t}: {seen} {wanted}");
        }
    }
}
