//! Errors of the forward model.

use survey::{Dipole, Electrode};

/// Errors of the forward problem.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ForwardError {
    /// Fewer than two electrodes.
    #[error("the mesh has {electrodes} electrodes; a current needs two")]
    Electrodes {
        /// Electrodes of the mesh.
        electrodes: usize,
    },
    /// Wrong number of contact impedances.
    #[error("{has} contact impedances are given for {wants} electrodes")]
    ContactCount {
        /// Number given.
        has: usize,
        /// Electrodes of the mesh.
        wants: usize,
    },
    /// A contact impedance that is negative or not a number.
    #[error(
        "electrode {electrode}: contact impedance {value} ohm m must be zero or more, and finite"
    )]
    Contact {
        /// The electrode.
        electrode: Electrode,
        /// The value given.
        value: f64,
    },
    /// Wrong number of currents.
    #[error("{has} rows of currents are given for {wants} electrodes")]
    CurrentCount {
        /// Number given.
        has: usize,
        /// Electrodes of the mesh.
        wants: usize,
    },
    /// Wrong number of conductances.
    #[error("{has} conductances are given for {wants} elements")]
    SigmaCount {
        /// Number given.
        has: usize,
        /// Triangles of the mesh.
        wants: usize,
    },
    /// A conductance that is negative or not a number.
    #[error("element {element}: conductance {value} S must be zero or more, and finite")]
    Sigma {
        /// The element, from 0.
        element: usize,
        /// The value given.
        value: f64,
    },
    /// Cells of another mesh.
    #[error("the cells of the parameters are for a mesh of {has} elements, this one has {wants}")]
    Cells {
        /// Elements of the mesh that was cut into cells.
        has: usize,
        /// Elements of this one.
        wants: usize,
    },
    /// Changes fill a layer of the depth, but the method solves for changed conductances over the whole depth.
    #[error(
        "targets are {height_mm} mm high, and this method solves for changes over the full depth: use one-step or tv, \
         or omit the height of the targets"
    )]
    Layer {
        /// Height of the layer, mm.
        height_mm: f64,
    },
    /// All conductances are zero.
    #[error("no element conducts")]
    NoConductance,
    /// The protocol is for another ring.
    #[error("the protocol has {protocol} electrodes, the mesh has {mesh}")]
    Ring {
        /// Electrodes of the protocol.
        protocol: usize,
        /// Electrodes of the mesh.
        mesh: usize,
    },
    /// A drive names an electrode that does not exist, or the same one twice.
    #[error("drive {drive} does not name two of the {electrodes} electrodes")]
    Drive {
        /// The drive.
        drive: Dipole,
        /// Electrodes of the mesh.
        electrodes: usize,
    },
    /// The currents of a pattern do not sum to zero.
    #[error("the currents of pattern {pattern} sum to {sum:e} A; the sum must be zero")]
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
    /// The refinement did not converge.
    #[error(
        "the solution is only known to {achieved:e} of its largest value; conductances are too far apart"
    )]
    NotAccurate {
        /// Last correction relative to the solution.
        achieved: f64,
    },
}
