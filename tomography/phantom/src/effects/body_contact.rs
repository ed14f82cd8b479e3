//! Body contact: a body on the sheet warms it, and heat diffuses into the foam.
//!
//! Foam of thickness L and diffusivity D, one face at the body's temperature under a load and at the room's otherwise,
//! the other face insulated. The conductance follows the mean temperature over the thickness, which is a sum of modes:
//! c (1 - sum 8 / (pi² m²) exp(-m² t / tau)), m = 1, 3, 5, ..., tau = 4 L² / (pi² D) (Carslaw and Jaeger, Conduction of
//! heat in solids, section 3.4). Each mode follows any history of contact exactly. Eight modes are computed, the others
//! (2.5 %) act immediately, with an error below 1e-3 from 0.02 tau on. The conductance is sigma (1 - alpha T) as in
//! `temperature`.
//!
//! Typical values: 8 degC above the room's temperature under a body, tau 1 to 10 min, alpha -0.05 to -0.4 % per degC
//! (fact sheet, section 2.3). Conduction along the sheet, sqrt(D t) or some millimetres in an hour, is ignored. Every
//! load is treated as a body.

use std::f64::consts::PI;
use std::time::Duration;

use super::bounds::parameters;
use super::creep::PronyStep;
use super::{Effect, Effects, OnLoss, Places, SheetResponse};

parameters! {
    /// Temperature of the body, and the sheet's response.
    BodyContactSettings {
        /// Temperature above the room's, degC.
        c = 8.0, in [-20.0, 20.0], "degC";
        /// Time constant of the slowest mode, s.
        tau_s = 300.0, in [1.0, 1e5], "s";
        /// Coefficient of resistance, % per degC.
        percent_per_c = -0.2, in [-1.0, 1.0], "% per degC";
        /// Interval at which the sheet is recomputed, s; changes in between are ignored.
        every_s = 10.0, in [0.001, 86_400.0], "s";
    }
}

impl Effect for BodyContactSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| effects.body_contact = on.then(|| self.clone()))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.losses.push(Box::new(BodyContact::new(self)));
    }
}

/// Number of modes computed.
const MODES: usize = 8;
/// Without a load a smaller delayed part is set to zero, as a share of the body's temperature.
const NOTHING: f64 = 1e-12;

/// Share and time constant of a mode, the latter in units of tau.
fn mode(number: usize) -> [f64; 2] {
    let m = (2 * number + 1) as f64;
    [8.0 / (PI * PI * m * m), 1.0 / (m * m)]
}

#[derive(Debug)]
struct BodyContact {
    settings: BodyContactSettings,
    /// For each triangle: whether it was loaded at the last update, and the delayed part of each mode.
    held: Vec<(bool, [f64; MODES])>,
}

impl BodyContact {
    fn new(settings: &BodyContactSettings) -> Self {
        Self {
            settings: settings.clone(),
            held: Vec::new(),
        }
    }
}

impl OnLoss for BodyContact {
    fn follow(&mut self, past: f64, places: &Places<'_>, losses: &mut [f64]) {
        let BodyContactSettings {
            c,
            tau_s,
            percent_per_c,
            ..
        } = self.settings;
        let steps: [(f64, PronyStep); MODES] = std::array::from_fn(|number| {
            let [share, part] = mode(number);
            // a contact begins as a step: the delayed part is at first the whole share of the mode, then decays
            let decay = PronyStep::new(0.0, past / (part * tau_s));
            (share, decay)
        });
        self.held.resize(losses.len(), (false, [0.0; MODES]));
        for ((lay, held), (pressed, loss)) in
            self.held.iter_mut().zip(places.pressed.iter().zip(losses))
        {
            let lies = *pressed != 0.0;
            let change = f64::from(u8::from(lies)) - f64::from(u8::from(*lay));
            if change == 0.0 && held[0] == 0.0 && !lies {
                continue;
            }
            *lay = lies;
            for (held, (share, decay)) in held.iter_mut().zip(&steps) {
                *held = decay.held(*held, 0.0) + share * change;
            }
            let behind: f64 = held.iter().sum();
            if !lies && behind.abs() < NOTHING {
                *held = [0.0; MODES];
                continue;
            }
            let warmer = c * (f64::from(u8::from(lies)) - behind);
            *loss -= (-percent_per_c / 100.0 * warmer).ln_1p();
        }
    }

    fn every(&self) -> Option<Duration> {
        Some(survey::duration(self.settings.every_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TAU: f64 = 100.0;

    fn body() -> BodyContact {
        BodyContact::new(&BodyContactSettings {
            c: 8.0,
            tau_s: TAU,
            percent_per_c: -0.2,
            every_s: 1.0,
        })
    }

    /// The mean temperature of the foam as a share of the body's, computed from the change of the loss.
    fn warmth(body: &mut BodyContact, past: f64, pressed: f64) -> f64 {
        let places = Places {
            pressed: &[pressed],
            ..Places::default()
        };
        let mut losses = [pressed];
        body.follow(past, &places, &mut losses);
        ((pressed - losses[0]).exp() - 1.0) / (0.002 * 8.0)
    }

    /// Mean temperature after a contact of this many tau, by a series that converges quickly for short times: images of
    /// a face held at constant temperature, 2 sqrt(x) (1 / sqrt(pi) + 2 sum (-1)^n ierfc(n / sqrt(x))), x = D t / L² =
    /// 4 t / (pi² tau). Below x = 0.1 the sum is less than 1e-5.
    fn shortly(t_tau: f64) -> f64 {
        2.0 * (4.0 * t_tau / (PI * PI) / PI).sqrt()
    }

    #[test]
    fn warming_is_that_of_a_slab_with_one_face_kept_warm() {
        for t in [0.02, 0.05, 0.1, 0.2] {
            let mut foam = body();
            warmth(&mut foam, 0.0, 0.5);
            let seen = warmth(&mut foam, t * TAU, 0.5);
            assert!(
                (seen - shortly(t)).abs() < 1e-4 * shortly(t) + 1e-4,
                "{t}: {seen}"
            );
        }
        // at late times only the slowest mode remains
        let mut foam = body();
        warmth(&mut foam, 0.0, 0.5);
        let seen = warmth(&mut foam, 3.0 * TAU, 0.5);
        let wanted = 1.0 - 8.0 / (PI * PI) * (-3.0_f64).exp();
        assert!((seen - wanted).abs() < 1e-10, "{seen} {wanted}");
    }

    #[test]
    fn steps_of_any_size_end_at_the_same_warmth_and_cool_again() {
        let mut whole = body();
        warmth(&mut whole, 0.0, 0.3);
        let once = warmth(&mut whole, 60.0, 0.3);
        let mut pieces = body();
        warmth(&mut pieces, 0.0, 0.3);
        let mut many = 0.0;
        for _ in 0..600 {
            // the temperature does not depend on the force
            many = warmth(&mut pieces, 0.1, 0.7);
        }
        assert!((once - many).abs() < 1e-12, "{once} {many}");
        // after removal: warming minus cooling since then, by superposition
        let left = warmth(&mut whole, 0.0, 0.0);
        assert!(
            (left - (once - (1.0 - (0..MODES).map(|k| mode(k)[0]).sum::<f64>()))).abs() < 1e-12
        );
        let later = warmth(&mut whole, 40.0, 0.0);
        let wanted: f64 = (0..MODES)
            .map(|k| {
                let [share, part] = mode(k);
                let left = |t: f64| (-t / (part * TAU)).exp();
                share * (left(40.0) - left(100.0))
            })
            .sum();
        assert!((later - wanted).abs() < 1e-12, "{later} {wanted}");
        assert_eq!(warmth(&mut whole, 1e5, 0.0), 0.0);
    }
}
