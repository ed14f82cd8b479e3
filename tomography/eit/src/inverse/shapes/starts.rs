//! Start values of shapes at the peaks of a map.

use std::f64::consts::PI;

use nalgebra::{Matrix2, SymmetricEigen, U2};

use super::shape::Shape;
use crate::Mesh;
use crate::inverse::graph::Graph;

/// Largest number of discs in a frame.
pub(super) const MOST: usize = 4;
/// Triangles around a peak belong to its disc if their loss is at least this share of the peak's.
const CORE: f64 = 0.5;
/// Smallest ratio of length to width of the triangles around a peak for which a bar is tried.
const LONG: f64 = 1.5;
/// Smallest loss of another peak as a share of the largest peak's loss.
const LEAST_PEAK: f64 = 0.2;

/// Shapes at a peak of a map.
pub(super) struct Peak {
    pub(super) disc: Shape,
    /// `None` for a round peak.
    pub(super) bar: Option<Shape>,
}

/// The bar with these second moments of position; `None` if it is hardly longer than wide.
fn bar(centre: [f64; 2], moments: SymmetricEigen<f64, U2>, loss: f64) -> Option<Shape> {
    let long = moments.eigenvalues.imax();
    let [length, width] = [long, 1 - long].map(|k| (3.0 * moments.eigenvalues[k].max(0.0)).sqrt());
    let axis = moments.eigenvectors.column(long) * (length - 0.5 * width);
    (length > LONG * width).then(|| Shape::bar(centre, [axis[0], axis[1]], 0.5 * width, loss))
}

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

    /// The peaks of the loss, largest first; none for a map without losses.
    pub(super) fn of(&self, map: &[f64]) -> Vec<Peak> {
        let mut left: Vec<f64> = map.iter().map(|change| (-change).max(0.0)).collect();
        let mut peaks = Vec::new();
        let mut top = 0.0;
        while peaks.len() < MOST {
            let largest = (0..left.len()).max_by(|a, b| left[*a].total_cmp(&left[*b]));
            let Some(peak) = largest.filter(|peak| left[*peak] > 0.0) else {
                break;
            };
            let loss = left[peak];
            if peaks.is_empty() {
                top = loss;
            } else if loss < LEAST_PEAK * top {
                break;
            }
            peaks.push(self.peak(&left, peak));
            self.remove(&mut left, peak);
        }
        peaks
    }

    /// The disc with the area, centre and mean loss of the triangles around a peak.
    fn peak(&self, losses: &[f64], peak: usize) -> Peak {
        let core = self.grown(peak, |_, next| losses[next] >= CORE * losses[peak]);
        let area: f64 = core.iter().map(|&t| self.areas[t]).sum();
        let load: f64 = core.iter().map(|&t| self.areas[t] * losses[t]).sum();
        let centre = [0, 1].map(|axis| {
            let moment = core
                .iter()
                .map(|&t| self.areas[t] * losses[t] * self.centroids[t][axis]);
            moment.sum::<f64>() / load
        });
        let spread = |i: usize, j: usize| {
            let moments = core.iter().map(|&t| {
                let at = self.centroids[t];
                self.areas[t] * losses[t] * (at[i] - centre[i]) * (at[j] - centre[j])
            });
            moments.sum::<f64>() / load
        };
        let moments = Matrix2::new(spread(0, 0), spread(0, 1), spread(0, 1), spread(1, 1));
        Peak {
            disc: Shape::disc(centre, (area / PI).sqrt(), load / area),
            bar: bar(centre, moments.symmetric_eigen(), load / area),
        }
    }

    /// Clears a peak with its slopes: all triangles that can be reached from it without ascending.
    fn remove(&self, losses: &mut [f64], peak: usize) {
        let slopes = self.grown(peak, |from, next| {
            losses[next] > 0.0 && losses[next] <= losses[from]
                || losses[next] >= CORE * losses[peak]
        });
        for triangle in slopes {
            losses[triangle] = 0.0;
        }
    }

    /// The triangles connected to a first one by steps that `joins` allows.
    fn grown(&self, first: usize, joins: impl Fn(usize, usize) -> bool) -> Vec<usize> {
        let mut reached = vec![false; self.areas.len()];
        reached[first] = true;
        let mut all = vec![first];
        let mut next = 0;
        while let Some(&from) = all.get(next) {
            next += 1;
            for other in self.graph.cut.neighbours(from) {
                if !reached[other] && joins(from, other) {
                    reached[other] = true;
                    all.push(other);
                }
            }
        }
        all
    }
}
