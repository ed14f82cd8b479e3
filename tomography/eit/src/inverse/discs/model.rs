//! Readings of a sheet with a given map, and their derivatives.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::forward::Base;
use crate::linear_algebra::sparse::Block;
use crate::{Forward, ForwardError, Mesh, Parameters};
use nalgebra::DMatrix;
use survey::{Dipole, Protocol};

/// The forward model of a sheet with a map on its region.
pub(crate) struct SheetModel {
    forward: Forward,
    protocol: Protocol,
    pub(crate) mesh: Arc<Mesh>,
    sigma0: Vec<f64>,
    /// The factor of that conductance.
    base: Base,
    dipoles: Vec<Dipole>,
    /// 1 A through each dipole.
    patterns: DMatrix<f64>,
    /// Drive and sense of each reading among the dipoles.
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
    /// `currents`: of each reading, A; `sigma0`: S per square, one per triangle.
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

    /// Derivative of the readings along directions in the space of maps: one column per direction. `directions[e]`
    /// lists (direction, d map_e) for triangle e.
    pub(crate) fn along(
        &self,
        solved: &Solved,
        directions: &BTreeMap<u32, Vec<(usize, f64)>>,
        count: usize,
    ) -> Result<DMatrix<f64>, ForwardError> {
        if self.mesh.depth().is_some() {
            return self.along_in_depth(solved, directions, count);
        }
        let m = self.dipoles.len();
        // lower triangle of the m x m products for each direction
        let mut sums = vec![0.0; count * m * m];
        let mut gx = vec![0.0; m];
        let mut gy = vec![0.0; m];
        let mut product = vec![0.0; m * m];
        for (&e, list) in directions {
            let t = self.mesh.region()[e as usize];
            let nodes = self.mesh.triangles()[t];
            let g = &self.gradients[e as usize];
            let size = -self.mesh.area(t) * self.sigma0[t];
            let [a, b, c] = nodes.map(|node| solved.potentials.row(node));
            for k in 0..m {
                let u = [a[k], b[k], c[k]];
                gx[k] = g[0][0] * u[0] + g[1][0] * u[1] + g[2][0] * u[2];
                gy[k] = g[0][1] * u[0] + g[1][1] * u[1] + g[2][1] * u[2];
            }
            for i in 0..m {
                let (x, y) = (size * gx[i], size * gy[i]);
                let row = &mut product[i * m..(i + 1) * m];
                for j in 0..=i {
                    row[j] = x * gx[j] + y * gy[j];
                }
            }
            for &(direction, amount) in list {
                let sum = &mut sums[direction * m * m..(direction + 1) * m * m];
                for (s, p) in sum.iter_mut().zip(&product) {
                    *s += amount * p;
                }
            }
        }
        Ok(DMatrix::from_fn(
            self.questions.len(),
            count,
            |reading, direction| {
                let (a, b) = self.questions[reading];
                let (a, b) = (a.max(b), a.min(b));
                self.currents[reading] * sums[direction * m * m + a * m + b]
            },
        ))
    }

    /// The same in a tank with a depth, from the sensitivity of all triangles.
    fn along_in_depth(
        &self,
        solved: &Solved,
        directions: &BTreeMap<u32, Vec<(usize, f64)>>,
        count: usize,
    ) -> Result<DMatrix<f64>, ForwardError> {
        let sensitivity =
            self.forward
                .sensitivity(&solved.sigma, &self.protocol, &Parameters::region())?;
        let mut along = DMatrix::zeros(self.questions.len(), count);
        for (&e, list) in directions {
            let sigma0 = self.sigma0[self.mesh.region()[e as usize]];
            for &(direction, amount) in list {
                along.column_mut(direction).axpy(
                    amount * sigma0,
                    &sensitivity.column(e as usize),
                    1.0,
                );
            }
        }
        for (mut row, current) in along.row_iter_mut().zip(&self.currents) {
            row *= *current;
        }
        Ok(along)
    }
}
