//! Commands on geometries: case folders from presets, forward solutions, sensitivities, transfer matrices.
//! `maps` has the commands on frames and maps.

mod mesh;
mod sheet;
mod solve;

pub(crate) use mesh::{case, mesh, preset, read, with_depth};
pub(crate) use sheet::sheet;
pub(crate) use solve::{forward, jacobian, transfer};
