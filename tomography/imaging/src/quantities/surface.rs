//! The part of the sheet that a map covers, prepared for quantities: areas, neighbours, discs and named regions.

use std::collections::HashMap;

use eit::{Mesh, bounding_box, polygon_contains};
use survey::Adjacency;

use super::region::{RegionError, RegionSettings, SHEET};

/// A triangle is cut into 4^CUTS equal parts to compute the share of it that lies in a disc or a region.
const CUTS: u32 = 2;

/// The triangles of a map, prepared for its quantities.
#[derive(Debug, Clone)]
pub struct Surface {
    /// Hash of the mesh.
    mesh: String,
    adjacency: Adjacency,
    /// Corners of each triangle as positions in `vertices`.
    corners: Vec<[usize; 3]>,
    vertices: Vec<[f64; 2]>,
    /// One disc around each centroid.
    discs: Vec<IndexDisc>,
    regions: Vec<SurfaceRegion>,
}

/// The triangles that a disc of the peak pressure index covers.
#[derive(Debug, Clone)]
struct IndexDisc {
    triangles: Vec<u32>,
    /// The area of each inside of the disc, m2.
    inside: Vec<f64>,
    /// The disc's area on the sheet, m2.
    area: f64,
}

/// The whole sheet or a named region.
#[derive(Debug, Clone)]
pub(super) struct SurfaceRegion {
    pub(super) name: String,
    /// Share of each triangle that lies in it, 0 to 1.
    pub(super) shares: Vec<f64>,
}

impl Surface {
    /// Prepares the region of a mesh. `window`: area of the discs of the peak pressure index, m2.
    ///
    /// # Errors
    /// A region that is invalid or does not touch the mesh's region.
    pub fn new(mesh: &Mesh, window: f64, regions: &[RegionSettings]) -> Result<Self, RegionError> {
        let triangles: Vec<_> = mesh.region().iter().map(|t| mesh.corners(*t)).collect();
        Ok(Self {
            mesh: mesh.hash().to_owned(),
            ..Self::of_triangles(&triangles, window, regions)?
        })
    }

    /// Hash of the mesh.
    pub(super) fn mesh(&self) -> &str {
        &self.mesh
    }

    pub(super) fn of_triangles(
        triangles: &[[[f64; 2]; 3]],
        window: f64,
        regions: &[RegionSettings],
    ) -> Result<Self, RegionError> {
        let parts: Vec<Vec<[f64; 2]>> = triangles.iter().map(parts).collect();
        let mut prepared = vec![SurfaceRegion {
            name: SHEET.to_owned(),
            shares: vec![1.0; triangles.len()],
        }];
        for region in regions {
            let corners = region.corners()?;
            let shares: Vec<f64> = parts
                .iter()
                .map(|parts| share(parts, |point| polygon_contains(&corners, point)))
                .collect();
            if shares.iter().all(|share| *share == 0.0) {
                let all = triangles.iter().flatten().copied();
                let [low, high] = bounding_box(all).map(|corner| corner.map(|m| 1e3 * m));
                return Err(RegionError::Beside {
                    name: region.name.clone(),
                    low,
                    high,
                });
            }
            prepared.push(SurfaceRegion {
                name: region.name.clone(),
                shares,
            });
        }
        let adjacency = Adjacency::new(triangles);
        let discs = discs(
            triangles,
            &parts,
            &adjacency,
            (window / std::f64::consts::PI).sqrt(),
        );
        let (corners, vertices) = vertices(triangles);
        Ok(Self {
            mesh: String::new(),
            adjacency,
            corners,
            vertices,
            discs,
            regions: prepared,
        })
    }

    /// Names of the regions; the first is the whole sheet.
    pub fn regions(&self) -> impl Iterator<Item = &str> {
        self.regions.iter().map(|region| region.name.as_str())
    }

    /// Area of the whole sheet or a region, m2; `None` for an unknown name.
    pub fn area(&self, region: &str) -> Option<f64> {
        let region = self.regions.iter().find(|one| one.name == region)?;
        let areas = self.adjacency.areas().iter().zip(&region.shares);
        Some(areas.map(|(area, share)| area * share).sum())
    }

    pub(super) fn region_list(&self) -> &[SurfaceRegion] {
        &self.regions
    }

    /// The triangles with their neighbours.
    pub fn adjacency(&self) -> &Adjacency {
        &self.adjacency
    }

    /// Means of the values over the disc around each centroid.
    pub(super) fn disc_means(&self, loads: &[f64]) -> Vec<f64> {
        let mean = |disc: &IndexDisc| integral(loads, &disc.triangles, &disc.inside) / disc.area;
        self.discs.iter().map(mean).collect()
    }

    /// Norm of the gradient in each triangle, per m: the values are averaged at the vertices, weighted by area, and
    /// interpolated linearly.
    pub(super) fn gradients(&self, loads: &[f64]) -> Vec<f64> {
        let areas = self.adjacency.areas();
        let mut sums = vec![(0.0, 0.0); self.vertices.len()];
        for (triangle, corners) in self.corners.iter().enumerate() {
            for corner in corners {
                sums[*corner].0 += loads[triangle] * areas[triangle];
                sums[*corner].1 += areas[triangle];
            }
        }
        let at: Vec<f64> = sums.into_iter().map(|(sum, area)| sum / area).collect();
        self.corners
            .iter()
            .map(|[a, b, c]| {
                let [p, q, r] = [a, b, c].map(|corner| self.vertices[*corner]);
                let (u, v) = ([q[0] - p[0], q[1] - p[1]], [r[0] - p[0], r[1] - p[1]]);
                let twice = u[0] * v[1] - u[1] * v[0];
                let (du, dv) = (at[*b] - at[*a], at[*c] - at[*a]);
                ((du * v[1] - dv * u[1]) / twice).hypot((dv * u[0] - du * v[0]) / twice)
            })
            .collect()
    }
}

/// Sum of values times areas over triangles, as four independent sums: in a single sum each addition would wait for the
/// previous one.
fn integral(loads: &[f64], triangles: &[u32], areas: &[f64]) -> f64 {
    let (triangles, last_triangles) = triangles.as_chunks::<4>();
    let (areas, last_areas) = areas.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (triangles, areas) in triangles.iter().zip(areas) {
        for lane in 0..4 {
            sums[lane] += loads[triangles[lane] as usize] * areas[lane];
        }
    }
    let last = last_triangles.iter().zip(last_areas);
    let last: f64 = last.map(|(t, area)| loads[*t as usize] * area).sum();
    sums.iter().sum::<f64>() + last
}

/// Centroids of the equal parts of a triangle.
fn parts(triangle: &[[f64; 2]; 3]) -> Vec<[f64; 2]> {
    let mut whole = vec![*triangle];
    for _ in 0..CUTS {
        whole = whole.iter().flat_map(quarters).collect();
    }
    let centroid = |corners: &[[f64; 2]; 3]| {
        [0, 1].map(|axis| corners.iter().map(|c| c[axis]).sum::<f64>() / 3.0)
    };
    whole.iter().map(centroid).collect()
}

fn quarters([a, b, c]: &[[f64; 2]; 3]) -> [[[f64; 2]; 3]; 4] {
    let middle = |p: &[f64; 2], q: &[f64; 2]| [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])];
    let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
    [[*a, ab, ca], [ab, *b, bc], [ca, bc, *c], [ab, bc, ca]]
}

fn share(parts: &[[f64; 2]], inside: impl Fn([f64; 2]) -> bool) -> f64 {
    parts.iter().filter(|point| inside(**point)).count() as f64 / parts.len() as f64
}

/// The triangles in a disc of this radius around each centroid, and the area of each triangle within the disc.
fn discs(
    triangles: &[[[f64; 2]; 3]],
    parts: &[Vec<[f64; 2]>],
    adjacency: &Adjacency,
    radius: f64,
) -> Vec<IndexDisc> {
    let centroids = adjacency.centroids();
    let distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    // distance of a triangle's farthest corner from its centroid
    let reach: Vec<f64> = triangles
        .iter()
        .zip(centroids)
        .map(|(corners, at)| {
            corners
                .iter()
                .map(|c| distance(*c, *at))
                .fold(0.0, f64::max)
        })
        .collect();
    // sorted by x, so that only triangles within a strip are compared
    let mut by_x: Vec<usize> = (0..triangles.len()).collect();
    by_x.sort_by(|a, b| centroids[*a][0].total_cmp(&centroids[*b][0]));
    let farthest = radius + reach.iter().copied().fold(0.0, f64::max);
    (0..triangles.len())
        .map(|centre| {
            let x = centroids[centre][0];
            let from = by_x.partition_point(|t| centroids[*t][0] < x - farthest);
            let to = by_x.partition_point(|t| centroids[*t][0] <= x + farthest);
            let mut covered: Vec<(usize, f64)> = by_x[from..to]
                .iter()
                .filter_map(|&triangle| {
                    let apart = distance(centroids[triangle], centroids[centre]);
                    let within = if apart > radius + reach[triangle] {
                        0.0
                    } else if apart + reach[triangle] <= radius {
                        1.0
                    } else {
                        share(&parts[triangle], |point| {
                            distance(point, centroids[centre]) <= radius
                        })
                    };
                    (within > 0.0).then(|| (triangle, adjacency.areas()[triangle] * within))
                })
                .collect();
            // a disc much smaller than its triangle contains no part's centroid
            if covered.is_empty() {
                covered.push((centre, adjacency.areas()[centre]));
            }
            IndexDisc {
                triangles: covered
                    .iter()
                    .map(|(triangle, _)| *triangle as u32)
                    .collect(),
                inside: covered.iter().map(|(_, area)| *area).collect(),
                area: covered.iter().map(|(_, area)| area).sum(),
            }
        })
        .collect()
}

fn vertices(triangles: &[[[f64; 2]; 3]]) -> (Vec<[usize; 3]>, Vec<[f64; 2]>) {
    let mut vertices = Vec::new();
    let mut known: HashMap<[u64; 2], usize> = HashMap::new();
    let corners = triangles
        .iter()
        .map(|corners| {
            corners.map(|corner| {
                *known.entry(corner.map(f64::to_bits)).or_insert_with(|| {
                    vertices.push(corner);
                    vertices.len() - 1
                })
            })
        })
        .collect();
    (corners, vertices)
}
