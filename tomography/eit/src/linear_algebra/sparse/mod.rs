//! Sparse Cholesky factorisation for meshes: one analysis, one factor per matrix, all right sides solved together.
//!
//! Multifrontal on the tree of a nested dissection (George 1973; Duff and Reid 1983): the unknowns of one part are
//! eliminated together in a dense front, whose remainder (update matrix) is added to the parent front. A front depends
//! only on the entries below it, so if a matrix differs from a factored one in few entries, only the fronts above these
//! are recomputed; the factor has the same bits as one computed afresh. All operations run in a fixed order on one
//! thread.
//!
//! The caller numbers the unknowns in elimination order (see [`dissect`]).

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

/// Errors of a factorisation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum SparseError {
    /// Not enough memory.
    Memory,
    /// A pivot was not positive.
    NotDefinite,
}

#[cfg(test)]
mod tests;
