//! Loads of many shapes with their true maps, for the comparison of reconstructions.

use std::f64::consts::TAU;

use clap::ValueEnum;
use eit::{Mesh, polygon_contains};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::sheet::away;
use crate::evaluation::test_set;

/// Kinds of load, judged apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ValueEnum)]
pub enum TargetKind {
    /// A disc of 10 mm, half the conductance lost
    Press10,
    /// A disc of 30 mm
    Press30,
    /// Algorithm 1 of the paper
    Polygons,
    /// One to three discs, 10 to 70 mm wide, losses of 0.1 to 0.9
    Discs,
    /// A Gaussian, or the pressure under a sphere (Hertz)
    Blob,
    /// A ring
    Ring,
    /// A disc without a part of another
    Crescent,
    /// Sole and heel
    Foot,
    /// A palm and four fingers
    Hand,
    /// Seven discs
    SevenDiscs,
    /// A bar, six to ten times as long as wide
    Bar,
    /// A disc whose centre lies on the border of the region
    Outside,
    /// A loss that grows along one direction
    Ramp,
    /// A sum of random waves
    Field,
    /// No load
    Nothing,
}

impl TargetKind {
    /// Displayed name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Press10 => "press of 10 mm",
            Self::Press30 => "press of 30 mm",
            Self::Polygons => "polygons of the paper",
            Self::Discs => "discs",
            Self::Blob => "soft blob",
            Self::Ring => "ring",
            Self::Crescent => "crescent",
            Self::Foot => "foot",
            Self::Hand => "hand",
            Self::SevenDiscs => "seven discs",
            Self::Bar => "bar",
            Self::Outside => "load over the region's border",
            Self::Ramp => "ramp over the sheet",
            Self::Field => "random field",
            Self::Nothing => "nothing",
        }
    }
}

/// Lowest and highest corner of the region, m.
type Bounds = [[f64; 2]; 2];

/// A load: the share of the conductance that is lost, as a function of the position (m).
pub(super) struct Target {
    loss: Box<dyn Fn([f64; 2]) -> f64 + Sync>,
}

impl Target {
    /// Draws a load of this kind within the region of this mesh.
    pub(super) fn draw(kind: TargetKind, mesh: &Mesh, random: &mut ChaCha8Rng) -> Self {
        let bounds = test_set::bounds(mesh).map(|corner| corner.map(|mm| 1e-3 * mm));
        let loss = random.random_range(0.2..0.8);
        Self {
            loss: match kind {
                TargetKind::Press10 => press(mesh, 10.0, random),
                TargetKind::Press30 => press(mesh, 30.0, random),
                TargetKind::Polygons => outlines(test_set::polygons(mesh, random).loads),
                TargetKind::Discs => {
                    let count = random.random_range(1..=3);
                    let discs = (0..count)
                        .map(|_| {
                            let radius = 5e-3 * 7_f64.powf(random.random_range(0.0..1.0));
                            let centre = inside(bounds, radius, random);
                            (centre, radius, random.random_range(0.1..0.9))
                        })
                        .collect();
                    under_discs(discs)
                }
                TargetKind::Blob => {
                    let width = random.random_range(8e-3..30e-3);
                    let centre = inside(bounds, 0.5 * width, random);
                    match random.random_bool(0.5) {
                        true => Box::new(move |at| {
                            loss * (-0.5 * (away(at, centre) / width).powi(2)).exp()
                        }),
                        false => Box::new(move |at| {
                            let share = away(at, centre) / (1.5 * width);
                            loss * (1.0 - share * share).max(0.0).sqrt()
                        }),
                    }
                }
                TargetKind::Ring => {
                    let outer = random.random_range(20e-3..45e-3);
                    let inner = outer * random.random_range(0.5..0.75);
                    let centre = inside(bounds, outer, random);
                    Box::new(move |at| match (inner..outer).contains(&away(at, centre)) {
                        true => loss,
                        false => 0.0,
                    })
                }
                TargetKind::Crescent => {
                    let radius = random.random_range(20e-3..45e-3);
                    let centre = inside(bounds, radius, random);
                    let angle: f64 = random.random_range(0.0..TAU);
                    let shift = radius * random.random_range(0.4..0.7);
                    let other = [
                        centre[0] + shift * angle.cos(),
                        centre[1] + shift * angle.sin(),
                    ];
                    Box::new(move |at| {
                        let within = away(at, centre) < radius && away(at, other) > 0.9 * radius;
                        if within { loss } else { 0.0 }
                    })
                }
                TargetKind::Foot => {
                    let size = random.random_range(0.8..1.2);
                    turned(bounds, 45e-3 * size, random, move |[x, y]| {
                        let [x, y] = [x / size, y / size];
                        let sole = (x / 18e-3).powi(2) + ((y - 18e-3) / 25e-3).powi(2) < 1.0;
                        let heel = (x / 12e-3).powi(2) + ((y + 28e-3) / 14e-3).powi(2) < 1.0;
                        if sole || heel { loss } else { 0.0 }
                    })
                }
                TargetKind::Hand => {
                    let size = random.random_range(0.8..1.2);
                    turned(bounds, 45e-3 * size, random, move |[x, y]| {
                        let [x, y] = [x / size, y / size];
                        let palm = x.abs() < 22e-3 && (-40e-3..0.0).contains(&y);
                        let finger = (0..4).any(|k| {
                            let middle = (f64::from(k) - 1.5) * 12e-3;
                            (x - middle).abs() < 4e-3 && (0.0..40e-3).contains(&y)
                        });
                        if palm || finger { loss } else { 0.0 }
                    })
                }
                TargetKind::SevenDiscs => under_discs(
                    (0..7)
                        .map(|_| {
                            let radius = random.random_range(6e-3..15e-3);
                            let centre = inside(bounds, radius, random);
                            (centre, radius, random.random_range(0.2..0.8))
                        })
                        .collect(),
                ),
                TargetKind::Bar => {
                    let length = random.random_range(60e-3..140e-3);
                    let width = length / random.random_range(6.0..10.0);
                    turned(bounds, 0.5 * length, random, move |[x, y]| {
                        let within = x.abs() < 0.5 * length && y.abs() < 0.5 * width;
                        if within { loss } else { 0.0 }
                    })
                }
                TargetKind::Outside => {
                    let radius = random.random_range(8e-3..25e-3);
                    let mut centre = inside(bounds, 0.0, random);
                    let axis = usize::from(random.random_bool(0.5));
                    centre[axis] = bounds[usize::from(random.random_bool(0.5))][axis];
                    under_discs(vec![(centre, radius, loss)])
                }
                TargetKind::Ramp => {
                    let angle: f64 = random.random_range(0.0..TAU);
                    let most = random.random_range(0.05..0.5);
                    let [low, high] = bounds;
                    let share = move |at: [f64; 2], axis: usize| {
                        (at[axis] - low[axis]) / (high[axis] - low[axis]) - 0.5
                    };
                    Box::new(move |at| {
                        let along = share(at, 0) * angle.cos() + share(at, 1) * angle.sin();
                        (most * (0.5 + along / std::f64::consts::SQRT_2)).clamp(0.0, 0.95)
                    })
                }
                TargetKind::Field => field(random),
                TargetKind::Nothing => Box::new(|_| 0.0),
            },
        }
    }

    /// The relative change of each of these triangles of a mesh: the mean over 16 points in the triangle.
    pub(super) fn change(&self, mesh: &Mesh, triangles: impl Iterator<Item = usize>) -> Vec<f64> {
        let mean = |losses: [f64; 16]| -losses.iter().sum::<f64>() / losses.len() as f64;
        triangles.map(|t| mean(self.losses(mesh, t))).collect()
    }

    /// The factor of the conductance of each triangle of a mesh, for the simulation of readings: the geometric mean
    /// over 16 points in the triangle. Current crosses the border of a load in all directions; the arithmetic mean
    /// would hold for current along the border.
    pub(super) fn factors(&self, mesh: &Mesh) -> Vec<f64> {
        let mean = |losses: [f64; 16]| {
            let logs = losses.iter().map(|loss| (1.0 - loss).max(1e-9).ln());
            (logs.sum::<f64>() / losses.len() as f64).exp()
        };
        let triangles = 0..mesh.triangles().len();
        triangles.map(|t| mean(self.losses(mesh, t))).collect()
    }

    /// The losses at 16 points in a triangle.
    fn losses(&self, mesh: &Mesh, triangle: usize) -> [f64; 16] {
        let corners = mesh.triangles()[triangle].map(|node| mesh.nodes()[node]);
        sixteenths().map(|shares| {
            let place = [0, 1].map(|axis| (0..3).map(|k| shares[k] * corners[k][axis]).sum());
            (self.loss)(place)
        })
    }
}

/// Barycentric coordinates of the centroids of the 16 equal parts of a triangle.
fn sixteenths() -> [[f64; 3]; 16] {
    let mut places = [[0.0; 3]; 16];
    let mut next = 0;
    for i in 0..4 {
        for j in 0..4 - i {
            let k = 3 - i - j;
            places[next] = [i, j, k].map(|n| (f64::from(n) + 1.0 / 3.0) / 4.0);
            next += 1;
            if i + j < 3 {
                let k = 2 - i - j;
                places[next] = [i, j, k].map(|n| (f64::from(n) + 2.0 / 3.0) / 4.0);
                next += 1;
            }
        }
    }
    places
}

type Loss = Box<dyn Fn([f64; 2]) -> f64 + Sync>;

/// A random point at least `margin` from the border of the region, m.
fn inside([low, high]: Bounds, margin: f64, random: &mut ChaCha8Rng) -> [f64; 2] {
    [0, 1].map(|axis| random.random_range(low[axis] + margin..=high[axis] - margin))
}

/// Discs with centre (m), radius (m) and loss; where they overlap, the largest loss applies.
fn under_discs(discs: Vec<([f64; 2], f64, f64)>) -> Loss {
    Box::new(move |at| {
        let under = discs
            .iter()
            .filter(|(centre, radius, _)| away(at, *centre) < *radius);
        under.map(|(.., loss)| *loss).fold(0.0, f64::max)
    })
}

fn press(mesh: &Mesh, diameter_mm: f64, random: &mut ChaCha8Rng) -> Loss {
    outlines(test_set::press(mesh, diameter_mm, random).loads)
}

/// The loads of a test set; the remaining shares under overlapping loads are multiplied.
fn outlines(loads: Vec<phantom::Load>) -> Loss {
    let outlines: Vec<(Vec<[f64; 2]>, f64)> = loads
        .iter()
        .map(|load| (load.outline(), load.loss))
        .collect();
    Box::new(move |at| {
        let over = outlines
            .iter()
            .filter(|(outline, _)| polygon_contains(outline, at));
        1.0 - over.map(|(_, loss)| 1.0 - loss).product::<f64>()
    })
}

/// A shape around the origin, moved to a random position and turned by a random angle.
fn turned(
    bounds: Bounds,
    reach: f64,
    random: &mut ChaCha8Rng,
    loss: impl Fn([f64; 2]) -> f64 + Sync + 'static,
) -> Loss {
    let centre = inside(bounds, reach, random);
    let (sin, cos) = random.random_range(0.0..TAU).sin_cos();
    Box::new(move |at| {
        let [x, y] = [at[0] - centre[0], at[1] - centre[1]];
        loss([cos * x + sin * y, cos * y - sin * x])
    })
}

/// Losses between 0 and at most 0.6: the sum of twelve random waves with wavelengths of 60 mm or more.
fn field(random: &mut ChaCha8Rng) -> Loss {
    let most = random.random_range(0.1..0.6);
    let waves: Vec<[f64; 3]> = (0..12)
        .map(|_| {
            let number = TAU / random.random_range(60e-3..300e-3);
            let angle: f64 = random.random_range(0.0..TAU);
            [
                number * angle.cos(),
                number * angle.sin(),
                random.random_range(0.0..TAU),
            ]
        })
        .collect();
    Box::new(move |[x, y]| {
        let sum: f64 = waves
            .iter()
            .map(|[a, b, phase]| (a * x + b * y + phase).sin())
            .sum();
        most * 0.5 * (1.0 + (sum / 12_f64.sqrt()).clamp(-1.0, 1.0))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_parts_have_their_middle_in_the_middle() {
        let places = sixteenths();
        for corner in 0..3 {
            let mean = places.iter().map(|place| place[corner]).sum::<f64>() / 16.0;
            assert!((mean - 1.0 / 3.0).abs() < 1e-12, "{mean}");
        }
        assert!(places.iter().flatten().all(|share| *share > 0.0));
    }

    #[test]
    fn polygon_contains_what_it_encloses() {
        let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        assert!(polygon_contains(&square, [1.0, 1.5]));
        assert!(!polygon_contains(&square, [2.5, 1.0]) && !polygon_contains(&square, [1.0, -0.1]));
    }
}
