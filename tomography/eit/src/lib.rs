//! The mathematics: mesh, forward model, sensitivity, reconstructors, model files.

mod mesh;
mod mesher;
pub mod preset;

pub use mesh::{ENOUGH_EDGES, Mesh, MeshError, MeshQuality};

pub use preset::{DiscTank, PaperSheet, Preset};
