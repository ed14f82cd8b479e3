//! The parameters of a sensitivity: triangles, those of the region, or coarser cells; conductance or its logarithm.

use crate::{ForwardError, Mesh, bounding_box};

/// The columns of a sensitivity.
///
/// Triangles of one parameter p change together: by the same conductance, or, for logarithms, by the same factor.
///
/// ```
/// use std::sync::Arc;
/// use eit::{Forward, PaperSheet, Parameters};
/// use survey::Protocol;
/// let sheet = PaperSheet { fineness: 0.5, ..PaperSheet::default() };
/// let mesh = Arc::new(sheet.mesh()?);
/// let forward = Forward::new(mesh.clone(), &sheet.contact_ohm_m())?;
/// let sigma = vec![sheet.conductance(); mesh.triangles().len()];
/// let (cells, centres) = Parameters::grid(&mesh, 0.010);
/// let coarse = forward.sensitivity(&sigma, &Protocol::sheffield(26)?, &cells.logarithmic())?;
/// assert_eq!(coarse.ncols(), centres.len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Parameters {
    columns: Columns,
    logarithmic: bool,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Columns {
    Elements,
    Region,
    /// Cells, for a mesh with this many triangles.
    Cells(usize, Vec<Vec<usize>>),
}

impl Parameters {
    /// Every triangle of the mesh.
    pub fn elements() -> Self {
        Self::of(Columns::Elements)
    }

    /// The triangles of the region of interest, in its order.
    pub fn region() -> Self {
        Self::of(Columns::Region)
    }

    /// The region cut into squares of `pitch` (m): cells that hold the centroid of a triangle, row by row from the lower
    /// left; and the area-weighted centre of each, m.
    ///
    /// A pitch that is not positive gives one cell, the whole region.
    pub fn grid(mesh: &Mesh, pitch: f64) -> (Self, Vec<[f64; 2]>) {
        let centroids = mesh.region_centroids();
        let [low, _] = bounding_box(centroids.iter().copied());
        let place = |p: [f64; 2]| {
            let along = |axis: usize| {
                if pitch > 0.0 {
                    ((p[axis] - low[axis]) / pitch) as usize
                } else {
                    0
                }
            };
            (along(1), along(0))
        };
        let mut cells = std::collections::BTreeMap::<(usize, usize), Vec<usize>>::new();
        for (&t, &p) in mesh.region().iter().zip(&centroids) {
            cells.entry(place(p)).or_default().push(t);
        }
        let cells: Vec<Vec<usize>> = cells.into_values().collect();
        let centre = |cell: &Vec<usize>| {
            let area: f64 = cell.iter().map(|&t| mesh.area(t)).sum();
            [0, 1].map(|axis| {
                cell.iter()
                    .map(|&t| mesh.area(t) * mesh.centroid(t)[axis])
                    .sum::<f64>()
                    / area
            })
        };
        let centres = cells.iter().map(centre).collect();
        let of = mesh.triangles().len();
        (Self::of(Columns::Cells(of, cells)), centres)
    }

    /// Groups of triangles of a mesh.
    pub(crate) fn cells(mesh: &Mesh, cells: Vec<Vec<usize>>) -> Self {
        Self::of(Columns::Cells(mesh.triangles().len(), cells))
    }

    fn of(columns: Columns) -> Self {
        Self {
            columns,
            logarithmic: false,
        }
    }

    /// The same parameters as logarithms of conductance: dV/dln(sigma) = sigma dV/dsigma.
    #[must_use]
    pub fn logarithmic(mut self) -> Self {
        self.logarithmic = true;
        self
    }

    /// The triangles of each column.
    pub(super) fn columns(&self, mesh: &Mesh) -> Result<Vec<Vec<usize>>, ForwardError> {
        let elements = mesh.triangles().len();
        match &self.columns {
            Columns::Elements => Ok((0..elements).map(|t| vec![t]).collect()),
            Columns::Region => Ok(mesh.region().iter().map(|&t| vec![t]).collect()),
            Columns::Cells(has, _) if *has != elements => Err(ForwardError::Cells {
                has: *has,
                wants: elements,
            }),
            Columns::Cells(_, cells) => Ok(cells.clone()),
        }
    }

    /// The factor of each triangle's derivative.
    pub(super) fn scale(&self, sigma: &[f64]) -> Option<Vec<f64>> {
        self.logarithmic.then(|| sigma.to_vec())
    }
}
