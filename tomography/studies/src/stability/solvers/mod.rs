//! Forward solutions for comparison: dense in any number format, by conjugate gradients, and a small tank to solve.
//! The cases measure with them.

pub(super) mod bordered;
pub(super) mod conjugate;
pub(super) mod tank;
