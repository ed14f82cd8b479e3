//! The complete electrode model on linear triangles: voltages from conductances.
//!
//! σ `sigma`: sheet conductance of a triangle, siemens per square; u `u`: potential of a node; U `electrode voltage`;
//! z `contact`: contact impedance, ohm m; M: ∫ λᵢ λⱼ over an electrode's edges; b: ∫ λᵢ; |e|: the electrode's length.
//!
//! The unknowns of an electrode are chosen for its contact (fact sheet, section 1):
//! - z/|e| < Rs: its voltage U and the differences d = u - U on its nodes; z appears only in M/z on d, and U's row is
//!   its balance of currents
//! - otherwise U is eliminated: (M - b bᵀ/|e|)/z on its nodes, and U = (bᵀu + z I)/|e| afterwards
//! - z = 0: d = 0, the electrode is one unknown
//!
//! The sheet itself is written as resistors along mesh edges, so that a constant potential drives exactly nothing; the
//! residuals of the refinement are sums of small currents, not differences of large ones. One mesh node away from the
//! electrodes is grounded. Everything runs in a fixed order on one thread.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use survey::{Dipole, Electrode, Protocol};

use crate::Mesh;
use crate::sparse::{Pattern, Row, SparseError, WIDTH, dissect};

/// A triangle without conductance keeps this share of the largest: it changes voltages by about 1e-9.
pub const FLOOR: f64 = 1e-8;

/// A correction below this share of the solution ends the refinement.
const REFINED: f64 = 1e-11;

/// Corrections before giving up.
const MOST_CORRECTIONS: usize = 12;

/// Why there is no forward solution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ForwardError {
    /// Fewer than two electrodes.
    #[error("the mesh has {electrodes} electrodes; a current needs two")]
    Electrodes {
        /// What the mesh has.
        electrodes: usize,
    },
    /// Wrong number of contact impedances.
    #[error("{has} contact impedances are given for {wants} electrodes")]
    ContactCount {
        /// What was given.
        has: usize,
        /// What the mesh has.
        wants: usize,
    },
    /// A contact impedance that is negative or not a number.
    #[error(
        "electrode {electrode}: contact impedance {value} ohm m must be zero or more, and finite"
    )]
    Contact {
        /// The electrode.
        electrode: Electrode,
        /// What was given.
        value: f64,
    },
    /// Wrong number of conductances.
    #[error("{has} conductances are given for {wants} elements")]
    SigmaCount {
        /// What was given.
        has: usize,
        /// What the mesh has.
        wants: usize,
    },
    /// A conductance that is negative or not a number.
    #[error("element {element}: conductance {value} S must be zero or more, and finite")]
    Sigma {
        /// The element, from 0.
        element: usize,
        /// What was given.
        value: f64,
    },
    /// All conductances are zero.
    #[error("no element conducts")]
    NoConductance,
    /// The protocol is for another ring.
    #[error("the protocol asks for {protocol} electrodes, the mesh has {mesh}")]
    Ring {
        /// What the protocol has.
        protocol: usize,
        /// What the mesh has.
        mesh: usize,
    },
    /// A drive names an electrode that does not exist, or one twice.
    #[error("drive {drive} does not name two of the {electrodes} electrodes")]
    Drive {
        /// The drive.
        drive: Dipole,
        /// What the mesh has.
        electrodes: usize,
    },
    /// The currents of a pattern do not sum to zero.
    #[error(
        "the currents of pattern {pattern} sum to {sum:e} A; what enters the sheet must leave it"
    )]
    CurrentSum {
        /// Column of the currents, from 0.
        pattern: usize,
        /// Their sum, A.
        sum: f64,
    },
    /// Too large for the machine.
    #[error("not enough memory for {unknowns} unknowns")]
    Memory {
        /// Size of the system.
        unknowns: usize,
    },
    /// The factorisation broke down.
    #[error(
        "the system cannot be factored: conductances from {smallest:e} to {largest:e} S are too far apart"
    )]
    NotDefinite {
        /// Smallest conductance, S.
        smallest: f64,
        /// Largest conductance, S.
        largest: f64,
    },
    /// The refinement did not settle.
    #[error(
        "the solution is only known to {achieved:e} of its largest value; conductances are too far apart"
    )]
    NotAccurate {
        /// Last correction relative to the solution.
        achieved: f64,
    },
}

/// Conductances that the model accepts.
#[derive(Debug, Clone, PartialEq)]
pub struct Admitted<'a> {
    /// One a triangle, all positive, S.
    pub sigma: Cow<'a, [f64]>,
    /// Triangles that had no conductance and were given [`FLOOR`] of the largest.
    pub floored: usize,
}

/// Potentials for a set of drives, at the gauge where the mean over the electrodes is zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Fields {
    /// Potential of each node (row) in each drive (column), V at 1 A.
    pub potentials: DMatrix<f64>,
    /// Voltage of each electrode (row) in each drive (column), V at 1 A.
    pub electrodes: DMatrix<f64>,
    /// Triangles that had no conductance, see [`FLOOR`].
    pub floored: usize,
}

/// A mesh with its contacts, analysed once for any conductance.
///
/// ```
/// use std::sync::Arc;
/// use eit::{DiscTank, Forward};
/// use survey::Protocol;
/// let tank = DiscTank::default();
/// let mesh = Arc::new(tank.mesh()?);
/// let forward = Forward::new(mesh.clone(), &tank.contact_ohm_m())?;
/// let sigma = vec![tank.conductance(); mesh.triangles().len()];
/// let readings = forward.readings(&sigma, &Protocol::sheffield(16)?)?;
/// assert!(readings.iter().all(|volts| *volts < 0.0)); // a convex sheet, with this order of the poles
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Forward {
    mesh: Arc<Mesh>,
    contact: Vec<f64>,
    edges: Vec<Edge>,
    electrodes: Vec<Contact>,
    /// Electrode of each node, if any.
    on: Vec<Option<usize>>,
    /// Unknown of each node, then of each electrode.
    unknown: Vec<usize>,
    pattern: Pattern,
    grounds: Vec<usize>,
    /// Triangles at each node, as ranges of one list.
    around: Vec<Vec<usize>>,
}

impl std::fmt::Debug for Forward {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Forward")
            .field("mesh", &self.mesh.hash())
            .field("contact_ohm_m", &self.contact)
            .finish_non_exhaustive()
    }
}

/// A mesh edge as a resistor of conductance Σ sigma\[t\] c over its triangles.
struct Edge {
    ends: [usize; 2],
    terms: [(usize, f64); 2],
    /// Where its (up to) four unknowns meet: entries of the pattern for each pair of slots a, U(a), b, U(b).
    at: [usize; 10],
}

/// No such entry.
const NONE: usize = usize::MAX;

/// The pairs of slots in the order of [`Edge::at`].
const PAIRS: [[usize; 2]; 10] = [
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
struct Contact {
    nodes: Vec<usize>,
    /// ∫ λᵢ, m, one a node.
    weights: Vec<f64>,
    length: f64,
    /// Mass of its edges: two positions in `nodes` and the edge's length.
    edges: Vec<([usize; 2], f64)>,
    /// Entries of the pattern for each pair of its nodes, i <= j, by rows.
    at: Vec<usize>,
    /// Triangles at its nodes.
    triangles: Vec<usize>,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Form {
    Difference,
    Eliminated,
    Shunt,
}

/// Unknowns of some drives as they come from the solver, with what is needed to read them.
pub(crate) struct Solution {
    /// Nodes then electrodes (rows), drives (columns): u or d on nodes, U (0 where eliminated) on electrodes.
    pub(crate) x: DMatrix<f64>,
    forms: Vec<Form>,
    /// Currents into the electrodes (rows) of each drive (column).
    currents: DMatrix<f64>,
    floored: usize,
}

impl Forward {
    /// Analyses a mesh; contact impedance of each electrode in ohm m (contact resistance times its length), zero
    /// allowed.
    ///
    /// # Errors
    /// Fewer than two electrodes, or contact impedances that do not fit.
    pub fn new(mesh: Arc<Mesh>, contact_ohm_m: &[f64]) -> Result<Self, ForwardError> {
        let count = mesh.electrodes();
        if count < 2 {
            return Err(ForwardError::Electrodes { electrodes: count });
        }
        check_contacts(contact_ohm_m, count)?;
        let nodes = mesh.nodes().len();
        let mut on = vec![None; nodes];
        for (electrode, edges) in mesh.electrode_edges().iter().enumerate() {
            edges
                .iter()
                .flatten()
                .for_each(|&node| on[node] = Some(electrode));
        }
        let mut around = vec![Vec::new(); nodes];
        for (t, triangle) in mesh.triangles().iter().enumerate() {
            triangle.iter().for_each(|&node| around[node].push(t));
        }
        let mut edges = resistors(&mesh);
        let mut electrodes: Vec<Contact> = (0..count)
            .map(|electrode| contact(&mesh, electrode, &around))
            .collect();
        let unknown = number(&mesh, &edges, &electrodes);
        let slots = |edge: &Edge| {
            let [a, b] = edge.ends;
            let of = |node: usize| on[node].map_or(NONE, |e: usize| unknown[nodes + e]);
            [unknown[a], of(a), unknown[b], of(b)]
        };
        let pairs = edges.iter().flat_map(|edge| {
            let slots = slots(edge);
            PAIRS
                .map(|[i, j]| [slots[i], slots[j]])
                .into_iter()
                .filter(|[a, b]| *a != NONE && *b != NONE)
        });
        let cliques = electrodes.iter().flat_map(|contact| {
            let nodes = &contact.nodes;
            (0..nodes.len())
                .flat_map(move |i| (i..nodes.len()).map(move |j| [nodes[i], nodes[j]]))
                .map(|[a, b]| [unknown[a], unknown[b]])
        });
        let size = nodes + count;
        let pattern = Pattern::new(size, pairs.chain(cliques))
            .map_err(|_| ForwardError::Memory { unknowns: size })?;
        let entry = |a: usize, b: usize| {
            if a == NONE || b == NONE {
                NONE
            } else {
                pattern
                    .entry(a, b)
                    .expect("every pair of an edge's unknowns was put into the pattern")
            }
        };
        for edge in &mut edges {
            let slots = slots(edge);
            edge.at = PAIRS.map(|[i, j]| entry(slots[i], slots[j]));
        }
        for contact in &mut electrodes {
            let nodes = &contact.nodes;
            contact.at = (0..nodes.len())
                .flat_map(|i| (i..nodes.len()).map(move |j| (i, j)))
                .map(|(i, j)| entry(unknown[nodes[i]], unknown[nodes[j]]))
                .collect();
        }
        let grounds = grounds(&mesh, &on);
        Ok(Self {
            contact: contact_ohm_m.to_vec(),
            edges,
            electrodes,
            on,
            unknown,
            pattern,
            grounds,
            around,
            mesh,
        })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    /// Contact impedance of each electrode, ohm m.
    pub fn contact_ohm_m(&self) -> &[f64] {
        &self.contact
    }

    /// Changes the contact impedances; the analysis stays.
    ///
    /// # Errors
    /// Contact impedances that do not fit.
    pub fn set_contact_ohm_m(&mut self, contact_ohm_m: &[f64]) -> Result<(), ForwardError> {
        check_contacts(contact_ohm_m, self.electrodes.len())?;
        self.contact = contact_ohm_m.to_vec();
        Ok(())
    }

    /// Refuses conductances that are negative or not numbers; gives triangles without any [`FLOOR`] of the largest.
    ///
    /// # Errors
    /// Wrong count, a value that is negative or not a number (element named), or none that conducts.
    pub fn admit<'a>(&self, sigma: &'a [f64]) -> Result<Admitted<'a>, ForwardError> {
        let wants = self.mesh.triangles().len();
        if sigma.len() != wants {
            return Err(ForwardError::SigmaCount {
                has: sigma.len(),
                wants,
            });
        }
        if let Some((element, &value)) = sigma
            .iter()
            .enumerate()
            .find(|(_, value)| !(**value >= 0.0 && value.is_finite()))
        {
            return Err(ForwardError::Sigma { element, value });
        }
        let largest = sigma.iter().copied().fold(0.0, f64::max);
        if largest == 0.0 {
            return Err(ForwardError::NoConductance);
        }
        let floored = sigma.iter().filter(|value| **value == 0.0).count();
        let sigma = if floored == 0 {
            Cow::Borrowed(sigma)
        } else {
            let raise = |value: &f64| {
                if *value == 0.0 {
                    FLOOR * largest
                } else {
                    *value
                }
            };
            Cow::Owned(sigma.iter().map(raise).collect())
        };
        Ok(Admitted { sigma, floored })
    }

    /// Potentials for each drive at 1 A: factored once.
    ///
    /// # Errors
    /// Conductances that are refused, or a drive that does not fit.
    pub fn solve(&self, sigma: &[f64], drives: &[Dipole]) -> Result<Fields, ForwardError> {
        let solution = self.solution(sigma, drives)?;
        Ok(self.fields(&solution))
    }

    /// Potentials for any currents: one row an electrode, one column a pattern, A; each column sums to zero.
    ///
    /// # Errors
    /// Conductances that are refused, or currents that do not fit or do not sum to zero.
    pub fn solve_currents(
        &self,
        sigma: &[f64],
        currents: &DMatrix<f64>,
    ) -> Result<Fields, ForwardError> {
        let solution = self.solution_currents(sigma, currents.clone())?;
        Ok(self.fields(&solution))
    }

    /// The matrix Z with U = Z I for every I that sums to zero: electrodes x electrodes, ohm, symmetric, rows and
    /// columns sum to zero.
    ///
    /// # Errors
    /// Conductances that are refused.
    pub fn transfer_impedance(&self, sigma: &[f64]) -> Result<DMatrix<f64>, ForwardError> {
        let count = self.electrodes.len();
        let share = 1.0 / count as f64;
        let currents = DMatrix::from_fn(
            count,
            count,
            |i, j| if i == j { 1.0 - share } else { -share },
        );
        let solution = self.solution_currents(sigma, currents)?;
        let voltages = self.fields(&solution).electrodes;
        // reciprocity holds to rounding; made exact so that a frame does not depend on which triangle is read
        Ok(DMatrix::from_fn(count, count, |i, j| {
            0.5 * (voltages[(i, j)] + voltages[(j, i)])
        }))
    }

    /// The readings of a protocol at 1 A, V.
    ///
    /// # Errors
    /// Conductances that are refused, or a protocol for another ring.
    pub fn readings(
        &self,
        sigma: &[f64],
        protocol: &Protocol,
    ) -> Result<DVector<f64>, ForwardError> {
        self.check_ring(protocol)?;
        let drives = protocol.drives();
        let solution = self.solution(sigma, &drives)?;
        let column: BTreeMap<Dipole, usize> = drives
            .iter()
            .enumerate()
            .map(|(k, drive)| (*drive, k))
            .collect();
        Ok(DVector::from_iterator(
            protocol.len(),
            protocol.measurements().iter().map(|question| {
                self.voltage_between(&solution, question.sense, column[&question.drive])
            }),
        ))
    }

    pub(crate) fn check_ring(&self, protocol: &Protocol) -> Result<(), ForwardError> {
        let mesh = self.electrodes.len();
        if protocol.electrodes() != mesh {
            return Err(ForwardError::Ring {
                protocol: protocol.electrodes(),
                mesh,
            });
        }
        Ok(())
    }

    pub(crate) fn solution(
        &self,
        sigma: &[f64],
        drives: &[Dipole],
    ) -> Result<Solution, ForwardError> {
        let electrodes = self.electrodes.len();
        let mut currents = DMatrix::zeros(electrodes, drives.len());
        for (column, &drive) in drives.iter().enumerate() {
            if drive.plus.0 >= electrodes
                || drive.minus.0 >= electrodes
                || drive.plus == drive.minus
            {
                return Err(ForwardError::Drive { drive, electrodes });
            }
            currents[(drive.plus.0, column)] = 1.0;
            currents[(drive.minus.0, column)] = -1.0;
        }
        self.solution_currents(sigma, currents)
    }

    fn solution_currents(
        &self,
        sigma: &[f64],
        currents: DMatrix<f64>,
    ) -> Result<Solution, ForwardError> {
        let count = self.electrodes.len();
        if currents.nrows() != count {
            return Err(ForwardError::ContactCount {
                has: currents.nrows(),
                wants: count,
            });
        }
        for (pattern, column) in currents.column_iter().enumerate() {
            let sum: f64 = column.iter().sum();
            let size: f64 = column.iter().map(|current| current.abs()).sum();
            if sum.is_nan() || sum.abs() > 1e-12 * size {
                return Err(ForwardError::CurrentSum { pattern, sum });
            }
        }
        let Admitted { sigma, floored } = self.admit(sigma)?;
        let system = System::new(self, &sigma);
        let values = system.assemble();
        let factor = self.pattern.factor(&values).map_err(|fault| match fault {
            SparseError::Memory => ForwardError::Memory {
                unknowns: self.unknown.len(),
            },
            SparseError::NotDefinite => ForwardError::NotDefinite {
                smallest: sigma.iter().copied().fold(f64::INFINITY, f64::min),
                largest: sigma.iter().copied().fold(0.0, f64::max),
            },
        })?;
        let size = self.unknown.len();
        let mut x = DMatrix::zeros(size, currents.ncols());
        let mut block = vec![[0.0; WIDTH]; size];
        let mut rest = vec![[0.0; WIDTH]; size];
        for first in (0..currents.ncols()).step_by(WIDTH) {
            let width = WIDTH.min(currents.ncols() - first);
            system.right_side(&currents, first, width, &mut block);
            factor.solve(&mut block);
            let mut last = f64::INFINITY;
            for _ in 0..MOST_CORRECTIONS {
                system.right_side(&currents, first, width, &mut rest);
                system.subtract_product(&block, &mut rest);
                factor.solve(&mut rest);
                let largest = |rows: &[Row]| {
                    rows.iter().flatten().fold(0.0_f64, |most, x| {
                        // max would drop a NaN
                        if x.abs() <= most { most } else { x.abs() }
                    })
                };
                let correction = largest(&rest) / largest(&block).max(f64::MIN_POSITIVE);
                for (row, rest) in block.iter_mut().zip(&rest) {
                    row.iter_mut().zip(rest).for_each(|(x, d)| *x += d);
                }
                if correction <= REFINED {
                    last = correction;
                    break;
                }
                if correction.is_nan() || correction >= 0.5 * last {
                    return Err(ForwardError::NotAccurate {
                        achieved: correction,
                    });
                }
                last = correction;
            }
            if last > REFINED {
                return Err(ForwardError::NotAccurate { achieved: last });
            }
            for (node, &unknown) in self.unknown.iter().enumerate() {
                for column in 0..width {
                    x[(node, first + column)] = block[unknown][column];
                }
            }
        }
        Ok(Solution {
            x,
            forms: system.forms,
            currents,
            floored,
        })
    }

    /// An electrode's voltage relative to the ground node, in two parts of which the second (z I / |e|, where the
    /// voltage was eliminated) may be far larger.
    fn voltage(&self, solution: &Solution, electrode: usize, column: usize) -> [f64; 2] {
        match solution.forms[electrode] {
            Form::Difference | Form::Shunt => [
                solution.x[(self.mesh.nodes().len() + electrode, column)],
                0.0,
            ],
            Form::Eliminated => {
                let contact = &self.electrodes[electrode];
                let mean = contact.mean(|node| solution.x[(node, column)]);
                let current = solution.currents[(electrode, column)];
                [mean, self.contact[electrode] * current / contact.length]
            }
        }
    }

    /// U\[plus\] - U\[minus\] of a drive, exact to rounding whatever the contacts of other electrodes.
    pub(crate) fn voltage_between(&self, solution: &Solution, pair: Dipole, column: usize) -> f64 {
        let plus = self.voltage(solution, pair.plus.0, column);
        let minus = self.voltage(solution, pair.minus.0, column);
        (plus[0] - minus[0]) + (plus[1] - minus[1])
    }

    /// Potential of every node of one drive relative to the ground node.
    pub(crate) fn potential(&self, solution: &Solution, column: usize) -> Vec<f64> {
        let nodes = self.mesh.nodes().len();
        (0..nodes)
            .map(|node| {
                let x = solution.x[(node, column)];
                match self.on[node] {
                    Some(e) if solution.forms[e] != Form::Eliminated => {
                        x + solution.x[(nodes + e, column)]
                    }
                    _ => x,
                }
            })
            .collect()
    }

    fn fields(&self, solution: &Solution) -> Fields {
        let nodes = self.mesh.nodes().len();
        let count = self.electrodes.len();
        let columns = solution.x.ncols();
        let mut potentials = DMatrix::zeros(nodes, columns);
        let mut electrodes = DMatrix::zeros(count, columns);
        for column in 0..columns {
            let voltages: Vec<[f64; 2]> = (0..count)
                .map(|e| self.voltage(solution, e, column))
                .collect();
            // the large parts are summed apart: equal contacts cancel exactly
            let mean = [0, 1].map(|part| {
                voltages.iter().map(|voltage| voltage[part]).sum::<f64>() / count as f64
            });
            for (e, voltage) in voltages.iter().enumerate() {
                electrodes[(e, column)] = (voltage[0] - mean[0]) + (voltage[1] - mean[1]);
            }
            for (node, u) in self.potential(solution, column).into_iter().enumerate() {
                potentials[(node, column)] = u - (mean[0] + mean[1]);
            }
        }
        Fields {
            potentials,
            electrodes,
            floored: solution.floored,
        }
    }

    /// ∫ (U - u)(W - w) over an electrode, for two drives.
    pub(crate) fn drop_product(
        &self,
        solution: &Solution,
        electrode: usize,
        a: usize,
        b: usize,
    ) -> f64 {
        let contact = &self.electrodes[electrode];
        match solution.forms[electrode] {
            Form::Shunt => 0.0,
            Form::Difference => {
                contact.mass(|node| solution.x[(node, a)], |node| solution.x[(node, b)])
            }
            Form::Eliminated => {
                let mean = |c: usize| contact.mean(|node| solution.x[(node, c)]);
                let (mean_a, mean_b) = (mean(a), mean(b));
                let drop = |c: usize| {
                    self.contact[electrode] * solution.currents[(electrode, c)] / contact.length
                };
                contact.mass(
                    |node| solution.x[(node, a)] - mean_a,
                    |node| solution.x[(node, b)] - mean_b,
                ) + drop(a) * drop(b) * contact.length
            }
        }
    }
}

impl Contact {
    /// Mean over the electrode of a function given at its nodes.
    fn mean(&self, at: impl Fn(usize) -> f64) -> f64 {
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
    fn mass(&self, f: impl Fn(usize) -> f64, g: impl Fn(usize) -> f64) -> f64 {
        self.edges
            .iter()
            .map(|&([i, j], h)| {
                let (i, j) = (self.nodes[i], self.nodes[j]);
                h / 6.0 * (2.0 * f(i) * g(i) + f(i) * g(j) + f(j) * g(i) + 2.0 * f(j) * g(j))
            })
            .sum()
    }
}

/// One conductance: forms, ground and weights.
struct System<'a> {
    forward: &'a Forward,
    weights: Vec<f64>,
    forms: Vec<Form>,
    /// Unknown that is kept at zero.
    ground: usize,
    /// For each node whether its own unknown takes part (neither grounded nor d = 0).
    free: Vec<bool>,
    /// For each node the unknown of its electrode, where that takes part.
    joined: Vec<usize>,
}

impl<'a> System<'a> {
    fn new(forward: &'a Forward, sigma: &[f64]) -> Self {
        let nodes = forward.mesh.nodes().len();
        let weights = forward
            .edges
            .iter()
            .map(|edge| edge.terms.iter().map(|(t, c)| sigma[*t] * c).sum())
            .collect();
        let forms: Vec<Form> = forward
            .electrodes
            .iter()
            .zip(&forward.contact)
            .map(|(contact, &z)| {
                let mean = contact.triangles.iter().map(|&t| sigma[t]).sum::<f64>()
                    / contact.triangles.len() as f64;
                if z == 0.0 {
                    Form::Shunt
                } else if z / contact.length < 1.0 / mean {
                    Form::Difference
                } else {
                    Form::Eliminated
                }
            })
            .collect();
        let ground_node = forward.ground(sigma);
        let electrode_ground = |e: usize| match forms[e] {
            Form::Eliminated => forward.unknown[forward.electrodes[e].nodes[0]],
            Form::Difference | Form::Shunt => forward.unknown[nodes + e],
        };
        let ground = ground_node.map_or_else(|| electrode_ground(0), |node| forward.unknown[node]);
        let free = (0..nodes)
            .map(|node| {
                forward.unknown[node] != ground
                    && forward.on[node].is_none_or(|e| forms[e] != Form::Shunt)
            })
            .collect();
        let joined = (0..nodes)
            .map(|node| match forward.on[node] {
                Some(e) if forms[e] != Form::Eliminated => {
                    let unknown = forward.unknown[nodes + e];
                    if unknown == ground { NONE } else { unknown }
                }
                _ => NONE,
            })
            .collect();
        Self {
            forward,
            weights,
            forms,
            ground,
            free,
            joined,
        }
    }

    fn assemble(&self) -> Vec<f64> {
        let forward = self.forward;
        let nodes = forward.mesh.nodes().len();
        let mut values = vec![0.0; forward.pattern.entries()];
        // K = Σ w g gᵀ with g = a + U(a) - b - U(b)
        for (edge, &w) in forward.edges.iter().zip(&self.weights) {
            let [a, b] = edge.ends;
            let same = self.joined[a] == self.joined[b];
            let sign = [
                f64::from(u8::from(self.free[a])),
                f64::from(u8::from(self.joined[a] != NONE && !same)),
                -f64::from(u8::from(self.free[b])),
                -f64::from(u8::from(self.joined[b] != NONE && !same)),
            ];
            for (&at, [i, j]) in edge.at.iter().zip(PAIRS) {
                if at != NONE {
                    values[at] += w * sign[i] * sign[j];
                }
            }
        }
        let mut one = |unknown: usize| {
            let at = forward
                .pattern
                .entry(unknown, unknown)
                .expect("the diagonal is always in the pattern");
            values[at] = 1.0;
        };
        for (e, contact) in forward.electrodes.iter().enumerate() {
            match self.forms[e] {
                Form::Shunt => contact
                    .nodes
                    .iter()
                    .for_each(|&node| one(forward.unknown[node])),
                Form::Eliminated => one(forward.unknown[nodes + e]),
                Form::Difference => {}
            }
        }
        for (e, contact) in forward.electrodes.iter().enumerate() {
            if self.forms[e] == Form::Shunt {
                continue;
            }
            let z = forward.contact[e];
            let count = contact.nodes.len();
            let free = |i: usize| self.free[contact.nodes[i]];
            // rows of an upper triangle one after the other
            let at = |i: usize, j: usize| {
                let (i, j) = (i.min(j), i.max(j));
                contact.at[i * count - i * (i + 1) / 2 + j]
            };
            for &([i, j], h) in &contact.edges {
                for (i, j, share) in [(i, i, 2.0), (j, j, 2.0), (i, j, 1.0)] {
                    if free(i) && free(j) {
                        values[at(i, j)] += share * h / (6.0 * z);
                    }
                }
            }
            if self.forms[e] == Form::Eliminated {
                for i in (0..count).filter(|&i| free(i)) {
                    for j in (i..count).filter(|&j| free(j)) {
                        values[at(i, j)] -=
                            contact.weights[i] * contact.weights[j] / (z * contact.length);
                    }
                }
            }
        }
        let at = forward
            .pattern
            .entry(self.ground, self.ground)
            .expect("the diagonal is always in the pattern");
        values[at] = 1.0;
        values
    }

    fn right_side(&self, currents: &DMatrix<f64>, first: usize, width: usize, block: &mut [Row]) {
        let forward = self.forward;
        let nodes = forward.mesh.nodes().len();
        block.fill([0.0; WIDTH]);
        for (e, contact) in forward.electrodes.iter().enumerate() {
            for column in 0..width {
                let current = currents[(e, first + column)];
                match self.forms[e] {
                    Form::Difference | Form::Shunt => {
                        block[forward.unknown[nodes + e]][column] = current;
                    }
                    Form::Eliminated => {
                        for (&node, weight) in contact.nodes.iter().zip(&contact.weights) {
                            block[forward.unknown[node]][column] =
                                current * weight / contact.length;
                        }
                    }
                }
            }
        }
        block[self.ground] = [0.0; WIDTH];
    }

    /// rest -= K x, as currents along edges and through contacts.
    fn subtract_product(&self, x: &[Row], rest: &mut [Row]) {
        let forward = self.forward;
        let unknown = &forward.unknown;
        for (edge, &w) in forward.edges.iter().zip(&self.weights) {
            let [a, b] = edge.ends;
            let (xa, xb) = (x[unknown[a]], x[unknown[b]]);
            let mut flow = [0.0; WIDTH];
            let (ja, jb) = (self.joined[a], self.joined[b]);
            if ja == jb {
                for k in 0..WIDTH {
                    flow[k] = w * (xa[k] - xb[k]);
                }
            } else {
                let ua = if ja == NONE { [0.0; WIDTH] } else { x[ja] };
                let ub = if jb == NONE { [0.0; WIDTH] } else { x[jb] };
                for k in 0..WIDTH {
                    flow[k] = w * ((ua[k] - ub[k]) + (xa[k] - xb[k]));
                }
                if ja != NONE {
                    (0..WIDTH).for_each(|k| rest[ja][k] -= flow[k]);
                }
                if jb != NONE {
                    (0..WIDTH).for_each(|k| rest[jb][k] += flow[k]);
                }
            }
            (0..WIDTH).for_each(|k| rest[unknown[a]][k] -= flow[k]);
            (0..WIDTH).for_each(|k| rest[unknown[b]][k] += flow[k]);
        }
        for (e, contact) in forward.electrodes.iter().enumerate() {
            let z = forward.contact[e];
            match self.forms[e] {
                Form::Shunt => {
                    for &node in &contact.nodes {
                        rest[unknown[node]] = [0.0; WIDTH];
                    }
                }
                form => {
                    let mut mean = [0.0; WIDTH];
                    if form == Form::Eliminated {
                        for (k, mean) in mean.iter_mut().enumerate() {
                            *mean = contact.mean(|node| x[unknown[node]][k]);
                        }
                    }
                    for &([i, j], h) in &contact.edges {
                        let (i, j) = (unknown[contact.nodes[i]], unknown[contact.nodes[j]]);
                        for k in 0..WIDTH {
                            let (di, dj) = (x[i][k] - mean[k], x[j][k] - mean[k]);
                            rest[i][k] -= h / (6.0 * z) * (2.0 * di + dj);
                            rest[j][k] -= h / (6.0 * z) * (di + 2.0 * dj);
                        }
                    }
                }
            }
        }
        rest[self.ground] = [0.0; WIDTH];
    }
}

impl Forward {
    /// The node to ground: the farthest from the electrodes that does not lie in an isolated patch.
    fn ground(&self, sigma: &[f64]) -> Option<usize> {
        let mut sorted = sigma.to_vec();
        let middle = sorted.len() / 2;
        let median = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
        self.grounds
            .iter()
            .copied()
            .find(|&node| self.around[node].iter().any(|&t| sigma[t] >= 1e-2 * median))
            .or(self.grounds.first().copied())
    }
}

fn check_contacts(contact_ohm_m: &[f64], wants: usize) -> Result<(), ForwardError> {
    if contact_ohm_m.len() != wants {
        return Err(ForwardError::ContactCount {
            has: contact_ohm_m.len(),
            wants,
        });
    }
    match contact_ohm_m
        .iter()
        .enumerate()
        .find(|(_, z)| !(**z >= 0.0 && z.is_finite()))
    {
        Some((electrode, &value)) => Err(ForwardError::Contact {
            electrode: Electrode(electrode),
            value,
        }),
        None => Ok(()),
    }
}

/// K(σ)ᵢⱼ = Σ σ A ∇λᵢ·∇λⱼ as conductances -Kᵢⱼ along edges: -∇λᵢ·∇λⱼ A = eᵢ·eⱼ / 4A, both sides leaving the third
/// corner.
fn resistors(mesh: &Mesh) -> Vec<Edge> {
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

fn contact(mesh: &Mesh, electrode: usize, around: &[Vec<usize>]) -> Contact {
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
fn number(mesh: &Mesh, edges: &[Edge], electrodes: &[Contact]) -> Vec<usize> {
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
fn grounds(mesh: &Mesh, on: &[Option<usize>]) -> Vec<usize> {
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
