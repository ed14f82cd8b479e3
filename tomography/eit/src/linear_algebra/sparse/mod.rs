//! Sparse Cholesky for meshes: one analysis, a factor for each matrix, all right sides in one sweep.
//!
//! Multifrontal on the tree of a nested dissection (George 1973; Duff and Reid 1983): the unknowns of one part are
//! eliminated together in a dense front, whose remainder is handed to the front above. A front depends on the entries
//! below it alone, so a factor of a matrix that differs in few entries from a known one makes only the fronts above
//! them again, and has the same bits as a factor made from nothing. Everything runs in a fixed order on one thread.
//!
//! Unknowns are numbered in the order of elimination by the caller (see [`dissect`]).

mod aligned;
mod analysis;
mod dissection;
mod elimination;
mod factor;
mod gram;
mod kernel;
mod network;
mod sweep;

pub(crate) use crate::linear_algebra::sparse::analysis::Analysis;
pub(crate) use crate::linear_algebra::sparse::dissection::dissect;
pub(crate) use crate::linear_algebra::sparse::factor::Factor;
pub(crate) use crate::linear_algebra::sparse::gram::gram;
pub(crate) use crate::linear_algebra::sparse::kernel::{MulAdd, Task, widest};
pub(crate) use crate::linear_algebra::sparse::network::Network;
pub(crate) use crate::linear_algebra::sparse::sweep::Block;

/// Why there is no factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SparseError {
    /// The machine has not enough memory.
    Memory,
    /// A pivot was not positive.
    NotDefinite,
}

#[cfg(test)]
mod tests;
