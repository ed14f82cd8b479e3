//! Diagrams of the forward model: the size of the mesh, and ways to solve the same system. Left to others: reconstruction.

pub(super) mod forward;
mod iterative;
pub(super) mod solver;
mod system;
