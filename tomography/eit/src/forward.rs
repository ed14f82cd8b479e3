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

mod layout;
mod solution;
mod system;
mod workspace;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use survey::{Dipole, Electrode, Protocol};

use crate::Mesh;
use crate::sparse::{Pattern, Row, SparseError, WIDTH};
use layout::{Contact, Edge, NONE, PAIRS, contact, grounds, number, resistors};
pub(crate) use solution::Solution;
use system::System;
pub use workspace::Workspace;

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
