//! The load history of the sheet, for effects on the log loss: hysteresis, creep, power-law creep, set, stretch and
//! body contact.
//!
//! These effects act on each triangle, so that a moving load leaves a trail. Nothing is computed between changes of the
//! loads, because the update of the effects is exact for any step. The result is updated when a load changes, and at
//! the interval of the effects (`every_s`). Its **version** counts the updates that changed any bit of the result.

use std::time::Duration;

use crate::effects::{OnLoss, Places};

#[derive(Debug)]
pub(crate) struct History {
    effects: Vec<Box<dyn OnLoss>>,
    /// End of the history so far; `None` before the start.
    last: Option<Duration>,
    /// Log losses by the loads alone at that time.
    plain: Vec<f64>,
    /// Log losses after the effects.
    bent: Vec<f64>,
    version: u64,
}

impl History {
    /// `None` if there is no such effect.
    pub(crate) fn new(effects: Vec<Box<dyn OnLoss>>) -> Option<Self> {
        (!effects.is_empty()).then_some(Self {
            effects,
            last: None,
            plain: Vec::new(),
            bent: Vec::new(),
            version: 0,
        })
    }

    pub(crate) fn last(&self) -> Option<Duration> {
        self.last
    }

    pub(crate) fn version(&self) -> u64 {
        self.version
    }

    /// Updates the history for loads that changed at this time, as a step or linearly since the last call.
    pub(crate) fn change(
        &mut self,
        at: Duration,
        plain: Vec<f64>,
        moved: bool,
        places: &Places<'_>,
    ) {
        let past = self.past(at);
        if moved {
            self.plain = plain;
            self.follow(past, places);
        } else {
            if past > 0.0 {
                self.follow(past, places);
            }
            self.plain = plain;
            self.follow(0.0, places);
        }
    }

    /// Updates the history for constant loads up to this time, rounded down to a multiple of the shortest interval of
    /// the effects.
    pub(crate) fn rest(&mut self, at: Duration, places: &Places<'_>) {
        let Some(every) = self
            .effects
            .iter()
            .filter_map(|effect| effect.every())
            .min()
        else {
            return;
        };
        let steps = (at.as_secs_f64() / every.as_secs_f64()).floor();
        let at = survey::duration(steps * every.as_secs_f64()).min(at);
        if self.last.is_some_and(|last| at > last) {
            let past = self.past(at);
            self.follow(past, places);
        }
    }

    /// Replaces the losses by the loads in `sigma` by those after the effects.
    pub(crate) fn act(&self, sigma: &mut [f64]) {
        for (sigma, (plain, bent)) in sigma.iter_mut().zip(self.plain.iter().zip(&self.bent)) {
            // exp(0) is exactly 1, so unchanged triangles keep their bits
            *sigma *= (plain - bent).exp();
        }
    }

    /// Seconds since the last step; sets the last step to `at`.
    fn past(&mut self, at: Duration) -> f64 {
        let past = self
            .last
            .map_or(Duration::ZERO, |last| at.saturating_sub(last));
        self.last = Some(self.last.unwrap_or_default().max(at));
        past.as_secs_f64()
    }

    fn follow(&mut self, past: f64, places: &Places<'_>) {
        let mut losses = self.plain.clone();
        let places = Places {
            pressed: &self.plain,
            ..*places
        };
        for effect in &mut self.effects {
            effect.follow(past, &places, &mut losses);
        }
        if losses != self.bent {
            self.bent = losses;
            self.version += 1;
        }
    }
}
