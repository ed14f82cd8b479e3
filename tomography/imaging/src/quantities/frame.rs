//! The quantities of one map, for the whole sheet and each region.

use super::quantity::{LoadUnit, Quantity, Values};
use super::surface::{Surface, SurfaceRegion};

/// Values of one map over a region, and the positions of the largest ones.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct MapValues {
    pub(super) values: Values,
    /// Centroid of the triangle with the largest value, m.
    pub(super) peak: Option<[f64; 2]>,
    /// Centre of the disc with the largest mean, m.
    pub(super) ppi: Option<[f64; 2]>,
}

/// One entry for each region of the surface. `loads`: one value for each triangle, none negative; `threshold`: the
/// least value of a loaded triangle, in the same unit.
pub(super) fn of_map(
    surface: &Surface,
    loads: &[f64],
    threshold: f64,
    unit: LoadUnit,
) -> Vec<MapValues> {
    let means = surface.disc_means(loads);
    let gradients = surface.gradients(loads);
    let total = load(surface, &surface.region_list()[0], loads);
    surface
        .region_list()
        .iter()
        .map(|region| {
            let mut found = of_region(surface, region, loads, threshold, unit);
            let largest = |values: &[f64]| {
                let inside = (0..values.len()).filter(|t| region.shares[*t] >= 0.5);
                inside.max_by(|a, b| values[*a].total_cmp(&values[*b]))
            };
            let at = |triangle: usize| surface.adjacency().centroids()[triangle];
            let peak = largest(loads);
            let ppi = largest(&means);
            let values = &mut found.values;
            values.set(Quantity::Peak, peak.map(|t| loads[t]));
            values.set(Quantity::Ppi, ppi.map(|t| means[t]));
            values.set(
                Quantity::Gradient,
                largest(&gradients).map(|t| 1e-3 * gradients[t]),
            );
            let share = 1e2 * load(surface, region, loads) / total;
            values.set(Quantity::Dispersion, Some(share).filter(|_| total > 0.0));
            found.peak = peak.filter(|t| loads[*t] > 0.0).map(at);
            found.ppi = ppi.filter(|t| means[*t] > 0.0).map(at);
            found
        })
        .collect()
}

impl SurfaceRegion {
    /// Whether at least half of the triangle nearest to a point lies in the region.
    pub(super) fn has(&self, surface: &Surface, point: [f64; 2]) -> bool {
        let distance = |at: &[f64; 2]| (at[0] - point[0]).hypot(at[1] - point[1]);
        let centroids = surface.adjacency().centroids();
        (0..centroids.len())
            .min_by(|a, b| distance(&centroids[*a]).total_cmp(&distance(&centroids[*b])))
            .is_some_and(|nearest| self.shares[nearest] >= 0.5)
    }
}

/// Integral of the values over a region, value times m2.
fn load(surface: &Surface, region: &SurfaceRegion, loads: &[f64]) -> f64 {
    let areas = surface.adjacency().areas();
    (0..loads.len())
        .map(|t| loads[t] * areas[t] * region.shares[t])
        .sum()
}

/// Area, load, mean, variation and centre.
fn of_region(
    surface: &Surface,
    region: &SurfaceRegion,
    loads: &[f64],
    threshold: f64,
    unit: LoadUnit,
) -> MapValues {
    let adjacency = surface.adjacency();
    let (mut area, mut sum, mut squares) = (0.0, 0.0, 0.0);
    let mut moment = [0.0; 2];
    for (triangle, load) in loads.iter().enumerate() {
        let inside = adjacency.areas()[triangle] * region.shares[triangle];
        let [x, y] = adjacency.centroids()[triangle];
        moment[0] += load * inside * x;
        moment[1] += load * inside * y;
        if *load >= threshold {
            area += inside;
            sum += load * inside;
            squares += load * load * inside;
        }
    }
    let total = load(surface, region, loads);
    let mean = Some(sum / area).filter(|_| area > 0.0);
    let variance = mean.map(|mean| (squares / area - mean * mean).max(0.0));
    let mut found = MapValues::default();
    let values = &mut found.values;
    values.set(Quantity::Contact, Some(1e6 * area));
    values.set(Quantity::Load, Some(unit.load_factor() * total));
    values.set(Quantity::Mean, mean);
    values.set(
        Quantity::Variation,
        variance
            .zip(mean)
            .map(|(variance, mean)| 1e2 * variance.sqrt() / mean),
    );
    let centre = Some(moment).filter(|_| total > 0.0);
    values.set(Quantity::CentreX, centre.map(|[x, _]| 1e3 * x / total));
    values.set(Quantity::CentreY, centre.map(|[_, y]| 1e3 * y / total));
    found
}
