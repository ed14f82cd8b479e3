//! Discs at the peaks of a map.

use std::f64::consts::PI;

use super::disc::Disc;
use crate::Mesh;
use crate::inverse::graph::Graph;

/// Most discs of a frame.
const MOST: usize = 4;
/// Share of a peak's loss down to which the triangles round it are its disc.
const CORE: f64 = 0.5;
/// Share of the largest peak's loss that another peak has at least.
const LEAST_PEAK: f64 = 0.2;

/// Finds the peaks of maps of a region.
pub(super) struct Peaks {
    graph: Graph,
    areas: Vec<f64>,
    centroids: Vec<[f64; 2]>,
}

impl Peaks {
    pub(super) fn new(mesh: &Mesh) -> Self {
        Self {
            graph: Graph::of_region(mesh),
            areas: mesh.region_areas(),
            centroids: mesh.region_centroids(),
        }
    }

    /// A disc for each peak of the loss, largest first; none for a map without losses.
    pub(super) fn discs(&self, map: &[f64]) -> Vec<Disc> {
        let mut left: Vec<f64> = map.iter().map(|change| (-change).max(0.0)).collect();
        let mut discs = Vec::new();
        let mut top = 0.0;
        while discs.len() < MOST {
            let largest = (0..left.len()).max_by(|a, b| left[*a].total_cmp(&left[*b]));
            let Some(peak) = largest.filter(|peak| left[*peak] > 0.0) else {
                break;
            };
            let loss = left[peak];
            if discs.is_empty() {
                top = loss;
            } else if loss < LEAST_PEAK * top {
                break;
            }
            discs.push(self.disc(&left, peak));
            self.remove(&mut left, peak);
        }
        discs
    }

    /// The disc with area, centre and mean loss of the triangles round a peak.
    fn disc(&self, losses: &[f64], peak: usize) -> Disc {
        let core = self.grown(peak, |_, next| losses[next] >= CORE * losses[peak]);
        let area: f64 = core.iter().map(|&t| self.areas[t]).sum();
        let load: f64 = core.iter().map(|&t| self.areas[t] * losses[t]).sum();
        let centre = [0, 1].map(|axis| {
            let moment = core
                .iter()
                .map(|&t| self.areas[t] * losses[t] * self.centroids[t][axis]);
            moment.sum::<f64>() / load
        });
        Disc::new(centre, (area / PI).sqrt(), load / area)
    }

    /// Clears the slopes of a peak: what can be reached from it without going up.
    fn remove(&self, losses: &mut [f64], peak: usize) {
        let slopes = self.grown(peak, |from, next| {
            losses[next] > 0.0 && losses[next] <= losses[from]
                || losses[next] >= CORE * losses[peak]
        });
        for triangle in slopes {
            losses[triangle] = 0.0;
        }
    }

    /// The triangles that are connected to a first one by steps that `joins` allows.
    fn grown(&self, first: usize, joins: impl Fn(usize, usize) -> bool) -> Vec<usize> {
        let mut reached = vec![false; self.areas.len()];
        reached[first] = true;
        let mut all = vec![first];
        let mut next = 0;
        while let Some(&from) = all.get(next) {
            next += 1;
            for (_, other) in self.graph.around(from) {
                if !reached[other] && joins(from, other) {
                    reached[other] = true;
                    all.push(other);
                }
            }
        }
        all
    }
}
