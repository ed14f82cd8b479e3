//! Hot spots: loaded patches of a map, each with one maximum.

use std::collections::HashMap;

/// A peak is a separate hot spot if the map falls below this fraction of it on every path to a higher peak.
const SADDLE: f64 = 0.5;
/// Patches whose product of area and value is below this fraction of the largest are dropped: ragged edges of other
/// patches.
const LEAST: f64 = 0.02;

/// A patch around one maximum: the triangles where the map is at least half of that maximum.
#[derive(Debug, Clone, PartialEq)]
pub struct HotSpot {
    /// Centroid, weighted by value times area, m.
    pub centre: [f64; 2],
    /// The largest value.
    pub peak: f64,
    /// Area at half of that value or more, m2.
    pub area: f64,
    /// Integral of the values over that area, value times m2.
    pub load: f64,
}

/// Triangles of a map, with the neighbours of each.
#[derive(Debug, Clone)]
pub struct Adjacency {
    centroids: Vec<[f64; 2]>,
    areas: Vec<f64>,
    neighbours: Vec<Vec<usize>>,
}

impl Adjacency {
    /// Triangles (corners in m) are neighbours if two of their corners have the same coordinates, to 1 nm.
    pub fn new(triangles: &[[[f64; 2]; 3]]) -> Self {
        let mut by_side: HashMap<[[i64; 2]; 2], Vec<usize>> = HashMap::new();
        for (triangle, corners) in triangles.iter().enumerate() {
            let places = corners.map(|corner| corner.map(|metres| (1e9 * metres).round() as i64));
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                let side = [places[a].min(places[b]), places[a].max(places[b])];
                by_side.entry(side).or_default().push(triangle);
            }
        }
        let mut neighbours = vec![Vec::new(); triangles.len()];
        for triangles in by_side.values() {
            if let [a, b] = triangles[..] {
                neighbours[a].push(b);
                neighbours[b].push(a);
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
        }
        Self {
            centroids: triangles.iter().map(centroid).collect(),
            areas: triangles.iter().map(area).collect(),
            neighbours,
        }
    }

    /// Centroid of each triangle, m.
    pub fn centroids(&self) -> &[[f64; 2]] {
        &self.centroids
    }

    /// Area of each triangle, m2.
    pub fn areas(&self) -> &[f64] {
        &self.areas
    }

    /// The hot spots of a map, highest first. `loads` has one value for each triangle; triangles below `least` belong
    /// to no hot spot. Two maxima are one hot spot unless the map falls below half of the lower one between them. A
    /// patch that covers the whole map has no position and is not a hot spot.
    pub fn hot_spots(&self, loads: &[f64], least: f64) -> Vec<HotSpot> {
        let mut order: Vec<usize> = (0..loads.len().min(self.areas.len()))
            .filter(|t| loads[*t] > 0.0 && loads[*t] >= least)
            .collect();
        order.sort_by(|a, b| loads[*b].total_cmp(&loads[*a]).then(a.cmp(b)));
        if let (Some(highest), Some(lowest)) = (order.first(), order.last())
            && order.len() == self.areas.len()
            && loads[*lowest] >= SADDLE * loads[*highest]
        {
            return Vec::new();
        }
        // patches grow from the highest triangle down; `first[p]` is the highest triangle of patch p
        let mut patch_of: Vec<Option<usize>> = vec![None; self.areas.len()];
        let mut merged_into: Vec<usize> = Vec::new();
        let mut first: Vec<usize> = Vec::new();
        let root = |merged_into: &[usize], mut patch: usize| {
            while merged_into[patch] != patch {
                patch = merged_into[patch];
            }
            patch
        };
        for &triangle in &order {
            let mut touched: Vec<usize> = self.neighbours[triangle]
                .iter()
                .filter_map(|next| patch_of[*next])
                .map(|patch| root(&merged_into, patch))
                .collect();
            touched.sort_unstable();
            touched.dedup();
            // patches are numbered by descending peak: the smallest number has the highest peak
            let Some(&highest) = touched.first() else {
                merged_into.push(first.len());
                patch_of[triangle] = Some(first.len());
                first.push(triangle);
                continue;
            };
            patch_of[triangle] = Some(highest);
            for &lower in &touched[1..] {
                if loads[triangle] > SADDLE * loads[first[lower]] {
                    merged_into[lower] = highest;
                }
            }
        }
        let mut sums = vec![(0.0, [0.0; 2], 0.0); first.len()];
        for &triangle in &order {
            let Some(patch) = patch_of[triangle] else {
                continue;
            };
            let patch = root(&merged_into, patch);
            if loads[triangle] < 0.5 * loads[first[patch]] {
                continue;
            }
            let (weight, sum, area) = &mut sums[patch];
            let share = loads[triangle] * self.areas[triangle];
            *weight += share;
            sum[0] += share * self.centroids[triangle][0];
            sum[1] += share * self.centroids[triangle][1];
            *area += self.areas[triangle];
        }
        let mut spots: Vec<HotSpot> = sums
            .into_iter()
            .enumerate()
            .filter(|(patch, _)| merged_into[*patch] == *patch)
            .map(|(patch, (weight, sum, area))| HotSpot {
                centre: sum.map(|sum| sum / weight),
                peak: loads[first[patch]],
                area,
                load: weight,
            })
            .collect();
        let largest = spots
            .iter()
            .map(|spot| spot.area * spot.peak)
            .fold(0.0, f64::max);
        spots.retain(|spot| spot.area * spot.peak >= LEAST * largest);
        spots
    }
}

fn centroid(corners: &[[f64; 2]; 3]) -> [f64; 2] {
    [0, 1].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 3.0)
}

fn area([a, b, c]: &[[f64; 2]; 3]) -> f64 {
    0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of squares of 10 mm, two triangles each.
    fn strip(squares: u32) -> Adjacency {
        let mut triangles = Vec::new();
        for column in 0..squares {
            let (left, right) = (f64::from(column) * 0.01, f64::from(column + 1) * 0.01);
            triangles.push([[left, 0.0], [right, 0.0], [right, 0.01]]);
            triangles.push([[left, 0.0], [right, 0.01], [left, 0.01]]);
        }
        Adjacency::new(&triangles)
    }

    fn twice(squares: &[f64]) -> Vec<f64> {
        squares.iter().flat_map(|value| [*value; 2]).collect()
    }

    #[test]
    fn a_deep_valley_separates_two_spots_and_a_shallow_one_does_not() {
        let strip = strip(5);
        let deep = strip.hot_spots(&twice(&[0.0, 1.0, 0.2, 0.6, 0.0]), 0.05);
        assert_eq!(deep.len(), 2);
        assert_eq!([deep[0].peak, deep[1].peak], [1.0, 0.6]);
        assert!((deep[1].centre[0] - 0.035).abs() < 1e-9, "{deep:?}");
        assert!((deep[1].area - 1e-4).abs() < 1e-12, "{deep:?}");
        assert!((deep[1].load - 0.6e-4).abs() < 1e-12, "{deep:?}");
        // the valley of 0.4 is more than half of the lower peak
        let shallow = strip.hot_spots(&twice(&[0.0, 1.0, 0.4, 0.6, 0.0]), 0.05);
        assert_eq!(shallow.len(), 1);
        assert!((shallow[0].area - 2e-4).abs() < 1e-12, "{shallow:?}");
    }

    #[test]
    fn a_weak_load_beside_a_strong_one_is_a_spot_a_speck_is_none() {
        let strip = strip(9);
        let weak = [0.0, 1.0, 1.0, 0.0, 0.0, 0.2, 0.2, 0.0, 0.0];
        assert_eq!(strip.hot_spots(&twice(&weak), 0.05).len(), 2);
        assert_eq!(strip.hot_spots(&twice(&weak), 0.3).len(), 1);
        let speck = [0.0, 1.0, 1.0, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0];
        assert_eq!(strip.hot_spots(&twice(&speck), 0.01).len(), 1);
        assert!(strip.hot_spots(&[-0.2; 18], 0.0).is_empty());
    }

    #[test]
    fn an_even_load_on_the_whole_map_is_no_spot() {
        let strip = strip(5);
        assert!(strip.hot_spots(&[0.3; 10], 0.05).is_empty());
        let uneven = twice(&[0.3, 0.2, 0.3, 0.2, 0.16]);
        assert!(strip.hot_spots(&uneven, 0.05).is_empty());
        // one value is below half of the maximum, so the others form a hot spot
        let bounded = twice(&[0.3, 0.3, 0.3, 0.3, 0.14]);
        assert_eq!(strip.hot_spots(&bounded, 0.05).len(), 1);
    }
}
