//! In-plane stretch: pressed foam widens and stretches the foam around the load.
//!
//! The in-plane strain is nu_eff times the strain across the foam, smoothed over its thickness t. The log loss e
//! becomes e + nu_eff S[e], where S is the mean weighted by exp(-distance / t). nu_eff = 0 to 0.4, t = 3 mm (fact
//! sheet, section 2.4). The kernel is cut off at 6 t (its tail has 1.7 % of the weight) and evaluated at the triangles'
//! centroids.

use super::bounds::parameters;
use super::{Effect, Effects, OnLoss, Places, SheetResponse};

parameters! {
    /// Size of the stretch.
    StretchSettings {
        /// In-plane strain per strain across the foam.
        ratio = 0.2, in [0.0, 0.5];
        /// Thickness of the foam, mm.
        thickness_mm = 3.0, in [0.1, 100.0], "mm";
    }
}

impl Effect for StretchSettings {
    fn predict(&self, response: &dyn SheetResponse) -> f64 {
        response.on_loads(&|effects, on| effects.stretch = on.then(|| self.clone()))
    }

    fn add(&self, _seed: u64, effects: &mut Effects) {
        effects.losses.push(Box::new(Stretch {
            ratio: self.ratio,
            thickness: self.thickness_mm * 1e-3,
            weights: Vec::new(),
        }));
    }
}

/// Distance at which the kernel is cut off, in thicknesses.
const REACH: f64 = 6.0;

#[derive(Debug)]
struct Stretch {
    ratio: f64,
    /// m
    thickness: f64,
    /// For each triangle the kernel's sum over all triangles; `None` until it is computed.
    weights: Vec<Option<f64>>,
}

impl Stretch {
    /// exp(-distance / t) times the area of triangle `to`; 0 beyond [`REACH`].
    fn weight(&self, places: &Places<'_>, from: usize, to: usize) -> f64 {
        let ([x, y], [u, v]) = (places.centroids[from], places.centroids[to]);
        let away = (x - u).hypot(y - v) / self.thickness;
        if away > REACH {
            return 0.0;
        }
        (-away).exp() * places.areas[to]
    }
}

impl OnLoss for Stretch {
    fn follow(&mut self, _past: f64, places: &Places<'_>, losses: &mut [f64]) {
        let count = losses.len();
        self.weights.resize(count, None);
        let pressed: Vec<(usize, f64)> = losses
            .iter()
            .enumerate()
            .filter(|(_, loss)| **loss != 0.0)
            .map(|(place, loss)| (place, *loss))
            .collect();
        for (place, loss) in losses.iter_mut().enumerate() {
            let near = pressed
                .iter()
                .map(|(from, loss)| self.weight(places, place, *from) * loss);
            let sum: f64 = near.sum();
            if sum == 0.0 {
                continue;
            }
            let all = self.weights[place]
                .unwrap_or_else(|| (0..count).map(|to| self.weight(places, place, to)).sum());
            self.weights[place] = Some(all);
            *loss += self.ratio * sum / all;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_press_widens_by_ratio_and_line_fades_over_thickness() {
        // squares of 0.5 mm, of which the left half is pressed
        let side = 81;
        let centroids: Vec<[f64; 2]> = (0..side * side)
            .map(|k| [k % side, k / side].map(|step| step as f64 * 0.5e-3))
            .collect();
        let areas = vec![0.25e-6; centroids.len()];
        let places = Places {
            centroids: &centroids,
            areas: &areas,
            pressed: &[],
        };
        let mut losses: Vec<f64> = (0..side * side)
            .map(|k| if k % side <= 40 { 0.5 } else { 0.0 })
            .collect();
        let mut stretch = Stretch {
            ratio: 0.4,
            thickness: 1e-3,
            weights: Vec::new(),
        };
        stretch.follow(0.0, &places, &mut losses);
        let middle = |column: usize| losses[40 * side + column];
        assert!((middle(15) - 0.7).abs() < 1e-12, "{}", middle(15));
        assert_eq!(middle(70), 0.0);
        // half-way between the last pressed column and the first free one, half of the kernel's weight is on pressed
        // squares
        let both = middle(40) + middle(41);
        assert!((both - 0.7).abs() < 1e-3, "{both}");
        assert!(middle(44) > middle(48) && middle(48) > 0.0);
    }
}
