//! Diagrams of the forward model: the size of the mesh, and solvers of the same system.

pub(super) mod forward;
mod iterative;
pub(super) mod solver;
mod system;
