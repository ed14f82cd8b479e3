//! Hysteresis: at the same load the sheet shows more loss during unloading than during loading.
//!
//! The model of Prandtl and Ishlinskii for each triangle: y = q x + sum w F_r[x] over eight play operators F_r[x] =
//! max(x - r, min(x + r, F_r)). x is the log loss, r is evenly spaced up to half of the full scale, all w are equal and
//! at least 0, and q preserves the full scale on first loading. 5 to 25 % of full scale; 24.2 % observed on a
//! conductive-fibre sensor (fact sheet, section 2.4). Leave it out under monotone loading.

use super::bounds::parameters;
use super::{Effect, Effects, OnLoss, Places, SheetResponse};

parameters! {
    /// Width of the loop.
    HysteresisSettings {
        /// Width of the loop at half of the full scale, % of the full scale.
        percent = 15.0, in [0.0, 40.0], "%";
        /// The loss at full scale, %.
        full_percent = 50.0, in [0.1, 99.999], "%";
    }
}

impl Effect for HysteresisSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| effects.hysteresis = on.then(|| self.clone()))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.losses.push(Box::new(Hysteresis::new(self)));
    }
}

/// Number of play operators.
const PLAYS: usize = 8;

/// The output of a play operator for its next input: it follows the input at a distance of at most `threshold`.
fn play(threshold: f64, last: f64, input: f64) -> f64 {
    (input - threshold).max((input + threshold).min(last))
}

#[derive(Debug)]
struct Hysteresis {
    thresholds: [f64; PLAYS],
    weight: f64,
    straight: f64,
    /// State of each operator at each triangle.
    plays: Vec<[f64; PLAYS]>,
}

impl Hysteresis {
    fn new(settings: &HysteresisSettings) -> Self {
        let full = -(-settings.full_percent / 100.0).ln_1p();
        let thresholds: [f64; PLAYS] =
            std::array::from_fn(|k| 0.5 * full * (k + 1) as f64 / PLAYS as f64);
        // at half of the full scale an operator is at full / 2 - r on first loading and at min(full - r, full / 2 + r)
        // on unloading, so the loop is min(full / 2, 2 r) wide there
        let wide: f64 = thresholds.iter().map(|r| (2.0 * r).min(0.5 * full)).sum();
        let weight = settings.percent / 100.0 * full / wide;
        let kept: f64 = thresholds.iter().map(|r| weight * (full - r) / full).sum();
        Self {
            thresholds,
            weight,
            straight: 1.0 - kept,
            plays: Vec::new(),
        }
    }
}

impl OnLoss for Hysteresis {
    fn follow(&mut self, _past: f64, _places: &Places<'_>, losses: &mut [f64]) {
        self.plays.resize(losses.len(), [0.0; PLAYS]);
        for (loss, plays) in losses.iter_mut().zip(&mut self.plays) {
            let input = *loss;
            for (threshold, state) in self.thresholds.iter().zip(plays.iter_mut()) {
                *state = play(*threshold, *state, input);
            }
            *loss = self.straight * input + self.weight * plays.iter().sum::<f64>();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn follow(hysteresis: &mut Hysteresis, input: f64) -> f64 {
        let mut losses = [input];
        hysteresis.follow(1.0, &Places::default(), &mut losses);
        losses[0]
    }

    #[test]
    fn a_play_operator_answers_a_triangle_as_its_closed_form() {
        // the input rises to 1, falls to -1 and rises again in uneven steps; r = 0.3
        let r = 0.3;
        let mut state = 0.0;
        let mut t = 0.0_f64;
        let mut k = 0;
        while t < 5.0 {
            k += 1;
            t += [0.01, 0.0037, 0.11][k % 3];
            // the steps must hit the corners of the input, otherwise the operator misses them
            for corner in [1.0, 3.0, 5.0] {
                if t > corner && t - corner < 0.11 {
                    state = play(r, state, if corner == 3.0 { -1.0 } else { 1.0 });
                }
            }
            let input = match t {
                ..1.0 => t,
                1.0..3.0 => 2.0 - t,
                3.0..5.0 => t - 4.0,
                _ => break,
            };
            state = play(r, state, input);
            let wanted = match t {
                ..1.0 => (input - r).max(0.0),
                1.0..3.0 => (input + r).min(1.0 - r),
                _ => (input - r).max(-1.0 + r),
            };
            assert!((state - wanted).abs() <= 1e-12, "{t}: {state} {wanted}");
        }
        // a step of the input takes one update
        assert!((play(r, 0.0, 2.0) - 1.7).abs() <= 1e-12);
        assert!((play(r, 1.7, 1.5) - 1.7).abs() <= 1e-12);
        assert!((play(r, 1.7, -2.0) + 1.7).abs() <= 1e-12);
    }

    #[test]
    fn loop_has_the_given_width_and_ends_at_full_scale() {
        for percent in [5.0, 24.2, 40.0] {
            let settings = HysteresisSettings {
                percent,
                full_percent: 50.0,
            };
            let full = 2.0_f64.ln();
            let mut hysteresis = Hysteresis::new(&settings);
            assert!(hysteresis.straight >= 0.0, "the operator has an inverse");
            let there = follow(&mut hysteresis, 0.5 * full);
            assert!((follow(&mut hysteresis, full) - full).abs() <= 1e-12);
            let back = follow(&mut hysteresis, 0.5 * full);
            let width = (back - there) / full;
            assert!((width - percent / 100.0).abs() <= 1e-12, "{width}");
            // a residual loss remains after unloading, until a full swing in the other direction removes it
            assert!(follow(&mut hysteresis, 0.0) > 0.0);
        }
    }

    #[test]
    fn the_way_between_turning_points_does_not_matter() {
        let mut coarse = Hysteresis::new(&HysteresisSettings::default());
        let mut fine = Hysteresis::new(&HysteresisSettings::default());
        for [from, to] in [[0.0, 0.6], [0.6, 0.2], [0.2, 0.45], [0.45, 0.0]] {
            let at_once = follow(&mut coarse, to);
            let mut last = 0.0;
            for k in 1..=137 {
                last = follow(&mut fine, from + (to - from) * f64::from(k) / 137.0);
            }
            assert!((at_once - last).abs() <= 1e-12);
        }
    }
}
