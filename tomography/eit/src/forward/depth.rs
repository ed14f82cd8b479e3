//! The modes of a tank's depth: for each one a 2-D solution with a mass term (see [`crate::Depth`]).
//!
//! With v the solution of (K(σ) + κ² M(σ)) v = b for the even current b = I ∫ λᵢ / |e| over each electrode, a mode adds
//! share · mean of v over the electrode to its voltage. M is lumped: each corner of a triangle has a third of σ A, so that
//! the matrix stays an M-matrix at any κ. No mode has a null space; the solutions are not refined.

use nalgebra::DMatrix;

use super::layout::NONE;
use super::scratch::{Scratch, refusal};
use super::{Forward, ForwardError};
use crate::linear_algebra::sparse::{Block, gram};
use crate::mesh::Mode;

/// Data of the modes that depend on the mesh only.
pub(super) struct Modes {
    driven: Vec<Mode>,
    /// Matrix entry of each unknown's diagonal.
    diagonal: Vec<usize>,
}

impl Modes {
    pub(super) fn new(forward: &Forward) -> Option<Self> {
        let driven = forward.mesh.depth()?.driven();
        let entry = |unknown: usize| {
            forward
                .layout
                .analysis
                .entry(unknown, unknown)
                .expect("the diagonal is always in the pattern")
        };
        (!driven.is_empty()).then(|| Self {
            driven,
            diagonal: (0..forward.layout.unknown.len()).map(entry).collect(),
        })
    }
}

impl Forward {
    /// Electrode voltages that the modes add: a column per column of currents, mean zero; `None` without modes.
    pub(super) fn depth_voltages(
        &self,
        sigma: &[f64],
        currents: &DMatrix<f64>,
    ) -> Result<Option<DMatrix<f64>>, ForwardError> {
        if self.modes.is_none() {
            return Ok(None);
        }
        let impedance = self.borrow_scratch(|scratch| scratch.depth_impedance(self, sigma))?;
        Ok(impedance.map(|impedance| {
            let mut voltages = impedance * currents;
            for mut column in voltages.column_iter_mut() {
                let mean = column.mean();
                column.add_scalar_mut(-mean);
            }
            voltages
        }))
    }

    /// Computes the potentials of each mode for 1 A through each pair of neighbours, in the layout of
    /// [`Forward::potentials`], and passes them to `read` with the mode.
    pub(crate) fn each_mode(
        &self,
        sigma: &[f64],
        mut read: impl FnMut(Mode, &Block),
    ) -> Result<(), ForwardError> {
        let Some(modes) = &self.modes else {
            return Ok(());
        };
        let currents = self.neighbours();
        self.borrow_scratch(|scratch| {
            let sigma = &self.admit(sigma)?.sigma;
            scratch.system.set(self, sigma);
            let mut potentials = Block::zeros(self.mesh.nodes().len(), currents.ncols());
            for &mode in &modes.driven {
                scratch.factor_mode(self, modes, sigma, mode)?;
                scratch.mode_right_side(self, &currents);
                scratch
                    .factor
                    .solve(&self.layout.analysis, None, &mut scratch.x);
                let rows = potentials.values.chunks_exact_mut(potentials.width);
                for (&unknown, row) in self.layout.unknown.iter().zip(rows) {
                    row.copy_from_slice(scratch.x.row(unknown));
                }
                read(mode, &potentials);
            }
            Ok(())
        })
    }
}

/// The field of neighbouring pairs at one height of the layer.
pub(crate) struct Plane {
    /// Share of the depth represented by the plane.
    pub(crate) share: f64,
    /// Potentials: a row per node, a column per pair.
    pub(crate) potentials: Block,
    /// Their derivatives with the height, V/m.
    pub(crate) vertical: Block,
}

impl Forward {
    /// The fields at the heights of the layer that changes fill, from their mean over the depth; `None` without a
    /// layer.
    pub(crate) fn planes(
        &self,
        sigma: &[f64],
        mean: &Block,
    ) -> Result<Option<Vec<Plane>>, ForwardError> {
        let Some(points) = self.mesh.depth().and_then(|depth| depth.planes()) else {
            return Ok(None);
        };
        let mut planes: Vec<Plane> = points
            .iter()
            .map(|[_, share]| Plane {
                share: *share,
                potentials: mean.clone(),
                vertical: Block {
                    values: vec![0.0; mean.values.len()],
                    width: mean.width,
                },
            })
            .collect();
        self.each_mode(sigma, |mode, fields| {
            let wave = mode.decay.sqrt();
            for (plane, [z, _]) in planes.iter_mut().zip(&points) {
                let along = 2.0 * mode.weight * (wave * z).cos();
                let up = -2.0 * mode.weight * wave * (wave * z).sin();
                let into = plane.potentials.values.iter_mut();
                for ((u, v), field) in into.zip(&mut plane.vertical.values).zip(&fields.values) {
                    *u += along * field;
                    *v += up * field;
                }
            }
        })?;
        Ok(Some(planes))
    }

    /// Refuses a mesh with a layer: solutions for changed conductances describe changes over the whole depth.
    ///
    /// # Errors
    /// [`ForwardError::Layer`].
    pub fn check_changes(&self) -> Result<(), ForwardError> {
        match self.mesh.depth() {
            Some(depth) if depth.has_layer() => Err(ForwardError::Layer {
                height_mm: 1e3 * depth.target_height_m(),
            }),
            _ => Ok(()),
        }
    }
}

impl Scratch {
    /// Impedance that the modes add: voltage of each electrode (row) for 1 A into each electrode (column), ohm,
    /// symmetric; `None` without modes.
    pub(super) fn depth_impedance(
        &mut self,
        forward: &Forward,
        sigma: &[f64],
    ) -> Result<Option<DMatrix<f64>>, ForwardError> {
        let Some(modes) = &forward.modes else {
            return Ok(None);
        };
        let sigma = &forward.admit(sigma)?.sigma;
        let count = forward.layout.electrodes.len();
        let currents = DMatrix::identity(count, count);
        let mut sum = DMatrix::zeros(count, count);
        self.system.set(forward, sigma);
        for &mode in &modes.driven {
            self.factor_mode(forward, modes, sigma, mode)?;
            self.mode_right_side(forward, &currents);
            self.factor
                .halve(&forward.layout.analysis, None, &mut self.x);
            let products = gram(&self.x, &self.x, count);
            sum += mode.share() * DMatrix::from_vec(count, count, products);
        }
        // the products of two columns may differ in the last bit
        Ok(Some(DMatrix::from_fn(count, count, |i, j| {
            0.5 * (sum[(i, j)] + sum[(j, i)])
        })))
    }

    /// Factors the matrix of a mode for the system's conductance.
    fn factor_mode(
        &mut self,
        forward: &Forward,
        modes: &Modes,
        sigma: &[f64],
        mode: Mode,
    ) -> Result<(), ForwardError> {
        self.system.assemble_mode(forward);
        let values = &mut self.system.values;
        for (t, corners) in forward.mesh.triangles().iter().enumerate() {
            let mass = mode.decay * sigma[t] * forward.mesh.area(t) / 3.0;
            for &node in corners {
                values[modes.diagonal[forward.layout.unknown[node]]] += mass;
            }
        }
        let nodes = forward.mesh.nodes().len();
        for &electrode in &forward.layout.unknown[nodes..] {
            values[modes.diagonal[electrode]] = 1.0;
        }
        self.factor
            .make(&forward.layout.analysis, &self.system.values)
            .map_err(|fault| refusal(forward, fault, sigma))
    }

    /// Currents (A) into the electrodes (rows), spread evenly over each, a column per pattern.
    fn mode_right_side(&mut self, forward: &Forward, currents: &DMatrix<f64>) {
        self.fit(forward, currents.ncols());
        self.x.values.fill(0.0);
        for (e, contact) in forward.layout.electrodes.iter().enumerate() {
            for (&node, weight) in contact.nodes.iter().zip(&contact.weights) {
                let row = self.x.row_mut(forward.layout.unknown[node]);
                for (into, current) in row.iter_mut().zip(currents.row(e).iter()) {
                    *into = current * weight / contact.length;
                }
            }
        }
    }
}

impl super::system::System {
    /// The resistors of the sheet between nodes, without contacts and ground.
    fn assemble_mode(&mut self, forward: &Forward) {
        let (plain, special) = self.weights.split_at(forward.layout.edges.len());
        let values = &mut self.values;
        values.clear();
        values.resize(forward.layout.analysis.entries(), 0.0);
        for (edge, &w) in forward.layout.edges.iter().zip(plain) {
            let [a, b, ab] = edge.at;
            values[a as usize] += w;
            values[b as usize] += w;
            values[ab as usize] = -w;
        }
        for (edge, &w) in forward.layout.special.iter().zip(special) {
            // the slots of the two nodes are the first and the third, and always have entries
            let [a, b, ab, ..] = edge.at;
            debug_assert!(a != NONE && b != NONE && ab != NONE);
            values[a] += w;
            values[b] += w;
            values[ab] -= w;
        }
    }
}
