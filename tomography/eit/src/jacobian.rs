//! How readings change with conductances and contacts, from the drive fields alone (reciprocity).

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use survey::{Dipole, Protocol};

use crate::{Forward, ForwardError};

impl Forward {
    /// dV/dsigma of each reading (row) by each triangle (column) at 1 A, V per S:
    /// ∂V/∂σ = -A ∇u·∇w, u the field of the driving pair and w that of the sensing pair at 1 A.
    ///
    /// # Errors
    /// Conductances that are refused, or a protocol for another ring.
    pub fn jacobian(
        &self,
        sigma: &[f64],
        protocol: &Protocol,
    ) -> Result<DMatrix<f64>, ForwardError> {
        self.check_ring(protocol)?;
        let (dipoles, index) = distinct(protocol);
        let solution = self.solution(sigma, &dipoles)?;
        let fields: Vec<Vec<f64>> = (0..dipoles.len())
            .map(|column| self.potential(&solution, column))
            .collect();
        let pairs: Vec<[usize; 2]> = protocol
            .measurements()
            .iter()
            .map(|question| [index[&question.drive], index[&question.sense]])
            .collect();
        let mesh = self.mesh();
        let mut jacobian = DMatrix::zeros(protocol.len(), mesh.triangles().len());
        let mut gradients = vec![[0.0; 2]; dipoles.len()];
        for (t, mut column) in jacobian.column_iter_mut().enumerate() {
            let triangle = mesh.triangles()[t];
            let [a, b, c] = mesh.corners(t);
            let (p, q) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
            let twice = 2.0 * mesh.area(t);
            for (gradient, u) in gradients.iter_mut().zip(&fields) {
                // of differences along two sides, so that a constant has exactly no gradient
                let up = u[triangle[1]] - u[triangle[0]];
                let uq = u[triangle[2]] - u[triangle[0]];
                *gradient = [
                    (up * q[1] - uq * p[1]) / twice,
                    (uq * p[0] - up * q[0]) / twice,
                ];
            }
            for (value, &[drive, sense]) in column.iter_mut().zip(&pairs) {
                let (u, w) = (gradients[drive], gradients[sense]);
                *value = -mesh.area(t) * (u[0] * w[0] + u[1] * w[1]);
            }
        }
        Ok(jacobian)
    }

    /// dV/dz of each reading (row) by each electrode's contact impedance (column) at 1 A, V per ohm m:
    /// ∂V/∂z = 1/z² ∫ (U - u)(W - w). Zero where z is zero.
    ///
    /// # Errors
    /// Conductances that are refused, or a protocol for another ring.
    pub fn contact_jacobian(
        &self,
        sigma: &[f64],
        protocol: &Protocol,
    ) -> Result<DMatrix<f64>, ForwardError> {
        self.check_ring(protocol)?;
        let (dipoles, index) = distinct(protocol);
        let solution = self.solution(sigma, &dipoles)?;
        let contacts = self.contact_ohm_m();
        Ok(DMatrix::from_fn(
            protocol.len(),
            contacts.len(),
            |reading, electrode| {
                let z = contacts[electrode];
                if z == 0.0 {
                    return 0.0;
                }
                let question = protocol.measurements()[reading];
                let (drive, sense) = (index[&question.drive], index[&question.sense]);
                self.drop_product(&solution, electrode, drive, sense) / (z * z)
            },
        ))
    }
}

/// Every pair that drives or senses, each once, and where it is.
fn distinct(protocol: &Protocol) -> (Vec<Dipole>, BTreeMap<Dipole, usize>) {
    let mut dipoles = Vec::new();
    let mut index = BTreeMap::new();
    for question in protocol.measurements() {
        for dipole in [question.drive, question.sense] {
            index.entry(dipole).or_insert_with(|| {
                dipoles.push(dipole);
                dipoles.len() - 1
            });
        }
    }
    (dipoles, index)
}
