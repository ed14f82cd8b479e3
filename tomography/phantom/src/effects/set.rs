//! Compression set: foam that was pressed many times does not recover completely.
//!
//! Each triangle keeps s log10(1 + n) of its largest log loss, n the number of load cycles: 1 to 5 % (fact sheet,
//! section 2.4). A cycle is counted when the loss rises through half of its maximum after having been below a tenth of
//! it. Leave it out below a hundred cycles.

use super::bounds::parameters;
use super::{Effect, Effects, OnLoss, Places, SheetResponse};

parameters! {
    /// Size of the set.
    SetSettings {
        /// Permanent loss per decade of cycles, % of the largest log loss.
        percent_per_decade = 1.0, in [0.0, 20.0], "% per decade";
        /// Number of cycles of every pressed triangle before the start.
        behind_cycles = 0.0, in [0.0, 1e12], "cycles";
    }
}

impl Effect for SetSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| effects.set = on.then(|| self.clone()))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.losses.push(Box::new(Set {
            settings: self.clone(),
            places: Vec::new(),
        }));
    }
}

/// Load history of a triangle.
#[derive(Debug, Clone, Default)]
struct LoadHistory {
    largest: f64,
    cycles: f64,
    risen: bool,
}

#[derive(Debug)]
struct Set {
    settings: SetSettings,
    places: Vec<LoadHistory>,
}

impl OnLoss for Set {
    fn follow(&mut self, _past: f64, _places: &Places<'_>, losses: &mut [f64]) {
        let behind = self.settings.behind_cycles;
        let share = self.settings.percent_per_decade / 100.0;
        self.places.resize(losses.len(), LoadHistory::default());
        for (loss, past) in losses.iter_mut().zip(&mut self.places) {
            let size = loss.abs();
            past.largest = past.largest.max(size);
            if past.largest == 0.0 {
                continue;
            }
            if !past.risen && size >= 0.5 * past.largest {
                past.risen = true;
                past.cycles += 1.0;
            } else if past.risen && size <= 0.1 * past.largest {
                past.risen = false;
            }
            *loss += share * (1.0 + behind + past.cycles).log10() * past.largest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_grows_by_its_share_for_each_decade_of_cycles() {
        let mut effects = Effects::default();
        SetSettings {
            percent_per_decade: 2.0,
            behind_cycles: 0.0,
        }
        .add(1, &mut effects);
        let mut follow = |input: f64| {
            let mut losses = [input, 0.0];
            effects.losses[0].follow(1.0, &Places::default(), &mut losses);
            assert_eq!(losses[1], 0.0, "what was never pressed has no set");
            losses[0]
        };
        let mut left = Vec::new();
        for cycle in 1..=999_u32 {
            follow(0.4);
            // a press during another press is not a cycle
            follow(0.3);
            follow(0.4);
            let after = follow(0.0);
            if [9, 99, 999].contains(&cycle) {
                left.push(after);
            }
        }
        for (decade, left) in (1..).zip(left) {
            assert!((left - 0.008 * f64::from(decade)).abs() < 1e-14, "{left}");
        }
    }
}
