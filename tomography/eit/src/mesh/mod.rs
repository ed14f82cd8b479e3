//! A validated triangulated sheet with electrodes on its boundary.

mod check;
mod depth;
mod error;
pub(crate) mod generation;
mod kept;
pub(crate) mod polygon;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};

use sha2::{Digest, Sha256};
use survey::Electrode;

pub use depth::Depth;
pub(crate) use depth::Mode;
pub use error::MeshError;
use kept::Kept;
use polygon::left_of;

/// Area, as a share of the whole sheet, below which a triangle counts as degenerate.
const SMALLEST_AREA: f64 = 1e-12;

/// An electrode with fewer edges loses current, and its resistance depends on the mesh.
pub const ENOUGH_EDGES: usize = 4;

/// Linear triangles, the boundary edges that each electrode touches, and the region of interest.
///
/// Metres throughout. Every node is used, every triangle is counter-clockwise, the sheet is one piece, electrodes lie
/// on boundary edges (of the outer rim or of a hole) and do not touch each other.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    nodes: Vec<[f64; 2]>,
    triangles: Vec<[usize; 3]>,
    electrode_edges: Vec<Vec<[usize; 2]>>,
    region: Vec<usize>,
    areas: Vec<f64>,
    depth: Option<Depth>,
    hash: String,
    /// The analysis of the forward model.
    analysis: Kept,
}

/// Statistics of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct MeshQuality {
    /// Number of nodes.
    pub nodes: usize,
    /// Number of triangles.
    pub triangles: usize,
    /// Number of triangles in the region of interest.
    pub region: usize,
    /// Area of the sheet, m2.
    pub area: f64,
    /// Smallest angle of all triangles, degrees.
    pub smallest_angle: f64,
    /// Largest angle of all triangles, degrees.
    pub largest_angle: f64,
    /// Fewest edges under an electrode.
    pub fewest_electrode_edges: usize,
    /// Electrodes with fewer than [`ENOUGH_EDGES`] edges: usable, but their resistance depends on the mesh.
    pub coarse_electrodes: Vec<Electrode>,
}

impl Mesh {
    /// Validates a mesh. `region` lists triangles; `None` is all of them.
    ///
    /// # Errors
    /// The first fault found, naming node, element or electrode.
    pub fn new(
        nodes: Vec<[f64; 2]>,
        triangles: Vec<[usize; 3]>,
        electrode_edges: Vec<Vec<[usize; 2]>>,
        region: Option<Vec<usize>>,
    ) -> Result<Self, MeshError> {
        let areas = check::triangles(&nodes, &triangles)?;
        let sides = check::sides(&triangles)?;
        check::connected(&triangles, &sides)?;
        check::electrodes(&sides, &electrode_edges)?;
        let region = check::region(region, triangles.len())?;
        let mesh = Self {
            nodes,
            triangles,
            electrode_edges,
            region,
            areas,
            depth: None,
            hash: String::new(),
            analysis: Kept::default(),
        };
        Ok(mesh.hashed())
    }

    /// The same mesh with all triangles in its region.
    pub fn whole(&self) -> Self {
        let mesh = Self {
            region: (0..self.triangles.len()).collect(),
            ..self.clone()
        };
        mesh.hashed()
    }

    /// The same mesh as the cross-section of a tank of this depth; `None`: a sheet.
    pub fn with_depth(&self, depth: Option<Depth>) -> Self {
        let mesh = Self {
            depth,
            ..self.clone()
        };
        mesh.hashed()
    }

    /// The same mesh with the hash of its content.
    fn hashed(mut self) -> Self {
        let mut hasher = Sha256::new();
        let count = |hasher: &mut Sha256, n: usize| hasher.update((n as u64).to_le_bytes());
        count(&mut hasher, self.nodes.len());
        for coordinate in self.nodes.iter().flatten() {
            hasher.update(coordinate.to_bits().to_le_bytes());
        }
        count(&mut hasher, self.triangles.len());
        for &node in self.triangles.iter().flatten() {
            count(&mut hasher, node);
        }
        count(&mut hasher, self.electrode_edges.len());
        for edges in &self.electrode_edges {
            count(&mut hasher, edges.len());
            for &node in edges.iter().flatten() {
                count(&mut hasher, node);
            }
        }
        count(&mut hasher, self.region.len());
        for &element in &self.region {
            count(&mut hasher, element);
        }
        for number in self.depth.iter().flat_map(Depth::numbers) {
            hasher.update(number.to_bits().to_le_bytes());
        }
        self.hash = survey::hex(&hasher.finalize());
        self
    }

    /// Cache for the forward model's analysis of nodes, triangles and electrodes.
    pub(crate) fn analysis(&self) -> &Kept {
        &self.analysis
    }

    /// The depth of the tank of which this is the cross-section; `None`: a sheet.
    pub fn depth(&self) -> Option<Depth> {
        self.depth
    }

    /// Positions, m.
    pub fn nodes(&self) -> &[[f64; 2]] {
        &self.nodes
    }

    /// Corners of each triangle, counter-clockwise.
    pub fn triangles(&self) -> &[[usize; 3]] {
        &self.triangles
    }

    /// Boundary edges under each electrode.
    pub fn electrode_edges(&self) -> &[Vec<[usize; 2]>] {
        &self.electrode_edges
    }

    /// Number of electrodes.
    pub fn electrodes(&self) -> usize {
        self.electrode_edges.len()
    }

    /// Triangles of the region of interest, in the order of a map's values.
    pub fn region(&self) -> &[usize] {
        &self.region
    }

    /// Area of a triangle, m2.
    pub fn area(&self, triangle: usize) -> f64 {
        self.areas[triangle]
    }

    /// Centroid of a triangle, m.
    pub fn centroid(&self, triangle: usize) -> [f64; 2] {
        let [a, b, c] = self.corners(triangle);
        [(a[0] + b[0] + c[0]) / 3.0, (a[1] + b[1] + c[1]) / 3.0]
    }

    /// The three corners of a triangle, m.
    pub fn corners(&self, triangle: usize) -> [[f64; 2]; 3] {
        self.triangles[triangle].map(|node| self.nodes[node])
    }

    /// Centroids of the region's triangles, m.
    pub fn region_centroids(&self) -> Vec<[f64; 2]> {
        self.region.iter().map(|&t| self.centroid(t)).collect()
    }

    /// Areas of the region's triangles, m2.
    pub fn region_areas(&self) -> Vec<f64> {
        self.region.iter().map(|&t| self.areas[t]).collect()
    }

    /// Length of the contact of an electrode, m.
    pub fn electrode_length(&self, electrode: usize) -> f64 {
        self.electrode_edges[electrode]
            .iter()
            .map(|edge| self.edge_length(*edge))
            .sum()
    }

    /// Centre of each electrode: the length-weighted mean of its edges, m.
    pub fn electrode_centres(&self) -> Vec<[f64; 2]> {
        self.electrode_edges
            .iter()
            .map(|edges| {
                let mut weight = 0.0;
                let mut sum = [0.0; 2];
                for &[a, b] in edges {
                    let length = self.edge_length([a, b]);
                    weight += length;
                    for (axis, sum) in sum.iter_mut().enumerate() {
                        *sum += 0.5 * length * (self.nodes[a][axis] + self.nodes[b][axis]);
                    }
                }
                sum.map(|sum| sum / weight)
            })
            .collect()
    }

    /// Length of an edge, m.
    pub fn edge_length(&self, [a, b]: [usize; 2]) -> f64 {
        let [a, b] = [self.nodes[a], self.nodes[b]];
        (b[0] - a[0]).hypot(b[1] - a[1])
    }

    /// The sides that two of these triangles share, ordered by the second occurrence of the side: the positions of both
    /// triangles in the list, the earlier one first, and the length, m.
    pub fn borders(&self, triangles: &[usize]) -> Vec<([usize; 2], f64)> {
        let mut open = BTreeMap::new();
        let mut borders = Vec::new();
        for (position, &triangle) in triangles.iter().enumerate() {
            for [p, q] in sides_of(&self.triangles[triangle]) {
                if let Some(other) = open.insert([p.min(q), p.max(q)], position) {
                    borders.push(([other, position], self.edge_length([p, q])));
                }
            }
        }
        borders
    }

    /// The sides that belong to one triangle only, in the direction of that triangle: the rim and the holes.
    pub fn boundary(&self) -> Vec<[usize; 2]> {
        let directed: BTreeSet<[usize; 2]> = self.triangles.iter().flat_map(sides_of).collect();
        let single = |[a, b]: &&[usize; 2]| !directed.contains(&[*b, *a]);
        directed.iter().filter(single).copied().collect()
    }

    /// The boundary as closed loops (the first point is not repeated): the rim counter-clockwise, holes clockwise.
    pub fn outline(&self) -> Vec<Vec<[f64; 2]>> {
        let mut next: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for [a, b] in self.boundary() {
            next.entry(a).or_default().push(b);
        }
        let mut loops = Vec::new();
        while let Some((&start, _)) = next.iter().next() {
            let mut at = start;
            let mut points = Vec::new();
            while let Some(ends) = next.get_mut(&at) {
                let to = ends.pop();
                if ends.is_empty() {
                    next.remove(&at);
                }
                points.push(self.nodes[at]);
                match to {
                    Some(to) if to != start => at = to,
                    _ => break,
                }
            }
            loops.push(points);
        }
        loops
    }

    /// SHA-256, hex, over every bit of the geometry: nodes, triangles, electrodes, region and, where there is one, depth.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Computes the statistics.
    pub fn quality(&self) -> MeshQuality {
        let mut smallest = f64::INFINITY;
        let mut largest = 0.0_f64;
        for t in 0..self.triangles.len() {
            for angle in angles(self.corners(t)) {
                smallest = smallest.min(angle);
                largest = largest.max(angle);
            }
        }
        MeshQuality {
            nodes: self.nodes.len(),
            triangles: self.triangles.len(),
            region: self.region.len(),
            area: self.areas.iter().sum(),
            smallest_angle: smallest.to_degrees(),
            largest_angle: largest.to_degrees(),
            fewest_electrode_edges: self.electrode_edges.iter().map(Vec::len).min().unwrap_or(0),
            coarse_electrodes: self
                .electrode_edges
                .iter()
                .enumerate()
                .filter(|(_, edges)| edges.len() < ENOUGH_EDGES)
                .map(|(electrode, _)| Electrode(electrode))
                .collect(),
        }
    }
}

/// Lowest and highest corner of the rectangle round points; infinite without a point.
pub fn bounding_box(points: impl IntoIterator<Item = [f64; 2]>) -> [[f64; 2]; 2] {
    points.into_iter().fold(
        [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]],
        |[low, high], p| {
            [
                [low[0].min(p[0]), low[1].min(p[1])],
                [high[0].max(p[0]), high[1].max(p[1])],
            ]
        },
    )
}

/// The signed area.
pub(crate) fn signed_area([a, b, c]: [[f64; 2]; 3]) -> f64 {
    0.5 * left_of([a, b], c)
}

/// The angles at the corners, radian.
pub(crate) fn angles(corners: [[f64; 2]; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| {
        let [p, q, r] = [corners[i], corners[(i + 1) % 3], corners[(i + 2) % 3]];
        let (u, v) = ([q[0] - p[0], q[1] - p[1]], [r[0] - p[0], r[1] - p[1]]);
        (u[0] * v[1] - u[1] * v[0]).atan2(u[0] * v[0] + u[1] * v[1])
    })
}

fn sides_of(triangle: &[usize; 3]) -> [[usize; 2]; 3] {
    let [a, b, c] = *triangle;
    [[a, b], [b, c], [c, a]]
}
