//! A crack: conductance is lost along a line, increasingly with time.
//!
//! Loss (1 - exp(-t / tau)) within the line's width (fact sheet, section 2.3: ageing, grows with use; a fault, absent
//! from a healthy sheet). Triangles count by their centroid.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::bounds::{Bounds, Fault, Parameters};
use super::{Effect, Effects, OnSheet, SheetResponse};

/// Position and growth of the crack.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CrackSettings {
    /// One end, mm.
    pub from_mm: [f64; 2],
    /// The other end, mm.
    pub to_mm: [f64; 2],
    /// Width, mm.
    #[serde(default = "width")]
    pub width_mm: f64,
    /// Final loss, %.
    #[serde(default = "loss")]
    pub loss_percent: f64,
    /// Time constant, d.
    #[serde(default = "days")]
    pub days: f64,
}

fn width() -> f64 {
    2.0
}

fn loss() -> f64 {
    90.0
}

fn days() -> f64 {
    7.0
}

impl Default for CrackSettings {
    /// Across the middle of the paper's sheet.
    fn default() -> Self {
        Self {
            from_mm: [60.0, 60.0],
            to_mm: [150.0, 160.0],
            width_mm: width(),
            loss_percent: loss(),
            days: days(),
        }
    }
}

impl CrackSettings {
    /// Reduces the conductance within the line's width by this share of the final loss.
    fn cut(&self, share: f64, places: &[[f64; 2]], sigma: &mut [f64]) {
        let lost = self.loss_percent / 100.0 * share;
        let [from, to] = [self.from_mm, self.to_mm].map(|end| end.map(|mm| mm * 1e-3));
        let along = [to[0] - from[0], to[1] - from[1]];
        let length = along[0] * along[0] + along[1] * along[1];
        for (sigma, place) in sigma.iter_mut().zip(places) {
            let away = [place[0] - from[0], place[1] - from[1]];
            let share = if length > 0.0 {
                ((away[0] * along[0] + away[1] * along[1]) / length).clamp(0.0, 1.0)
            } else {
                0.0
            };
            let distance = (away[0] - share * along[0]).hypot(away[1] - share * along[1]);
            if distance <= 0.5e-3 * self.width_mm {
                *sigma *= 1.0 - lost;
            }
        }
    }
}

impl Parameters for CrackSettings {
    fn check(&self) -> Result<(), Fault> {
        let bounds = Bounds::new();
        let from = self.from_mm.iter().map(|mm| ("from_mm", *mm));
        let to = self.to_mm.iter().map(|mm| ("to_mm", *mm));
        from.chain(to)
            .fold(bounds, |bounds, (key, mm)| {
                bounds.within(key, mm, [-1e4, 1e4], "mm")
            })
            .within("width_mm", self.width_mm, [0.1, 100.0], "mm")
            .within("loss_percent", self.loss_percent, [0.0, 99.999_999], "%")
            .within("days", self.days, [1e-6, 1e4], "d")
            .end()
    }
}

impl Effect for CrackSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        let lost = response.over_time(&|at| -(-at / 86_400.0 / self.days).exp_m1());
        response.solved(&|places, sigma, _| self.cut(lost, places, sigma))
    }

    fn assumes(&self) -> Option<String> {
        Some("it grows from the first frame".to_owned())
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.sheet.push(Box::new(self.clone()));
    }
}

/// Number of steps in which the growth is computed.
const STEPS: f64 = 1000.0;

impl OnSheet for CrackSettings {
    fn act(&mut self, at: Duration, places: &[[f64; 2]], sigma: &mut [f64]) {
        self.cut(self.epoch(at) as f64 / STEPS, places, sigma);
    }

    fn epoch(&self, at: Duration) -> u64 {
        let days = at.as_secs_f64() / 86_400.0;
        (STEPS * -(-days / self.days).exp_m1()) as u64
    }
}
