//! Forward solvers for comparison (dense in any number format, conjugate gradients), and the small tank that they
//! solve.

pub(super) mod bordered;
pub(super) mod conjugate;
pub(super) mod tank;
