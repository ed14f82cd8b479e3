//! Readings of a sheet with a given map, and their derivatives.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::forward::Base;
use crate::linear_algebra::dense;
use crate::linear_algebra::sparse::Block;
use crate::{Forward, ForwardError, Mesh, Parameters};
use faer::MatRef;
use nalgebra::DMatrix;
use survey::{Dipole, Protocol};

/// The forward model of a sheet with a map on its region.
pub(crate) struct SheetModel {
    forward: Forward,
    protocol: Protocol,
    pub(crate) mesh: Arc<Mesh>,
    sigma0: Vec<f64>,
    /// The factored matrix of that conductance.
    base: Base,
    dipoles: Vec<Dipole>,
    /// 1 A through each dipole.
    patterns: DMatrix<f64>,
    /// Indices of the driving and the sensing dipole of each reading.
    questions: Vec<(usize, usize)>,
    /// Current of each reading, A.
    currents: Vec<f64>,
    /// Gradients of the three shape functions of each triangle of the region, 1/m.
    gradients: Vec<[[f64; 2]; 3]>,
    pub(crate) baseline: Vec<f64>,
}

/// The solution for a map.
pub(crate) struct Solved {
    /// Change of the readings, V.
    pub(crate) change: Vec<f64>,
    /// A row per node, a column per dipole.
    potentials: Block,
    /// Conductance of each triangle, S per square.
    sigma: Vec<f64>,
}

impl SheetModel {
    /// `currents`: current of each reading, A; `sigma0`: S per square, one per triangle.
    pub(crate) fn new(
        mesh: &Arc<Mesh>,
        contact_ohm_m: &[f64],
        sigma0: &[f64],
        protocol: &Protocol,
        currents: &[f64],
    ) -> Result<Self, ForwardError> {
        let forward = Forward::new(Arc::clone(mesh), contact_ohm_m)?;
        forward.check_changes()?;
        let mut index = BTreeMap::new();
        let mut dipoles = Vec::new();
        for q in protocol.measurements() {
            for dipole in [q.drive, q.sense] {
                index.entry(dipole).or_insert_with(|| {
                    dipoles.push(dipole);
                    dipoles.len() - 1
                });
            }
        }
        let questions: Vec<(usize, usize)> = protocol
            .measurements()
            .iter()
            .map(|q| (index[&q.drive], index[&q.sense]))
            .collect();
        let gradients = mesh
            .region()
            .iter()
            .map(|&t| {
                let [a, b, c] = mesh.corners(t);
                let twice = 2.0 * mesh.area(t);
                let g = |p: [f64; 2], q: [f64; 2]| [(p[1] - q[1]) / twice, (q[0] - p[0]) / twice];
                [g(b, c), g(c, a), g(a, b)]
            })
            .collect();
        let mut model = Self {
            base: forward.factored(sigma0)?,
            patterns: forward.currents(&dipoles)?,
            forward,
            protocol: protocol.clone(),
            mesh: Arc::clone(mesh),
            sigma0: sigma0.to_vec(),
            dipoles,
            questions,
            currents: currents.to_vec(),
            gradients,
            baseline: vec![0.0; currents.len()],
        };
        let outputs = mesh.region().len();
        model.baseline = model.solve(&vec![0.0; outputs])?.change;
        Ok(model)
    }

    fn sigma(&self, map: &[f64]) -> Vec<f64> {
        let mut sigma = self.sigma0.clone();
        for (&t, x) in self.mesh.region().iter().zip(map) {
            sigma[t] *= 1.0 + x;
        }
        sigma
    }

    /// `map`: relative change of each triangle of the region.
    pub(crate) fn solve(&self, map: &[f64]) -> Result<Solved, ForwardError> {
        let sigma = self.sigma(map);
        let (potentials, electrodes) =
            self.forward
                .plain_fields(&sigma, &self.patterns, &self.base)?;
        let change = self
            .questions
            .iter()
            .zip(&self.currents)
            .zip(&self.baseline)
            .map(|((&(drive, sense), current), zero)| {
                let d = self.dipoles[sense];
                current * (electrodes[(d.plus.0, drive)] - electrodes[(d.minus.0, drive)]) - zero
            })
            .collect();
        Ok(Solved {
            change,
            potentials,
            sigma,
        })
    }

    /// Derivatives of the readings along directions in the space of maps: one column per direction. A direction lists
    /// the triangles of the region that it changes, with their changes.
    pub(crate) fn along(
        &self,
        solved: &Solved,
        directions: &[Vec<(u32, f64)>],
    ) -> Result<DMatrix<f64>, ForwardError> {
        let count = directions.len();
        if self.mesh.depth().is_some() {
            return self.along_in_depth(solved, directions);
        }
        let m = self.dipoles.len();
        // x and y components of the gradients in each triangle, computed when first needed
        let mut gradients = vec![Vec::new(); self.gradients.len()];
        let gradient = |e: usize| -> Vec<f64> {
            let t = self.mesh.region()[e];
            let g = &self.gradients[e];
            let [a, b, c] = self.mesh.triangles()[t].map(|node| solved.potentials.row(node));
            let along = |axis: usize| {
                let g = g.map(|g| g[axis]);
                (0..m).map(move |k| g[0] * a[k] + g[1] * b[k] + g[2] * c[k])
            };
            along(0).chain(along(1)).collect()
        };
        let mut along = DMatrix::zeros(self.questions.len(), count);
        for (mut column, direction) in along.column_iter_mut().zip(directions) {
            // two columns per triangle, and the same columns multiplied by area and change
            let (mut plain, mut weighted) = (Vec::new(), Vec::new());
            for &(e, change) in direction {
                let t = self.mesh.region()[e as usize];
                let size = -self.mesh.area(t) * self.sigma0[t] * change;
                let of = &mut gradients[e as usize];
                if of.is_empty() {
                    *of = gradient(e as usize);
                }
                plain.extend_from_slice(of);
                weighted.extend(of.iter().map(|g| size * g));
            }
            let columns = plain.len() / m;
            let plain = MatRef::from_column_major_slice(&plain, m, columns);
            let weighted = MatRef::from_column_major_slice(&weighted, m, columns);
            let products = dense::product(plain, weighted.transpose());
            for ((into, pair), current) in
                column.iter_mut().zip(&self.questions).zip(&self.currents)
            {
                *into = current * products[*pair];
            }
        }
        Ok(along)
    }

    /// The derivatives for a tank with a depth, computed from the sensitivity of all triangles of the region.
    fn along_in_depth(
        &self,
        solved: &Solved,
        directions: &[Vec<(u32, f64)>],
    ) -> Result<DMatrix<f64>, ForwardError> {
        let sensitivity =
            self.forward
                .sensitivity(&solved.sigma, &self.protocol, &Parameters::region())?;
        let mut along = DMatrix::zeros(self.questions.len(), directions.len());
        for (mut column, direction) in along.column_iter_mut().zip(directions) {
            for &(e, change) in direction {
                let sigma0 = self.sigma0[self.mesh.region()[e as usize]];
                column.axpy(change * sigma0, &sensitivity.column(e as usize), 1.0);
            }
        }
        for (mut row, current) in along.row_iter_mut().zip(&self.currents) {
            row *= *current;
        }
        Ok(along)
    }
}
