//! Creep: under a constant load the loss keeps growing; after the load is removed, part of it decays slowly.
//!
//! A Prony series for each triangle: a step of the log loss e (e = -ln(sigma / sigma_0), proportional to the strain)
//! becomes e (1 + sum g_i (1 - exp(-t / tau_i))). The delayed parts h_i follow a straight input exactly, `h <- exp(-x)
//! h + g (1 - exp(-x)) / x de` with x = dt / tau (a series below x = 1e-4), so any step size is exact. sum g = 0.1 to
//! 0.4, tau 1 to 1e4 s, 10 to 30 % in an hour (fact sheet, section 2.4). Leave it out for frames within a second of
//! each other. Delayed parts below 1e-13 are set to zero.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnLoss, Places, SheetResponse};

/// Size and speed of the creep.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CreepSettings {
    /// Final contribution of each term, % of the log loss.
    pub percent: Vec<f64>,
    /// Time constant of each term, s.
    pub tau_s: Vec<f64>,
    /// Interval at which the sheet is recomputed, s; changes in between are ignored.
    pub every_s: f64,
}

impl Default for CreepSettings {
    fn default() -> Self {
        Self {
            percent: vec![5.0, 5.0, 10.0],
            tau_s: vec![10.0, 100.0, 1000.0],
            every_s: 10.0,
        }
    }
}

impl Parameters for CreepSettings {
    fn check(&self) -> Result<(), Fault> {
        if self.percent.len() != self.tau_s.len() || self.percent.is_empty() {
            return Err(Fault {
                key: "tau_s",
                why: format!(
                    "has {} numbers, it must have one for each of the {} of percent, and at least one",
                    self.tau_s.len(),
                    self.percent.len()
                ),
            });
        }
        let each = self.percent.iter().zip(&self.tau_s);
        each.fold(Bounds::new(), |bounds, (percent, tau)| {
            bounds
                .within("percent", *percent, [0.0, 100.0], "%")
                .within("tau_s", *tau, [1e-3, 1e8], "s")
        })
        .within("every_s", self.every_s, [0.001, 86_400.0], "s")
        .end()
    }
}

impl Effect for CreepSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| effects.creep = on.then(|| self.clone()))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        let terms = self.percent.iter().zip(&self.tau_s);
        let terms = terms.map(|(percent, tau)| [percent / 100.0, *tau]);
        let every = survey::duration(self.every_s);
        effects
            .losses
            .push(Box::new(PronySeries::new(terms.collect(), every)));
    }
}

/// With a constant input a smaller delayed part is set to zero.
const NOTHING: f64 = 1e-13;

/// Mean of exp(-y) for y from 0 to x.
fn mean_decay(x: f64) -> f64 {
    if x < 1e-4 {
        1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0))
    } else {
        -(-x).exp_m1() / x
    }
}

/// One term of a Prony series over an interval in which its input changes linearly. The delayed part h is updated
/// exactly for any x: h <- exp(-x) h + g (1 - exp(-x)) / x de with x = dt / tau (fact sheet, section 2.4 and hard case
/// 40).
///
/// ```
/// // after a billion time constants nothing of the delayed part remains, after a billionth all of it
/// let long = phantom::PronyStep::new(0.3, 1e9);
/// assert!(long.held(0.2, 1.0).abs() < 1e-9);
/// let short = phantom::PronyStep::new(0.3, 1e-9);
/// assert!((short.held(0.2, 1.0) - 0.5).abs() < 1e-9);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PronyStep {
    left: f64,
    fresh: f64,
}

impl PronyStep {
    /// A step over x time constants (0 or more) for a term with the share g of the input.
    pub fn new(share: f64, x: f64) -> Self {
        Self {
            left: (-x).exp(),
            fresh: share * mean_decay(x),
        }
    }

    /// The delayed part after the step, from its value before and the change of the input.
    pub fn held(self, before: f64, change: f64) -> f64 {
        self.left * before + self.fresh * change
    }
}

/// A sum of independent terms that grow under a load.
#[derive(Debug)]
pub(super) struct PronySeries {
    /// Share and time constant (s) of each term.
    terms: Vec<[f64; 2]>,
    every: Duration,
    /// The last input.
    last: Vec<f64>,
    /// The delayed part of each term at each triangle.
    held: Vec<Vec<f64>>,
}

impl PronySeries {
    /// `terms`: share and time constant (s) of each term; `every`: interval at which the sheet is recomputed.
    pub(super) fn new(terms: Vec<[f64; 2]>, every: Duration) -> Self {
        Self {
            terms,
            every,
            last: Vec::new(),
            held: Vec::new(),
        }
    }
}

impl OnLoss for PronySeries {
    fn follow(&mut self, past: f64, _places: &Places<'_>, losses: &mut [f64]) {
        self.last.resize(losses.len(), 0.0);
        self.held.resize(self.terms.len(), vec![0.0; losses.len()]);
        let input = losses.to_vec();
        for ([share, tau], held) in self.terms.iter().zip(&mut self.held) {
            let term = PronyStep::new(*share, past / tau);
            for (place, held) in held.iter_mut().enumerate() {
                let step = input[place] - self.last[place];
                *held = term.held(*held, step);
                if step == 0.0 && held.abs() < NOTHING {
                    *held = 0.0;
                }
                losses[place] += share * input[place] - *held;
            }
        }
        self.last = input;
    }

    fn every(&self) -> Option<Duration> {
        Some(self.every)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn creep(share: f64, tau: f64) -> PronySeries {
        PronySeries::new(vec![[share, tau]], survey::duration(1.0))
    }

    fn follow(creep: &mut PronySeries, past: f64, input: f64) -> f64 {
        let mut losses = [input];
        creep.follow(past, &Places::default(), &mut losses);
        losses[0]
    }

    /// x - (1 - exp(-x)); for small x by its series, to avoid cancellation.
    fn lag(x: f64) -> f64 {
        if x > 0.1 {
            return x + (-x).exp_m1();
        }
        let (mut term, mut sum) = (0.5 * x * x, 0.0);
        for n in 3..14 {
            sum += term;
            term *= -x / f64::from(n);
        }
        sum
    }

    /// The response of the standard linear solid at time t to a ramp of slope 1 that starts at 0.
    fn after_ramp(share: f64, tau: f64, t: f64) -> f64 {
        t + share * tau * lag(t / tau)
    }

    #[test]
    fn a_step_creeps_as_the_standard_linear_solid() {
        let mut solid = creep(0.3, 20.0);
        follow(&mut solid, 5.0, 0.0);
        assert_eq!(follow(&mut solid, 0.0, 0.5), 0.5);
        let mut t = 0.0;
        for past in [1e-6, 0.1, 3.0, 17.0, 60.0, 400.0] {
            t += past;
            let wanted = 0.5 * (1.0 - 0.3 * f64::exp_m1(-t / 20.0));
            assert!(
                (follow(&mut solid, past, 0.5) - wanted).abs() <= 1e-12,
                "{t}"
            );
        }
        // the delayed part decays after the load is removed
        follow(&mut solid, 0.0, 0.0);
        let wanted = 0.5 * 0.3 * (1.0 - (-480.100001_f64 / 20.0).exp()) * (-0.5_f64).exp();
        assert!((follow(&mut solid, 10.0, 0.0) - wanted).abs() <= 1e-12);
    }

    #[test]
    fn a_triangle_creeps_as_the_standard_linear_solid() {
        // the response to a ramp up for 8 s and down again is a superposition of ramps, whatever the size of the steps
        let (share, tau) = (0.4, 3.0);
        for steps in [1, 7, 1000] {
            let mut solid = creep(share, tau);
            for k in 1..=2 * steps {
                let t = 8.0 * f64::from(k) / f64::from(steps);
                let input = t.min(16.0 - t);
                let seen = follow(&mut solid, 8.0 / f64::from(steps), input);
                let late = (t - 8.0).max(0.0);
                let wanted = after_ramp(share, tau, t) - 2.0 * after_ramp(share, tau, late);
                assert!(
                    (seen - wanted).abs() <= 1e-12,
                    "{steps} {t}: {seen} {wanted}"
                );
            }
        }
    }

    #[test]
    fn creep_is_exact_for_steps_of_1e_minus_9_to_1e9_time_constants() {
        let share = 0.4;
        let mut worst = [0.0_f64; 3];
        for exponent in -9..=9 {
            let x = 10f64.powi(exponent);
            // the input rises to 1 within x time constants and remains there for x more; `wanted` is the delayed
            // response
            let held = share * (1.0 - lag(x) / x);
            let wanted = [share - held, share - held * (-x).exp()];
            let mut solid = creep(share, 1.0);
            let ours = [0, 1].map(|_| follow(&mut solid, x, 1.0) - 1.0);
            // for comparison: the explicit Euler scheme of h' = -h / tau + g e', and the exact form without the series
            // for small x
            let euler = [0.0, share * x];
            let careless = share - share * (1.0 - (-x).exp()) / x;
            for k in 0..2 {
                worst[0] = worst[0].max((ours[k] - wanted[k]).abs());
                worst[1] = worst[1].max((euler[k] - wanted[k]).abs());
            }
            worst[2] = worst[2].max((careless - wanted[0]).abs());
        }
        let [ours, euler, careless] = worst;
        println!("ours {ours:.1e}, Euler {euler:.1e}, without expm1 and series {careless:.1e}");
        assert!(ours <= 1e-10, "{ours}");
        assert!(euler > 1e8 && careless > 1e-9);
        // a step of length zero gives a finite number
        assert_eq!(follow(&mut creep(share, 1.0), 0.0, 1.0), 1.0);
        let x = 0.0_f64;
        assert!(((1.0 - (-x).exp()) / x).is_nan());
    }
}
