//! Algorithm 1: random polygons of lost conductance, and what the electrodes see of them.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use rayon::prelude::*;
use survey::Protocol;

use super::{Purpose, Stage, TrainError, TrainingSettings, check, stream};
use crate::rbf::Sparse;
use crate::{Forward, Mesh};

/// Cases of Algorithm 1 without jitter.
pub struct TrainingSet {
    /// Readings of the baseline at 1 A.
    pub baseline: Vec<f64>,
    /// Normalised inputs (Eq. 6), one row a case.
    pub(super) inputs: Vec<f32>,
    /// Relative changes of the region's triangles.
    pub(super) targets: Vec<Sparse>,
}

impl TrainingSet {
    /// Draws and solves the cases; case c depends on the seed and c alone.
    ///
    /// # Errors
    /// Settings without meaning, or what the forward model refuses.
    pub fn build(
        mesh: &Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        settings: &TrainingSettings,
        progress: &(dyn Fn(Stage, usize, usize) + Sync),
    ) -> Result<Self, TrainError> {
        check(settings)?;
        let forward = Forward::new(Arc::clone(mesh), contact_ohm_m)?;
        let baseline = forward.readings(sigma0, protocol)?.as_slice().to_vec();
        let top = baseline.iter().fold(0.0_f64, |top, v| top.max(v.abs()));
        let region = Region::new(mesh);
        let done = AtomicUsize::new(0);
        let solved = (0..settings.cases)
            .into_par_iter()
            .map(|case| {
                let target = region.case(settings, case);
                let mut sigma = sigma0.to_vec();
                for &(unknown, change) in &target {
                    sigma[mesh.region()[unknown as usize]] *= 1.0 + f64::from(change);
                }
                let input: Vec<f32> = if target.is_empty() {
                    vec![0.0; baseline.len()]
                } else {
                    forward
                        .readings(&sigma, protocol)?
                        .iter()
                        .zip(&baseline)
                        .map(|(volts, zero)| ((volts - zero) / top) as f32)
                        .collect()
                };
                let done = done.fetch_add(1, Ordering::Relaxed) + 1;
                progress(Stage::Cases, done, settings.cases);
                Ok((input, target))
            })
            .collect::<Result<Vec<_>, TrainError>>()?;
        let mut inputs = Vec::with_capacity(settings.cases * baseline.len());
        let mut targets = Vec::with_capacity(settings.cases);
        for (input, target) in solved {
            inputs.extend(input);
            targets.push(target);
        }
        Ok(Self {
            baseline,
            inputs,
            targets,
        })
    }

    /// Eq. 8: the inputs `repeats` times over, each with its own noise, drawn from the seed, the copy and the case.
    pub(super) fn jittered(&self, settings: &TrainingSettings, deviation: f64) -> Vec<f32> {
        let width = self.baseline.len();
        let noise = Normal::new(0.0, deviation).expect("a deviation is a positive number");
        let mut inputs = self.inputs.repeat(settings.repeats);
        inputs
            .par_chunks_mut(width)
            .enumerate()
            .for_each(|(sample, row)| {
                let mut random = stream(settings.seed, Purpose::Jitter, sample);
                for value in row {
                    *value = (f64::from(*value) + noise.sample(&mut random)) as f32;
                }
            });
        inputs
    }
}

/// The region of interest as the cases see it.
struct Region {
    corners: Vec<[[f64; 2]; 3]>,
    centroids: Vec<[f64; 2]>,
    /// Sums of the areas up to and with each triangle.
    areas: Vec<f64>,
}

impl Region {
    fn new(mesh: &Mesh) -> Self {
        let mut sum = 0.0;
        Self {
            corners: mesh.region().iter().map(|&t| mesh.corners(t)).collect(),
            centroids: mesh.region_centroids(),
            areas: mesh
                .region_areas()
                .into_iter()
                .map(|area| {
                    sum += area;
                    sum
                })
                .collect(),
        }
    }

    /// A point uniform over the region.
    fn point(&self, random: &mut ChaCha8Rng) -> [f64; 2] {
        let total = self.areas.last().copied().unwrap_or_default();
        let at = random.random::<f64>() * total;
        let triangle = self
            .areas
            .partition_point(|sum| *sum <= at)
            .min(self.areas.len() - 1);
        let (mut p, mut q) = (random.random::<f64>(), random.random::<f64>());
        if p + q > 1.0 {
            (p, q) = (1.0 - p, 1.0 - q);
        }
        let [a, b, c] = self.corners[triangle];
        [0, 1].map(|axis| a[axis] + p * (b[axis] - a[axis]) + q * (c[axis] - a[axis]))
    }

    /// One case of Algorithm 1.
    fn case(&self, settings: &TrainingSettings, case: usize) -> Sparse {
        let random = &mut stream(settings.seed, Purpose::Case, case);
        let mut kept = vec![1.0_f64; self.centroids.len()];
        for _ in 0..random.random_range(0..=settings.polygons) {
            let centre = self.point(random);
            let radius = random.random::<f64>() * settings.radius_m;
            let mut angles: Vec<f64> = (0..random.random_range(0..=settings.vertices))
                .map(|_| random.random::<f64>() * TAU)
                .collect();
            let loss = random.random::<f64>();
            angles.sort_by(f64::total_cmp);
            let polygon: Vec<[f64; 2]> = angles
                .iter()
                .map(|angle| {
                    [
                        centre[0] + radius * angle.cos(),
                        centre[1] + radius * angle.sin(),
                    ]
                })
                .collect();
            for (kept, centroid) in kept.iter_mut().zip(&self.centroids) {
                if (centroid[0] - centre[0]).abs() <= radius && holds(&polygon, *centroid) {
                    *kept *= 1.0 - loss;
                }
            }
        }
        kept.iter()
            .enumerate()
            .filter(|(_, kept)| **kept < 1.0)
            .map(|(unknown, kept)| (unknown as u32, (kept - 1.0) as f32))
            .collect()
    }
}

/// The even-odd rule; nothing is inside fewer than three vertices.
fn holds(polygon: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    if polygon.len() < 3 {
        return false;
    }
    let mut inside = false;
    let mut from = polygon[polygon.len() - 1];
    for &to in polygon {
        if (from[1] > y) != (to[1] > y)
            && x < from[0] + (y - from[1]) / (to[1] - from[1]) * (to[0] - from[0])
        {
            inside = !inside;
        }
        from = to;
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DiscTank;

    #[test]
    fn a_polygon_of_fewer_than_three_vertices_holds_nothing() {
        assert!(!holds(&[], [0.0, 0.0]));
        assert!(!holds(&[[0.0, 0.0], [1.0, 1.0]], [0.5, 0.5]));
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        assert!(holds(&square, [0.5, 0.5]));
        assert!(!holds(&square, [1.5, 0.5]));
    }

    #[test]
    fn ten_thousand_cases_are_drawn_and_some_are_unchanged() {
        let mesh = DiscTank::default().mesh().unwrap();
        let region = Region::new(&mesh);
        let settings = TrainingSettings::default();
        let unchanged = (0..10_000)
            .filter(|&case| {
                let target = region.case(&settings, case);
                assert!(
                    target
                        .iter()
                        .all(|(_, change)| (-1.0..0.0).contains(change))
                );
                target.is_empty()
            })
            .count();
        // 1/5 of the cases have no polygon, and half of all polygons have fewer than three vertices
        assert!((3500..5000).contains(&unchanged), "{unchanged}");
    }
}
