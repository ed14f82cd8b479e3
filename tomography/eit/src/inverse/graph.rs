//! Unknowns and the edges between them: the triangles of a region and the lengths of their shared borders.

use crate::Mesh;
use crate::inverse::cut::CutGraph;

/// Neighbouring unknowns, and the length of the border between them.
pub(crate) struct Graph {
    pub(crate) unknowns: usize,
    pub(crate) edges: Vec<[usize; 2]>,
    /// Length of each border, m.
    pub(crate) lengths: Vec<f64>,
    pub(crate) cut: CutGraph,
}

impl Graph {
    /// The graph of the mesh's region; an edge needs a triangle of the region on both sides.
    pub(crate) fn of_region(mesh: &Mesh) -> Self {
        let (edges, lengths) = mesh.borders(mesh.region()).into_iter().unzip();
        Self::new(mesh.region().len(), edges, lengths)
    }

    pub(crate) fn new(unknowns: usize, edges: Vec<[usize; 2]>, lengths: Vec<f64>) -> Self {
        Self {
            unknowns,
            cut: CutGraph::new(unknowns, &edges),
            edges,
            lengths,
        }
    }

    /// Connected parts of unknowns, joined across the edges for which `same` holds: the part of each unknown, and the
    /// number of parts. Parts are numbered by their first unknown.
    pub(crate) fn parts(&self, same: impl Fn(usize, usize) -> bool) -> (Vec<usize>, usize) {
        let mut part = vec![usize::MAX; self.unknowns];
        let mut count = 0;
        let mut frontier = Vec::new();
        for seed in 0..self.unknowns {
            if part[seed] != usize::MAX {
                continue;
            }
            part[seed] = count;
            frontier.push(seed);
            while let Some(unknown) = frontier.pop() {
                for other in self.cut.neighbours(unknown) {
                    if part[other] == usize::MAX && same(unknown, other) {
                        part[other] = count;
                        frontier.push(other);
                    }
                }
            }
            count += 1;
        }
        (part, count)
    }
}
