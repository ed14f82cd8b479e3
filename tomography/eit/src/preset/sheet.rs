//! The paper's sheet: a rectangle with electrodes along its edge, which are square voids or parts of the edge itself.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{FINENESS, positive, refused, within};
use crate::mesh::generation::{Domain, cut, fill, length};
use crate::{Mesh, MeshError};

const PRESET: &str = "paper-sheet";

/// Longest side of a sheet as a multiple of the shorter one.
const LONGEST_SHARE: f64 = 20.0;

/// A rectangle with its origin at the lower left corner, electrodes counter-clockwise from the lower
/// left along the bottom, the right, the top and the left side, evenly spaced on each; symmetric in both axes.
///
/// The paper does not give size and inset of the electrodes, nor sheet and contact resistance: they are configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperSheet {
    /// Form of the electrodes.
    pub electrode: SheetElectrode,
    /// Extent along x, mm.
    pub width_mm: f64,
    /// Extent along y, mm.
    pub height_mm: f64,
    /// Electrodes along the bottom, and as many along the top.
    pub electrodes_per_width: usize,
    /// Electrodes along the right, and as many along the left.
    pub electrodes_per_height: usize,
    /// Side of a square void, or length of an electrode on the edge, mm.
    pub void_mm: f64,
    /// Distance from the sheet's edge to the centre of a void, mm; unused for electrodes on the edge.
    pub inset_mm: f64,
    /// The region of interest reaches this far from the centre along x, mm.
    pub region_half_width_mm: f64,
    /// The region of interest reaches this far from the centre along y, mm.
    pub region_half_height_mm: f64,
    /// Divides every edge length: 2 gives about four times the triangles. 1 gives 9,612 triangles, 3,684 of them in
    /// the region, with angles from 31 to 105 degrees.
    pub fineness: f64,
    /// Edge length at an electrode at fineness 1, mm.
    pub edge_mm: f64,
    /// Edge length far from every electrode at fineness 1, mm.
    pub largest_mm: f64,
    /// Growth of the edge length with the distance from the nearest electrode at fineness 1.
    pub growth: f64,
    /// A different number gives a different mesh with the same sizes.
    pub seeding: u32,
    /// Resistance of the unloaded sheet, ohm per square.
    pub sheet_ohm: f64,
    /// Resistance of one contact, ohm.
    pub contact_ohm: f64,
}

/// Form of the electrodes of a [`PaperSheet`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SheetElectrode {
    /// The rim of a square hole in the sheet, as in the paper's Figure 3A.
    #[default]
    Void,
    /// A part of the sheet's own edge.
    Edge,
}

impl Default for PaperSheet {
    fn default() -> Self {
        Self {
            electrode: SheetElectrode::default(),
            width_mm: 214.0,
            height_mm: 230.0,
            electrodes_per_width: 6,
            electrodes_per_height: 7,
            void_mm: 6.0,
            inset_mm: 8.0,
            region_half_width_mm: 88.76,
            region_half_height_mm: 95.40,
            fineness: 1.0,
            edge_mm: 1.5,
            largest_mm: 5.4,
            growth: 0.14,
            seeding: 0,
            sheet_ohm: 1000.0,
            contact_ohm: 100.0,
        }
    }
}

impl PaperSheet {
    /// Number of electrodes.
    pub fn electrodes(&self) -> usize {
        2 * (self.electrodes_per_width + self.electrodes_per_height)
    }

    /// Centres of the electrodes in order, mm.
    pub fn centres_mm(&self) -> Vec<[f64; 2]> {
        let (nx, ny) = (self.electrodes_per_width, self.electrodes_per_height);
        let x = |k: usize| (k as f64 + 0.5) / nx as f64 * self.width_mm;
        let y = |k: usize| (k as f64 + 0.5) / ny as f64 * self.height_mm;
        let inset = match self.electrode {
            SheetElectrode::Void => self.inset_mm,
            SheetElectrode::Edge => 0.0,
        };
        let (right, top) = (self.width_mm - inset, self.height_mm - inset);
        let bottom = (0..nx).map(|k| [x(k), inset]);
        let right = (0..ny).map(|k| [right, y(k)]);
        let top = (0..nx).rev().map(|k| [x(k), top]);
        let left = (0..ny).rev().map(|k| [inset, y(k)]);
        bottom.chain(right).chain(top).chain(left).collect()
    }

    /// Sheet conductance of the unloaded sheet, siemens per square.
    pub fn conductance(&self) -> f64 {
        1.0 / self.sheet_ohm
    }

    /// Contact impedance of each electrode, ohm m: contact resistance times the contact length.
    pub fn contact_ohm_m(&self) -> Vec<f64> {
        let sides = match self.electrode {
            SheetElectrode::Void => 4.0,
            SheetElectrode::Edge => 1.0,
        };
        vec![self.contact_ohm * sides * self.void_mm * 1e-3; self.electrodes()]
    }

    /// The mesh: one quarter, mirrored twice.
    ///
    /// # Errors
    /// Inconsistent dimensions; the key is named.
    pub fn mesh(&self) -> Result<Mesh, MeshError> {
        self.check()?;
        let (nodes, triangles) = self.mirror(self.quarter()?);
        let centres = self.centres_mm();
        let electrode_edges = self.electrode_edges(&nodes, &triangles, &centres);
        let middle = [0.5 * self.width_mm, 0.5 * self.height_mm];
        let region = (0..triangles.len())
            .filter(|&t| {
                let [a, b, c] = triangles[t].map(|node: usize| nodes[node]);
                ((a[0] + b[0] + c[0]) / 3.0 - middle[0]).abs() <= self.region_half_width_mm
                    && ((a[1] + b[1] + c[1]) / 3.0 - middle[1]).abs() <= self.region_half_height_mm
            })
            .collect();
        let metres = nodes.iter().map(|p| [p[0] * 1e-3, p[1] * 1e-3]).collect();
        Mesh::new(metres, triangles, electrode_edges, Some(region))
    }

    fn check(&self) -> Result<(), MeshError> {
        positive(
            PRESET,
            &[
                ("width_mm", self.width_mm),
                ("height_mm", self.height_mm),
                ("electrodes_per_width", self.electrodes_per_width as f64),
                ("electrodes_per_height", self.electrodes_per_height as f64),
                ("void_mm", self.void_mm),
                ("inset_mm", self.inset_mm),
                ("region_half_width_mm", self.region_half_width_mm),
                ("region_half_height_mm", self.region_half_height_mm),
                ("fineness", self.fineness),
                ("edge_mm", self.edge_mm),
                ("largest_mm", self.largest_mm),
                ("growth", self.growth),
                ("sheet_ohm", self.sheet_ohm),
                ("contact_ohm", self.contact_ohm),
            ],
        )?;
        let refuse = |fault| Err(refused(PRESET, fault));
        within(PRESET, "fineness", self.fineness, FINENESS)?;
        let side = self.width_mm.min(self.height_mm);
        let longer = self.width_mm.max(self.height_mm);
        // edge lengths are limited by the shorter side, so the number of triangles of a long strip would have no limit
        if longer > LONGEST_SHARE * side {
            return refuse(format!(
                "width_mm is {} and height_mm {}, one may be at most {LONGEST_SHARE} times the other",
                self.width_mm, self.height_mm
            ));
        }
        within(
            PRESET,
            "edge_mm",
            self.edge_mm,
            [0.02 * self.void_mm, 0.5 * side],
        )?;
        within(
            PRESET,
            "largest_mm",
            self.largest_mm,
            [0.005 * side, 0.5 * side],
        )?;
        if self.electrode == SheetElectrode::Void && self.inset_mm <= 0.5 * self.void_mm {
            return refuse(
                "inset_mm must exceed half of void_mm, otherwise the voids reach the edge".into(),
            );
        }
        let centres = self.centres_mm();
        for (k, a) in centres.iter().enumerate() {
            for b in &centres[..k] {
                if (a[0] - b[0]).abs().max((a[1] - b[1]).abs()) <= self.void_mm {
                    return refuse(format!(
                        "void_mm is {}, two electrodes would meet: make it smaller",
                        self.void_mm
                    ));
                }
            }
        }
        Ok(())
    }

    /// Edges along half of a void's side: the whole side has twice as many, so that an axis of symmetry can cut it.
    fn half_side_edges(&self) -> usize {
        ((0.5 * self.void_mm * self.fineness / self.edge_mm).round() as usize).max(1)
    }

    /// Nodes and triangles of the lower left quarter, mm.
    fn quarter(&self) -> Result<crate::mesh::generation::Filled, MeshError> {
        let high = [0.5 * self.width_mm, 0.5 * self.height_mm];
        let half = 0.5 * self.void_mm;
        let on_edge = self.electrode == SheetElectrode::Edge;
        // extent of an electrode along x and y
        let reach = |c: &[f64; 2]| match on_edge {
            false => [half, half],
            true if c[1] == 0.0 => [half, 0.0],
            true => [0.0, half],
        };
        let voids: Vec<[f64; 2]> = self
            .centres_mm()
            .into_iter()
            .filter(|c| c[0] - half < high[0] && c[1] - half < high[1])
            .collect();
        let from_void = |p: [f64; 2]| {
            voids
                .iter()
                .map(|c| {
                    let reach = reach(c);
                    let outside = |axis: usize| ((p[axis] - c[axis]).abs() - reach[axis]).max(0.0);
                    length(outside(0), outside(1))
                })
                .fold(f64::INFINITY, f64::min)
        };
        let at_void = half / self.half_side_edges() as f64;
        let far = (self.largest_mm / self.fineness).max(at_void);
        let size = |p: [f64; 2]| (at_void + self.growth / self.fineness * from_void(p)).min(far);
        let inside = |p: [f64; 2]| {
            p[0] > 0.0 && p[1] > 0.0 && p[0] < high[0] && p[1] < high[1] && from_void(p) > 0.0
        };
        let mut rim = Rim::default();
        for c in &voids {
            let [rx, ry] = reach(c);
            let [x0, x1] = [c[0] - rx, c[0] + rx];
            let [y0, y1] = [c[1] - ry, c[1] + ry];
            let sides = [
                [[x0, y0], [x1, y0]],
                [[x1, y0], [x1, y1]],
                [[x1, y1], [x0, y1]],
                [[x0, y1], [x0, y0]],
            ];
            // without width only one side remains: the bottom, or the right side (which is also the left)
            let sides = match (on_edge, c[1] == 0.0) {
                (false, _) => &sides[..],
                (true, true) => &sides[..1],
                (true, false) => &sides[1..2],
            };
            for &[a, b] in sides {
                let edges = 2 * self.half_side_edges();
                let at = |k: usize| [0, 1].map(|i| clip(a[i], b[i], k, edges, high[i]));
                for k in 0..edges {
                    let (p, q) = (at(k), at(k + 1));
                    let beyond = |i: usize| p[i].max(q[i]) > high[i];
                    let along = |i: usize| p[i] == high[i] && q[i] == high[i];
                    if !(beyond(0) || beyond(1) || along(0) || along(1)) {
                        rim.edge(p, q);
                    }
                }
            }
        }
        for [a, b] in [
            [[0.0, 0.0], [high[0], 0.0]],
            [[high[0], 0.0], high],
            [high, [0.0, high[1]]],
            [[0.0, high[1]], [0.0, 0.0]],
        ] {
            for [p, q] in uncovered(a, b, &voids, &reach) {
                let mut last = p;
                for next in cut(p, q, &size).into_iter().chain([q]) {
                    rim.edge(last, next);
                    last = next;
                }
            }
        }
        fill(&Domain {
            boundary: rim.points,
            segments: rim.edges,
            inside: &inside,
            size: &size,
            largest: far,
            seeding: self.seeding,
        })
        .map_err(|fault| refused(PRESET, fault))
    }

    fn mirror(&self, quarter: crate::mesh::generation::Filled) -> crate::mesh::generation::Filled {
        let (mut nodes, mut triangles) = quarter;
        for (axis, extent) in [(0, self.width_mm), (1, self.height_mm)] {
            let twin: Vec<usize> = {
                let mut next = nodes.len();
                nodes
                    .iter()
                    .enumerate()
                    .map(|(node, p)| {
                        if p[axis] == 0.5 * extent {
                            node
                        } else {
                            next += 1;
                            next - 1
                        }
                    })
                    .collect()
            };
            for node in 0..twin.len() {
                if twin[node] != node {
                    let mut p = nodes[node];
                    p[axis] = extent - p[axis];
                    nodes.push(p);
                }
            }
            for t in 0..triangles.len() {
                let [a, b, c] = triangles[t].map(|node: usize| twin[node]);
                triangles.push([a, c, b]);
            }
        }
        (nodes, triangles)
    }

    /// Boundary edges on each void's rim, in order round its centre.
    fn electrode_edges(
        &self,
        nodes: &[[f64; 2]],
        triangles: &[[usize; 3]],
        centres: &[[f64; 2]],
    ) -> Vec<Vec<[usize; 2]>> {
        let mut count: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        for &[a, b, c] in triangles {
            for [p, q] in [[a, b], [b, c], [c, a]] {
                *count.entry([p.min(q), p.max(q)]).or_default() += 1;
            }
        }
        let near = 0.5 * self.void_mm * (1.0 + 1e-9);
        let mut edges = vec![Vec::new(); centres.len()];
        for ([a, b], _) in count.into_iter().filter(|(_, count)| *count == 1) {
            let on = |node: usize, c: &[f64; 2]| {
                (nodes[node][0] - c[0])
                    .abs()
                    .max((nodes[node][1] - c[1]).abs())
                    <= near
            };
            if let Some(void) = centres.iter().position(|c| on(a, c) && on(b, c)) {
                edges[void].push([a, b]);
            }
        }
        for (c, edges) in centres.iter().zip(&mut edges) {
            let turn = |[a, b]: [usize; 2]| {
                let middle = [0, 1].map(|i| 0.5 * (nodes[a][i] + nodes[b][i]) - c[i]);
                middle[1].atan2(middle[0])
            };
            edges.sort_by(|a, b| turn(*a).total_cmp(&turn(*b)));
        }
        edges
    }
}

/// The k-th of `edges` points from a to b; a point on the quarter's border is moved there exactly.
fn clip(a: f64, b: f64, k: usize, edges: usize, border: f64) -> f64 {
    let at = if k == edges {
        b
    } else {
        a + (b - a) * k as f64 / edges as f64
    };
    if (at - border).abs() < 1e-9 * border {
        border
    } else {
        at
    }
}

/// The parts of a quarter's side without electrodes.
fn uncovered(
    a: [f64; 2],
    b: [f64; 2],
    electrodes: &[[f64; 2]],
    reach: &dyn Fn(&[f64; 2]) -> [f64; 2],
) -> Vec<[[f64; 2]; 2]> {
    let axis = usize::from(a[0] == b[0]);
    let across = 1 - axis;
    let (low, high) = (a[axis].min(b[axis]), a[axis].max(b[axis]));
    let mut covered: Vec<[f64; 2]> = electrodes
        .iter()
        .map(|c| (c, reach(c)))
        .filter(|(c, reach)| {
            let away = (c[across] - a[across]).abs();
            away < reach[across] || away == 0.0
        })
        .map(|(c, reach)| [c[axis] - reach[axis], c[axis] + reach[axis]])
        .collect();
    covered.sort_by(|p, q| p[0].total_cmp(&q[0]));
    let point = |at: f64| {
        let mut p = a;
        p[axis] = at;
        p
    };
    let mut parts = Vec::new();
    let mut from = low;
    for [start, end] in covered {
        if start > from {
            parts.push([point(from), point(start.min(high))]);
        }
        from = from.max(end);
    }
    if from < high {
        parts.push([point(from), point(high)]);
    }
    parts
}

/// Boundary points without repetition, and the edges between them.
#[derive(Default)]
struct Rim {
    points: Vec<[f64; 2]>,
    edges: Vec<[usize; 2]>,
}

impl Rim {
    fn edge(&mut self, a: [f64; 2], b: [f64; 2]) {
        let edge = [self.point(a), self.point(b)];
        self.edges.push(edge);
    }

    fn point(&mut self, p: [f64; 2]) -> usize {
        let same = |q: &[f64; 2]| (p[0] - q[0]).abs().max((p[1] - q[1]).abs()) < 1e-9;
        self.points.iter().position(same).unwrap_or_else(|| {
            self.points.push(p);
            self.points.len() - 1
        })
    }
}
