//! Derivatives of readings with respect to conductances and contacts, from the fields of neighbouring pairs
//! (reciprocity).

mod parameters;

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use rayon::prelude::*;
use survey::{Dipole, Protocol};

use crate::forward::arc;
use crate::linear_algebra::sparse::{Block, MulAdd, Task, widest};
use crate::{Forward, ForwardError, Mesh};
pub use parameters::Parameters;

/// Columns that one thread takes at a time.
const COLUMNS: usize = 64;
/// Number of f64 values in the widest vectors.
const LANES: usize = 8;

impl Forward {
    /// dV/dsigma of each reading (row) with respect to each triangle (column) at 1 A, V per S:
    /// ∂V/∂σ = -A ∇u·∇w, u the field of the driving pair and w that of the sensing pair at 1 A (fact sheet, section 1).
    /// With a [`Depth`](crate::Depth), the sum over its modes, with κ² u w for the mass term: the change reaches from the
    /// bottom to the surface, or over the layer that the depth states.
    ///
    /// # Errors
    /// Conductances that are refused, or a protocol for another ring.
    pub fn jacobian(
        &self,
        sigma: &[f64],
        protocol: &Protocol,
    ) -> Result<DMatrix<f64>, ForwardError> {
        self.sensitivity(sigma, protocol, &Parameters::elements())
    }

    /// dV/dp of each reading (row) with respect to each parameter (column) at 1 A: V per S, or V if the parameters are
    /// logarithms. See [`Parameters`].
    ///
    /// # Errors
    /// Conductances that are refused, a protocol for another ring, or cells of another mesh.
    pub fn sensitivity(
        &self,
        sigma: &[f64],
        protocol: &Protocol,
        parameters: &Parameters,
    ) -> Result<DMatrix<f64>, ForwardError> {
        let mut jacobian = DMatrix::zeros(0, 0);
        self.sensitivity_into(sigma, protocol, parameters, &mut jacobian)?;
        Ok(jacobian)
    }

    /// [`Forward::sensitivity`] into an existing matrix. If its size is right, no memory is allocated, which would take
    /// longer than the arithmetic.
    ///
    /// # Errors
    /// As [`Forward::sensitivity`]; the matrix is then unchanged.
    pub fn sensitivity_into(
        &self,
        sigma: &[f64],
        protocol: &Protocol,
        parameters: &Parameters,
        jacobian: &mut DMatrix<f64>,
    ) -> Result<(), ForwardError> {
        self.check_ring(protocol)?;
        let fields = self.with_solution(sigma, &self.neighbours(), |solution| {
            self.potentials(&solution)
        })?;
        let planes = self.planes(sigma, &fields)?;
        let mesh = self.mesh();
        let columns = parameters.columns(mesh)?;
        let scale = parameters.scale(sigma);
        let pairs = Pairs::new(protocol);
        let rows = protocol.len();
        if jacobian.shape() != (rows, columns.len()) {
            // not DMatrix::zeros: untouched memory is allocated by the threads that fill it
            *jacobian = DMatrix::from_vec(rows, columns.len(), vec![0.0; rows * columns.len()]);
        }
        if planes.is_some() {
            jacobian.fill(0.0); // a sum over the planes
        }
        let mut fill = |fields: &Block, part: Option<Part<'_>>| {
            jacobian
                .as_mut_slice()
                .par_chunks_mut(rows * COLUMNS)
                .zip(columns.par_chunks(COLUMNS))
                .for_each(|(values, columns)| {
                    widest(Fill {
                        mesh,
                        pairs: &pairs,
                        gradients: Gradients::new(fields, &pairs),
                        scale: scale.as_deref(),
                        part,
                        columns,
                        values,
                    });
                });
        };
        let Some(planes) = planes else {
            fill(&fields, None);
            return self.each_mode(sigma, |mode, fields| {
                let part = Part {
                    share: mode.share(),
                    vertical: fields,
                    decay: mode.decay,
                };
                fill(fields, Some(part));
            });
        };
        for plane in &planes {
            let part = Part {
                share: plane.share,
                vertical: &plane.vertical,
                decay: 1.0,
            };
            fill(&plane.potentials, Some(part));
        }
        Ok(())
    }

    /// dV/dz of each reading (row) with respect to each electrode's contact impedance (column) at 1 A, V per ohm m:
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
        let pairs = Pairs::new(protocol);
        let contacts = self.contact_ohm_m();
        let currents = self.currents(&pairs.dipoles)?;
        self.with_solution(sigma, &currents, |solution| {
            DMatrix::from_fn(protocol.len(), contacts.len(), |reading, electrode| {
                let z = contacts[electrode];
                if z == 0.0 {
                    return 0.0;
                }
                let question = protocol.measurements()[reading];
                let (drive, sense) = (pairs.index[&question.drive], pairs.index[&question.sense]);
                self.drop_product(&solution, electrode, drive, sense) / (z * z)
            })
        })
    }
}

/// Consecutive readings of one driving pair whose sensing pairs are consecutive in the list of pairs.
struct Run {
    reading: usize,
    count: usize,
    drive: usize,
    sense: usize,
}

/// The pairs of a protocol, each once, and the pairs of each reading.
struct Pairs {
    /// Ascending.
    dipoles: Vec<Dipole>,
    index: BTreeMap<Dipole, usize>,
    runs: Vec<Run>,
    electrodes: usize,
}

impl Pairs {
    fn new(protocol: &Protocol) -> Self {
        let questions = protocol.measurements();
        let mut index: BTreeMap<Dipole, usize> = questions
            .iter()
            .flat_map(|question| [(question.drive, 0), (question.sense, 0)])
            .collect();
        for (place, at) in index.values_mut().enumerate() {
            *at = place;
        }
        let mut runs: Vec<Run> = Vec::new();
        for (reading, question) in questions.iter().enumerate() {
            let (drive, sense) = (index[&question.drive], index[&question.sense]);
            match runs.last_mut() {
                Some(run) if run.drive == drive && run.sense + run.count == sense => run.count += 1,
                _ => runs.push(Run {
                    reading,
                    count: 1,
                    drive,
                    sense,
                }),
            }
        }
        Self {
            dipoles: index.keys().copied().collect(),
            index,
            runs,
            electrodes: protocol.electrodes(),
        }
    }
}

/// Gradients of all pairs' fields in one triangle.
struct Gradients<'a> {
    fields: &'a Block,
    /// Gradients of neighbouring pairs, x and y.
    ring: [Vec<f64>; 2],
    /// Neighbouring pairs that sum to each pair, and its sign.
    arcs: Vec<(Vec<usize>, f64)>,
    /// Gradients of each pair, x and y.
    pairs: [Vec<f64>; 2],
    /// Products of one run.
    run: Vec<f64>,
}

/// A mode or a plane of the depth.
#[derive(Clone, Copy)]
struct Part<'a> {
    share: f64,
    /// Derivatives with respect to height, or values proportional to them.
    vertical: &'a Block,
    /// Factor of the products of `vertical`.
    decay: f64,
}

/// Computes some columns of the sensitivity.
struct Fill<'a> {
    mesh: &'a Mesh,
    pairs: &'a Pairs,
    gradients: Gradients<'a>,
    scale: Option<&'a [f64]>,
    /// A part of the depth, whose contribution is added to the values; without a part the values are replaced.
    part: Option<Part<'a>>,
    columns: &'a [Vec<usize>],
    values: &'a mut [f64],
}

impl Task for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: MulAdd>(mut self) {
        let rows = self.values.len() / self.columns.len();
        for (column, elements) in self.values.chunks_exact_mut(rows).zip(self.columns) {
            for (k, &t) in elements.iter().enumerate() {
                let mesh = self.mesh;
                self.gradients.take(mesh.triangles()[t], mesh.corners(t));
                let factor = -mesh.area(t) * self.scale.map_or(1.0, |scale| scale[t]);
                let Some(part) = self.part else {
                    self.gradients
                        .products::<M>(self.pairs, factor, k > 0, column);
                    continue;
                };
                let factor = part.share * factor;
                self.gradients
                    .products::<M>(self.pairs, factor, true, column);
                // the lumped mass term: a third of the triangle at each corner
                let factor = factor * part.decay / 3.0;
                let [a, b, c] = mesh.triangles()[t].map(Some);
                for corners in [[a, b], [c, None]] {
                    self.gradients.take_values(part.vertical, corners);
                    self.gradients
                        .products::<M>(self.pairs, factor, true, column);
                }
            }
        }
    }
}

impl<'a> Gradients<'a> {
    fn new(fields: &'a Block, pairs: &Pairs) -> Self {
        let count = pairs.electrodes;
        let arcs = pairs.dipoles.iter().map(|dipole| {
            let arc = arc(*dipole, count);
            (arc.pairs(count).collect(), arc.sign)
        });
        let longest = pairs.runs.iter().map(|run| run.count).max().unwrap_or(0);
        Self {
            fields,
            ring: [vec![0.0; fields.width], vec![0.0; fields.width]],
            arcs: arcs.collect(),
            pairs: [0, 1].map(|_| vec![0.0; pairs.dipoles.len() + LANES]),
            run: vec![0.0; longest + LANES],
        }
    }

    #[inline(always)]
    fn take(&mut self, nodes: [usize; 3], [a, b, c]: [[f64; 2]; 3]) {
        let (p, q) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        let twice = p[0] * q[1] - p[1] * q[0];
        let (p, q) = (p.map(|p| p / twice), q.map(|q| q / twice));
        let [u, v, w] = nodes.map(|node| self.fields.row(node));
        let [x, y] = &mut self.ring;
        for ((((x, y), u), v), w) in x.iter_mut().zip(y).zip(u).zip(v).zip(w) {
            // from differences along two sides, so that a constant has exactly zero gradient
            let (up, uq) = (v - u, w - u);
            *x = up * q[1] - uq * p[1];
            *y = uq * p[0] - up * q[0];
        }
        self.sum_arcs();
    }

    /// Uses values at two nodes instead of the two gradients; zero for a missing node.
    fn take_values(&mut self, values: &Block, nodes: [Option<usize>; 2]) {
        for (ring, node) in self.ring.iter_mut().zip(nodes) {
            match node {
                Some(node) => ring.copy_from_slice(values.row(node)),
                None => ring.fill(0.0),
            }
        }
        self.sum_arcs();
    }

    #[inline(always)]
    fn sum_arcs(&mut self) {
        for (of, ring) in self.pairs.iter_mut().zip(&self.ring) {
            for (of, (arc, sign)) in of.iter_mut().zip(&self.arcs) {
                *of = sign * arc.iter().map(|&pair| ring[pair]).sum::<f64>();
            }
        }
    }

    /// Writes a column of the sensitivity, or adds to it.
    #[inline(always)]
    fn products<M: MulAdd>(&mut self, pairs: &Pairs, factor: f64, sum: bool, column: &mut [f64]) {
        let [x, y] = &self.pairs;
        for run in &pairs.runs {
            let into = &mut column[run.reading..][..run.count];
            let (gx, gy) = (factor * x[run.drive], factor * y[run.drive]);
            // whole vectors; the last one reads past the run, so the lists are padded
            let whole = run.count.div_ceil(LANES) * LANES;
            let sensed = x[run.sense..][..whole]
                .chunks_exact(LANES)
                .zip(y[run.sense..][..whole].chunks_exact(LANES));
            for (into, (x, y)) in self.run[..whole].chunks_exact_mut(LANES).zip(sensed) {
                for lane in 0..LANES {
                    into[lane] = M::mul_add(gx, x[lane], gy * y[lane]);
                }
            }
            if sum {
                for (into, value) in into.iter_mut().zip(&self.run) {
                    *into += value;
                }
            } else {
                into.copy_from_slice(&self.run[..run.count]);
            }
        }
    }
}
