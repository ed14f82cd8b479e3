//! The structure of a mesh's linear system: resistors along edges, contacts, elimination order, candidates for
//! grounding.

use std::collections::BTreeMap;

use super::ForwardError;
use crate::Mesh;
use crate::linear_algebra::sparse::{Analysis, Network, dissect};

/// A mesh edge as a resistor of conductance Σ sigma\[t\] c over its triangles, with no electrode at either end.
pub(super) struct Plain {
    pub(super) triangles: [u32; 2],
    pub(super) shares: [f64; 2],
    /// Entries of the diagonals of its ends, and of the pair.
    pub(super) at: [u32; 3],
}

/// A mesh edge as a resistor with an electrode at one end or both.
pub(super) struct Special {
    pub(super) triangles: [u32; 2],
    pub(super) shares: [f64; 2],
    /// Nodes.
    pub(super) ends: [usize; 2],
    /// Entries for each pair of its (up to) four unknowns, in slots a, U(a), b, U(b).
    pub(super) at: [usize; 10],
}

/// A mesh edge.
struct Edge {
    ends: [usize; 2],
    terms: [(usize, f64); 2],
}

/// The analysis of a mesh, made once.
pub(super) struct Layout {
    /// Mesh edges without an electrode at either end, in elimination order, followed by the others.
    pub(super) edges: Vec<Plain>,
    pub(super) special: Vec<Special>,
    pub(super) network: Network,
    pub(super) electrodes: Vec<Contact>,
    /// Electrode of each node, if any.
    pub(super) on: Vec<Option<usize>>,
    /// Unknown of each node, then of each electrode.
    pub(super) unknown: Vec<usize>,
    pub(super) analysis: Analysis,
    pub(super) grounds: Vec<usize>,
    /// Triangles at each node.
    pub(super) around: Vec<Vec<usize>>,
}

impl Layout {
    pub(super) fn new(mesh: &Mesh) -> Result<Self, ForwardError> {
        let count = mesh.electrodes();
        let nodes = mesh.nodes().len();
        let mut on = vec![None; nodes];
        for (electrode, edges) in mesh.electrode_edges().iter().enumerate() {
            edges
                .iter()
                .flatten()
                .for_each(|&node| on[node] = Some(electrode));
        }
        let mut around = vec![Vec::new(); nodes];
        for (t, triangle) in mesh.triangles().iter().enumerate() {
            triangle.iter().for_each(|&node| around[node].push(t));
        }
        let mut edges = resistors(mesh);
        let mut electrodes: Vec<Contact> = (0..count)
            .map(|electrode| contact(mesh, electrode, &around))
            .collect();
        let (unknown, parts) = number(mesh, &edges, &electrodes);
        let slots = |edge: &Edge| {
            let [a, b] = edge.ends;
            let of = |node: usize| on[node].map_or(NONE, |e: usize| unknown[nodes + e]);
            [unknown[a], of(a), unknown[b], of(b)]
        };
        let pairs = edges.iter().flat_map(|edge| {
            let slots = slots(edge);
            PAIRS
                .map(|[i, j]| [slots[i], slots[j]])
                .into_iter()
                .filter(|[a, b]| *a != NONE && *b != NONE)
        });
        let cliques = electrodes.iter().flat_map(|contact| {
            let nodes = &contact.nodes;
            (0..nodes.len())
                .flat_map(move |i| (i..nodes.len()).map(move |j| [nodes[i], nodes[j]]))
                .map(|[a, b]| [unknown[a], unknown[b]])
        });
        let unknowns = nodes + count;
        let analysis = Analysis::new(&parts, pairs.chain(cliques))
            .map_err(|_| ForwardError::Memory { unknowns })?;
        let entry = |a: usize, b: usize| {
            if a == NONE || b == NONE {
                NONE
            } else {
                analysis
                    .entry(a, b)
                    .expect("every pair of an edge's unknowns was put into the analysis")
            }
        };
        for contact in &mut electrodes {
            let nodes = &contact.nodes;
            contact.at = (0..nodes.len())
                .flat_map(|i| (i..nodes.len()).map(move |j| (i, j)))
                .map(|(i, j)| entry(unknown[nodes[i]], unknown[nodes[j]]))
                .collect();
        }
        let low = |edge: &Edge| {
            let [a, b] = edge.ends.map(|node| unknown[node]);
            [a.min(b), a.max(b)]
        };
        edges.sort_by_key(low);
        let small =
            |index: usize| u32::try_from(index).map_err(|_| ForwardError::Memory { unknowns });
        let mut plain = Vec::new();
        let mut special = Vec::new();
        let mut ends = Vec::new();
        for edge in edges {
            let [(t, c), (s, d)] = edge.terms;
            let (triangles, shares) = ([small(t)?, small(s)?], [c, d]);
            let [a, b] = low(&edge);
            if edge.ends.iter().all(|&node| on[node].is_none()) {
                ends.push([small(a)?, small(b)?]);
                plain.push(Plain {
                    triangles,
                    shares,
                    at: [
                        small(entry(a, a))?,
                        small(entry(b, b))?,
                        small(entry(a, b))?,
                    ],
                });
            } else {
                let slots = slots(&edge);
                special.push(Special {
                    triangles,
                    shares,
                    ends: edge.ends,
                    at: PAIRS.map(|[i, j]| entry(slots[i], slots[j])),
                });
            }
        }
        Ok(Self {
            edges: plain,
            special,
            network: Network::new(unknowns, &ends),
            electrodes,
            grounds: grounds(mesh, &on),
            on,
            unknown,
            analysis,
            around,
        })
    }
}

/// Marks an absent entry.
pub(super) const NONE: usize = usize::MAX;

/// The pairs of slots in the order of [`Special::at`].
pub(super) const PAIRS: [[usize; 2]; 10] = [
    [0, 0],
    [2, 2],
    [0, 2],
    [1, 1],
    [3, 3],
    [0, 1],
    [0, 3],
    [1, 2],
    [2, 3],
    [1, 3],
];

/// The data of an electrode that do not belong to its edges in the mesh.
pub(super) struct Contact {
    pub(super) nodes: Vec<usize>,
    /// ∫ λᵢ, m, one per node.
    pub(super) weights: Vec<f64>,
    pub(super) length: f64,
    /// Mass of its edges: two positions in `nodes` and the edge's length.
    pub(super) edges: Vec<([usize; 2], f64)>,
    /// Entries of the pattern for each pair of its nodes, i <= j, row by row.
    pub(super) at: Vec<usize>,
    /// Triangles that touch its nodes.
    pub(super) triangles: Vec<usize>,
}
impl Contact {
    /// Mean over the electrode of a function given at its nodes.
    pub(super) fn mean(&self, at: impl Fn(usize) -> f64) -> f64 {
        // relative to one node, so that a constant has exactly itself as mean
        let base = at(self.nodes[0]);
        let sum: f64 = self
            .nodes
            .iter()
            .zip(&self.weights)
            .map(|(&node, weight)| weight * (at(node) - base))
            .sum();
        base + sum / self.length
    }

    /// ∫ f g over the electrode.
    pub(super) fn mass(&self, f: impl Fn(usize) -> f64, g: impl Fn(usize) -> f64) -> f64 {
        self.edges
            .iter()
            .map(|&([i, j], h)| {
                let (i, j) = (self.nodes[i], self.nodes[j]);
                h / 6.0 * (2.0 * f(i) * g(i) + f(i) * g(j) + f(j) * g(i) + 2.0 * f(j) * g(j))
            })
            .sum()
    }
}

/// K(σ)ᵢⱼ = Σ σ A ∇λᵢ·∇λⱼ as conductances -Kᵢⱼ along edges: -∇λᵢ·∇λⱼ A = eᵢ·eⱼ / 4A, eᵢ and eⱼ the sides from the third
/// corner.
fn resistors(mesh: &Mesh) -> Vec<Edge> {
    let mut edges: BTreeMap<[usize; 2], Edge> = BTreeMap::new();
    for (t, triangle) in mesh.triangles().iter().enumerate() {
        let corners = mesh.corners(t);
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            let from = |c: usize| [0, 1].map(|x| corners[c][x] - corners[k][x]);
            let (p, q) = (from(i), from(j));
            let c = (p[0] * q[0] + p[1] * q[1]) / (4.0 * mesh.area(t));
            let ends = [triangle[i].min(triangle[j]), triangle[i].max(triangle[j])];
            edges
                .entry(ends)
                .and_modify(|edge| edge.terms[1] = (t, c))
                .or_insert(Edge {
                    ends,
                    terms: [(t, c), (t, 0.0)],
                });
        }
    }
    edges.into_values().collect()
}

fn contact(mesh: &Mesh, electrode: usize, around: &[Vec<usize>]) -> Contact {
    let mut nodes: Vec<usize> = mesh.electrode_edges()[electrode]
        .iter()
        .flatten()
        .copied()
        .collect();
    nodes.sort_unstable();
    nodes.dedup();
    let mut weights = vec![0.0; nodes.len()];
    let mut edges = Vec::new();
    for edge in &mesh.electrode_edges()[electrode] {
        let h = mesh.edge_length(*edge);
        let ends = edge.map(|node| {
            nodes
                .binary_search(&node)
                .expect("the electrode's nodes are those of its edges")
        });
        ends.iter().for_each(|&end| weights[end] += 0.5 * h);
        edges.push((ends, h));
    }
    let mut triangles: Vec<usize> = nodes
        .iter()
        .flat_map(|&n| around[n].iter().copied())
        .collect();
    triangles.sort_unstable();
    triangles.dedup();
    Contact {
        weights,
        length: mesh.electrode_length(electrode),
        edges,
        at: Vec::new(),
        triangles,
        nodes,
    }
}

/// Numbers the unknowns in elimination order: nodes by nested dissection, then electrodes. Also returns the lengths of
/// the parts that are eliminated together.
fn number(mesh: &Mesh, edges: &[Edge], electrodes: &[Contact]) -> (Vec<usize>, Vec<usize>) {
    let nodes = mesh.nodes().len();
    let mut neighbours = vec![Vec::new(); nodes];
    for edge in edges {
        let [a, b] = edge.ends;
        neighbours[a].push(b);
        neighbours[b].push(a);
    }
    for contact in electrodes {
        for &a in &contact.nodes {
            neighbours[a].extend(contact.nodes.iter().copied().filter(|&b| b != a));
        }
    }
    let mut unknown = vec![0; nodes + electrodes.len()];
    let (order, mut parts) = dissect(mesh.nodes(), &neighbours);
    parts.push(electrodes.len());
    for (place, node) in order.into_iter().enumerate() {
        unknown[node] = place;
    }
    for (electrode, unknown) in unknown[nodes..].iter_mut().enumerate() {
        *unknown = nodes + electrode;
    }
    (unknown, parts)
}

/// Nodes not on an electrode, in descending distance from all electrodes.
fn grounds(mesh: &Mesh, on: &[Option<usize>]) -> Vec<usize> {
    let centres = mesh.electrode_centres();
    let mut nodes: Vec<(f64, usize)> = (0..mesh.nodes().len())
        .filter(|&node| on[node].is_none())
        .map(|node| {
            let p = mesh.nodes()[node];
            let nearest = centres
                .iter()
                .map(|c| (c[0] - p[0]).powi(2) + (c[1] - p[1]).powi(2))
                .fold(f64::INFINITY, f64::min);
            (nearest, node)
        })
        .collect();
    nodes.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    nodes.into_iter().map(|(_, node)| node).collect()
}
