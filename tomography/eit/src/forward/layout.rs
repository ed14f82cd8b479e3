//! What a mesh asks of its linear system: resistors along edges, contacts, an order of elimination, nodes to ground.

use std::collections::BTreeMap;

use crate::Mesh;
use crate::sparse::dissect;

/// A mesh edge as a resistor of conductance Σ sigma\[t\] c over its triangles.
pub(super) struct Edge {
    pub(super) ends: [usize; 2],
    pub(super) terms: [(usize, f64); 2],
    /// Where its (up to) four unknowns meet: entries of the pattern for each pair of slots a, U(a), b, U(b).
    pub(super) at: [usize; 10],
}

/// No such entry.
pub(super) const NONE: usize = usize::MAX;

/// The pairs of slots in the order of [`Edge::at`].
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

/// What an electrode needs beside its edges.
pub(super) struct Contact {
    pub(super) nodes: Vec<usize>,
    /// ∫ λᵢ, m, one a node.
    pub(super) weights: Vec<f64>,
    pub(super) length: f64,
    /// Mass of its edges: two positions in `nodes` and the edge's length.
    pub(super) edges: Vec<([usize; 2], f64)>,
    /// Entries of the pattern for each pair of its nodes, i <= j, by rows.
    pub(super) at: Vec<usize>,
    /// Triangles at its nodes.
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

/// K(σ)ᵢⱼ = Σ σ A ∇λᵢ·∇λⱼ as conductances -Kᵢⱼ along edges: -∇λᵢ·∇λⱼ A = eᵢ·eⱼ / 4A, both sides leaving the third
/// corner.
pub(super) fn resistors(mesh: &Mesh) -> Vec<Edge> {
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
                    at: [NONE; 10],
                });
        }
    }
    edges.into_values().collect()
}

pub(super) fn contact(mesh: &Mesh, electrode: usize, around: &[Vec<usize>]) -> Contact {
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

/// Numbers the unknowns in the order of elimination: nodes by nested dissection, electrodes last.
pub(super) fn number(mesh: &Mesh, edges: &[Edge], electrodes: &[Contact]) -> Vec<usize> {
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
    for (place, node) in dissect(mesh.nodes(), &neighbours).into_iter().enumerate() {
        unknown[node] = place;
    }
    for (electrode, unknown) in unknown[nodes..].iter_mut().enumerate() {
        *unknown = nodes + electrode;
    }
    unknown
}

/// Nodes not on an electrode, the farthest from all electrodes first.
pub(super) fn grounds(mesh: &Mesh, on: &[Option<usize>]) -> Vec<usize> {
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
