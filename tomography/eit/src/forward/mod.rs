//! The complete electrode model on linear triangles: voltages from conductances.
//!
//! σ `sigma`: sheet conductance of a triangle, siemens per square; u `u`: potential of a node; U `electrode voltage`;
//! z `contact`: contact impedance, ohm m; M: ∫ λᵢ λⱼ over an electrode's edges; b: ∫ λᵢ; |e|: the electrode's length.
//!
//! The unknowns of an electrode depend on its contact (fact sheet, section 1):
//! - z/|e| < Rs: its voltage U and the differences d = u - U on its nodes; z appears only in M/z on d, and U's row is
//!   its balance of currents
//! - otherwise U is eliminated: (M - b bᵀ/|e|)/z on its nodes, and U = (bᵀu + z I)/|e| afterwards
//! - z = 0: d = 0, the electrode is one unknown
//!
//! The sheet is written as resistors along mesh edges, so that a constant potential drives exactly no current; the
//! residuals of the refinement are sums of small currents, not differences of large ones. One mesh node away from the
//! electrodes is grounded. All operations run in a fixed order on one thread.
//!
//! A mesh with a [`Depth`](crate::Depth) is solved for its mean over the depth as above; the other modes are in `depth`.

mod depth;
mod error;
mod layout;
mod ring;
mod scratch;
mod solution;
mod system;
mod transfer;
mod workspace;

use std::borrow::Cow;
use std::sync::{Arc, Mutex};

use nalgebra::{DMatrix, DVector};
use survey::{Dipole, Electrode, Protocol};

use crate::Mesh;
use crate::linear_algebra::sparse::Block;
use depth::Modes;
pub use error::ForwardError;
use layout::Layout;
pub(crate) use ring::arc;
pub(crate) use scratch::Base;
use scratch::Scratch;
pub(crate) use solution::Solution;
pub use workspace::Workspace;

/// Conductance given to a triangle without any, as a share of the largest: it changes voltages by about 1e-9.
pub const FLOOR: f64 = 1e-8;

/// Conductances that the model accepts.
#[derive(Debug, Clone, PartialEq)]
pub struct Admitted<'a> {
    /// One per triangle, all positive, S.
    pub sigma: Cow<'a, [f64]>,
    /// Triangles that had no conductance and were given [`FLOOR`] of the largest.
    pub floored: usize,
}

/// Potentials for a set of drives; the mean over the electrodes is zero. In a tank with a depth, `potentials` are the
/// mean over the depth, and `electrodes` the voltages at the height of the electrodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Fields {
    /// Potential of each node (row) in each drive (column), V at 1 A.
    pub potentials: DMatrix<f64>,
    /// Voltage of each electrode (row) in each drive (column), V at 1 A.
    pub electrodes: DMatrix<f64>,
    /// Triangles without conductance that were raised, see [`FLOOR`].
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
    /// Shared by all models of this mesh.
    layout: Arc<Layout>,
    /// Modes of the tank's depth, if the mesh has one.
    modes: Option<Modes>,
    /// Memory of earlier solutions, for reuse; it never holds a result.
    scratch_pool: Mutex<Vec<Scratch>>,
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
        let layout = mesh.analysis().or_make(|| Layout::new(&mesh))?;
        let mut forward = Self {
            contact: contact_ohm_m.to_vec(),
            layout,
            modes: None,
            scratch_pool: Mutex::new(Vec::new()),
            mesh,
        };
        forward.modes = Modes::new(&forward);
        Ok(forward)
    }

    /// The mesh.
    pub fn mesh(&self) -> &Arc<Mesh> {
        &self.mesh
    }

    /// Contact impedance of each electrode, ohm m.
    pub fn contact_ohm_m(&self) -> &[f64] {
        &self.contact
    }

    /// Changes the contact impedances; the analysis is kept.
    ///
    /// # Errors
    /// Contact impedances that do not fit.
    pub fn set_contact_ohm_m(&mut self, contact_ohm_m: &[f64]) -> Result<(), ForwardError> {
        check_contacts(contact_ohm_m, self.layout.electrodes.len())?;
        self.contact = contact_ohm_m.to_vec();
        Ok(())
    }

    /// Refuses conductances that are negative or not numbers; raises zeros to [`FLOOR`] of the largest.
    ///
    /// # Errors
    /// Wrong count, a value that is negative or not a number (element named), or no value above zero.
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

    /// Potentials for each drive at 1 A, from one factorisation.
    ///
    /// # Errors
    /// Conductances that are refused, or a drive that does not fit.
    pub fn solve(&self, sigma: &[f64], drives: &[Dipole]) -> Result<Fields, ForwardError> {
        self.solve_currents(sigma, &self.currents(drives)?)
    }

    /// Potentials for any currents: one row per electrode, one column per pattern, A; each column sums to zero.
    ///
    /// # Errors
    /// Conductances that are refused, or currents that do not fit or do not sum to zero.
    pub fn solve_currents(
        &self,
        sigma: &[f64],
        currents: &DMatrix<f64>,
    ) -> Result<Fields, ForwardError> {
        let fields = self.with_solution(sigma, currents, |solution| self.fields(&solution))?;
        self.with_depth(fields, sigma, currents)
    }

    /// Adds the voltages of the modes of the depth, if there are any.
    fn with_depth(
        &self,
        mut fields: Fields,
        sigma: &[f64],
        currents: &DMatrix<f64>,
    ) -> Result<Fields, ForwardError> {
        if let Some(voltages) = self.depth_voltages(sigma, currents)? {
            fields.electrodes += voltages;
        }
        Ok(fields)
    }

    /// The readings of a protocol at 1 A, V. For many conductances see [`Forward::workspace`].
    ///
    /// # Errors
    /// Conductances that are refused, or a protocol for another ring.
    pub fn readings(
        &self,
        sigma: &[f64],
        protocol: &Protocol,
    ) -> Result<DVector<f64>, ForwardError> {
        self.check_ring(protocol)?;
        self.borrow_scratch(|scratch| {
            let ring = scratch.ring(self, sigma, None, true)?;
            Ok(ring.readings(self, protocol))
        })
    }

    pub(crate) fn check_ring(&self, protocol: &Protocol) -> Result<(), ForwardError> {
        let mesh = self.layout.electrodes.len();
        if protocol.electrodes() != mesh {
            return Err(ForwardError::Ring {
                protocol: protocol.electrodes(),
                mesh,
            });
        }
        Ok(())
    }

    /// 1 A through each pair: a row per electrode, a column per pair.
    pub(crate) fn currents(&self, drives: &[Dipole]) -> Result<DMatrix<f64>, ForwardError> {
        let electrodes = self.layout.electrodes.len();
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
        Ok(currents)
    }

    /// 1 A through each pair of neighbours, including the last with the first: a row per electrode, a column per pair.
    pub(crate) fn neighbours(&self) -> DMatrix<f64> {
        ring::neighbours(self.layout.electrodes.len())
    }

    /// Solves for some currents and passes the solution to `read`.
    pub(crate) fn with_solution<T>(
        &self,
        sigma: &[f64],
        currents: &DMatrix<f64>,
        read: impl FnOnce(Solution<'_>) -> T,
    ) -> Result<T, ForwardError> {
        let count = self.layout.electrodes.len();
        if currents.nrows() != count {
            return Err(ForwardError::CurrentCount {
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
        self.borrow_scratch(|scratch| {
            scratch
                .solution(self, sigma, currents, None, true)
                .map(read)
        })
    }

    /// The factor of a conductance, for [`Forward::plain_fields`] of others that differ from it in part of the mesh.
    pub(crate) fn factored(&self, sigma: &[f64]) -> Result<Base, ForwardError> {
        Scratch::base(self, sigma)
    }

    /// Potentials relative to the ground node (a row per node, a column per pattern) and voltages of the electrodes, without
    /// the refinement, which takes half the time of [`Forward::solve_currents`].
    pub(crate) fn plain_fields(
        &self,
        sigma: &[f64],
        currents: &DMatrix<f64>,
        base: &Base,
    ) -> Result<(Block, DMatrix<f64>), ForwardError> {
        let (potentials, mut electrodes) = self.borrow_scratch(|scratch| {
            let solution = scratch.solution(self, sigma, currents, Some(base), false)?;
            Ok((self.potentials(&solution), self.electrodes(&solution)))
        })?;
        if let Some(voltages) = self.depth_voltages(sigma, currents)? {
            electrodes += voltages;
        }
        Ok((potentials, electrodes))
    }

    /// Lends memory of an earlier solution, or new memory.
    fn borrow_scratch<T>(
        &self,
        work: impl FnOnce(&mut Scratch) -> Result<T, ForwardError>,
    ) -> Result<T, ForwardError> {
        let left = || {
            self.scratch_pool
                .lock()
                .unwrap_or_else(|broken| broken.into_inner())
        };
        let waiting = left().pop();
        let mut scratch = match waiting {
            Some(scratch) => scratch,
            None => Scratch::new(self)?,
        };
        let result = work(&mut scratch);
        left().push(scratch);
        result
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
