//! Groups the triangles of a sheet into square cells, for fields and maps.

use eit::Mesh;
use nalgebra::DMatrix;

/// Side of the cells of fields and maps, m.
pub(crate) const PITCH_M: f64 = 7e-3;

/// Triangles grouped into square cells.
pub(crate) struct Cells {
    /// The cell of each triangle.
    pub(crate) of: Vec<usize>,
    /// The triangles of each cell.
    pub(crate) triangles: Vec<Vec<usize>>,
    pub(crate) centres: Vec<[f64; 2]>,
}

impl Cells {
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let key = |triangle: usize| {
            mesh.centroid(triangle)
                .map(|at| (at / PITCH_M).floor() as i64)
        };
        let keys: std::collections::BTreeMap<[i64; 2], usize> = {
            let all: std::collections::BTreeSet<[i64; 2]> =
                (0..mesh.triangles().len()).map(key).collect();
            all.into_iter().zip(0..).collect()
        };
        let of: Vec<usize> = (0..mesh.triangles().len())
            .map(|triangle| keys[&key(triangle)])
            .collect();
        let mut sums = vec![[0.0; 3]; keys.len()];
        let mut triangles = vec![Vec::new(); keys.len()];
        for (triangle, &cell) in of.iter().enumerate() {
            triangles[cell].push(triangle);
            let (area, centre) = (mesh.area(triangle), mesh.centroid(triangle));
            sums[cell][0] += area * centre[0];
            sums[cell][1] += area * centre[1];
            sums[cell][2] += area;
        }
        let centres = sums.iter().map(|[x, y, area]| [x / area, y / area]);
        Self {
            centres: centres.collect(),
            triangles,
            of,
        }
    }

    /// Whether most of each cell's area is in a region: beside the electrodes, local change is attributed to their
    /// contacts.
    pub(crate) fn within(&self, region: &[usize], mesh: &Mesh) -> Vec<bool> {
        let mut inside = vec![0.0; self.centres.len()];
        for &triangle in region {
            inside[self.of[triangle]] += mesh.area(triangle);
        }
        let areas = self.triangles.iter().map(|triangles| -> f64 {
            triangles.iter().map(|&triangle| mesh.area(triangle)).sum()
        });
        let shares = inside.iter().zip(areas);
        shares.map(|(inside, area)| *inside > 0.5 * area).collect()
    }

    /// Sums the columns of triangles to columns of cells.
    pub(crate) fn sum(&self, sensitivity: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(sensitivity.nrows(), self.centres.len());
        for (column, &cell) in sensitivity.column_iter().zip(&self.of) {
            let mut into = out.column_mut(cell);
            into += column;
        }
        out
    }

    /// Cells within a distance of a position, ascending.
    pub(crate) fn near(&self, place: [f64; 2], reach: f64) -> impl Iterator<Item = usize> + '_ {
        let centres = self.centres.iter().enumerate();
        centres.filter_map(move |(cell, at)| {
            let away = (at[0] - place[0]).hypot(at[1] - place[1]);
            (away < reach).then_some(cell)
        })
    }
}
