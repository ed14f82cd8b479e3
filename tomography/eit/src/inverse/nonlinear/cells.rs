//! The unknowns of the nonlinear problem: single triangles or small cells of the region, and larger cells outside of
//! it.

use std::collections::BTreeMap;

use crate::inverse::prior::Laplacian;
use crate::{Mesh, Parameters};

/// Edge length of the square cells outside of the region, in mean edge lengths of the region's triangles.
const OUTSIDE_EDGE: f64 = 2.5;
/// Edge length of the cells in the region during the first steps of the search, in the same unit.
const INSIDE_EDGE: f64 = 2.0;
/// Number of passes that replace values by the means over their neighbours.
const SMOOTHED: usize = 2;

/// The triangles of a mesh, grouped into cells.
pub(super) struct Cells {
    /// The triangles of each cell.
    pub(super) triangles: Vec<Vec<usize>>,
    /// The cell of each triangle.
    of: Vec<usize>,
    /// Ratio of each cell's area to the mean area of a triangle of the region.
    pub(super) sizes: Vec<f64>,
    /// Neighbouring cells, weighted by the length of their common border, m.
    pub(super) neighbours: Laplacian,
}

impl Cells {
    /// Each triangle of the region is a cell; these cells come first, in the order of the region.
    pub(super) fn fine(mesh: &Mesh) -> Self {
        Self::new(mesh, None)
    }

    /// The region is also divided into cells of several triangles.
    pub(super) fn coarse(mesh: &Mesh) -> Self {
        Self::new(mesh, Some(INSIDE_EDGE))
    }

    /// `inside`: edge length of the region's cells, in mean edge lengths of its triangles; `None`: each triangle is a
    /// cell.
    fn new(mesh: &Mesh, inside: Option<f64>) -> Self {
        let area: f64 = mesh.region_areas().iter().sum();
        let mean = area / mesh.region().len() as f64;
        let mut in_region = vec![false; mesh.triangles().len()];
        let mut order = mesh.region().to_vec();
        for &triangle in mesh.region() {
            in_region[triangle] = true;
        }
        order.extend((0..mesh.triangles().len()).filter(|&triangle| !in_region[triangle]));
        let mut triangles: Vec<Vec<usize>> = Vec::new();
        let mut of = vec![0; mesh.triangles().len()];
        let mut squares = BTreeMap::<(bool, [i64; 2]), usize>::new();
        for triangle in order {
            let edges = match in_region[triangle] {
                true => inside,
                false => Some(OUTSIDE_EDGE),
            };
            let mut next = || {
                triangles.push(Vec::new());
                triangles.len() - 1
            };
            let cell = match edges {
                Some(edges) => {
                    let pitch = edges * mean.sqrt();
                    let place = mesh.centroid(triangle).map(|x| (x / pitch).floor() as i64);
                    *squares
                        .entry((in_region[triangle], place))
                        .or_insert_with(next)
                }
                None => next(),
            };
            of[triangle] = cell;
            triangles[cell].push(triangle);
        }
        let mut borders = BTreeMap::<[usize; 2], f64>::new();
        let all: Vec<usize> = (0..of.len()).collect();
        for (sides, length) in mesh.borders(&all) {
            let [other, cell] = sides.map(|triangle| of[triangle]);
            if cell != other {
                let pair = [cell.min(other), cell.max(other)];
                *borders.entry(pair).or_default() += length;
            }
        }
        let areas: Vec<f64> = triangles
            .iter()
            .map(|members| members.iter().map(|&t| mesh.area(t)).sum())
            .collect();
        let centres = triangles.iter().zip(&areas).map(|(members, area)| {
            [0, 1].map(|axis| {
                let moment = members
                    .iter()
                    .map(|&t| mesh.area(t) * mesh.centroid(t)[axis]);
                moment.sum::<f64>() / area
            })
        });
        let (edges, lengths) = borders.into_iter().unzip();
        Self {
            neighbours: Laplacian::new(centres.collect(), edges, lengths),
            sizes: areas.into_iter().map(|area| area / mean).collect(),
            triangles,
            of,
        }
    }

    /// Transfers values from larger cells to these cells.
    pub(super) fn refined(&self, coarse: &Self, values: &[f64]) -> Vec<f64> {
        let cells = self.triangles.iter();
        cells.map(|members| values[coarse.of[members[0]]]).collect()
    }

    /// Smooths values by means over neighbours.
    pub(super) fn smoothed(&self, values: &[f64]) -> Vec<f64> {
        let mut smooth = values.to_vec();
        for _ in 0..SMOOTHED {
            let mut sums: Vec<[f64; 2]> = smooth.iter().map(|value| [*value, 1.0]).collect();
            for &[a, b] in &self.neighbours.edges {
                for (into, from) in [(a, b), (b, a)] {
                    sums[into][0] += smooth[from];
                    sums[into][1] += 1.0;
                }
            }
            for (value, [sum, count]) in smooth.iter_mut().zip(sums) {
                *value = sum / count;
            }
        }
        smooth
    }

    pub(super) fn count(&self) -> usize {
        self.triangles.len()
    }

    /// The parameters of a sensitivity to the logarithm of each cell's conductance.
    pub(super) fn parameters(&self, mesh: &Mesh) -> Parameters {
        Parameters::cells(mesh, self.triangles.clone()).logarithmic()
    }

    /// The conductance of each triangle for these changes of the logarithm of each cell's conductance.
    pub(super) fn conductances(&self, sigma0: &[f64], change: &[f64]) -> Vec<f64> {
        let mut sigma = sigma0.to_vec();
        for (members, change) in self.triangles.iter().zip(change) {
            let factor = change.exp();
            for &triangle in members {
                sigma[triangle] *= factor;
            }
        }
        sigma
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PaperSheet;

    #[test]
    fn cells_cover_the_sheet_once_and_the_region_first() {
        let sheet = PaperSheet {
            fineness: 0.5,
            ..PaperSheet::default()
        };
        let mesh = sheet.mesh().unwrap();
        let cells = Cells::fine(&mesh);
        let mut all: Vec<usize> = cells.triangles.iter().flatten().copied().collect();
        all.sort_unstable();
        assert_eq!(all, (0..mesh.triangles().len()).collect::<Vec<_>>());
        for (cell, &triangle) in cells.triangles.iter().zip(mesh.region()) {
            assert_eq!(cell, &[triangle]);
        }
        assert!(cells.count() < mesh.triangles().len());
        // the border of one cell with its neighbours is its outline, up to the sheet's edge
        let own: f64 = cells
            .neighbours
            .edges
            .iter()
            .zip(&cells.neighbours.weights)
            .filter(|(edge, _)| edge.contains(&0))
            .map(|(_, length)| length)
            .sum();
        let [a, b, c] = mesh.triangles()[mesh.region()[0]];
        let outline: f64 = [[a, b], [b, c], [c, a]]
            .map(|edge| mesh.edge_length(edge))
            .iter()
            .sum();
        assert!((own - outline).abs() < 1e-12, "{own} {outline}");
    }
}
