//! The mathematics: mesh, forward model, sensitivity, reconstructors, model files.

mod forward;
mod jacobian;
mod mesh;
mod mesher;
pub mod preset;
mod sparse;

pub use forward::{Admitted, FLOOR, Fields, Forward, ForwardError};
pub use mesh::{ENOUGH_EDGES, Mesh, MeshError, MeshQuality};
pub use preset::{DiscTank, PaperSheet, Preset};
