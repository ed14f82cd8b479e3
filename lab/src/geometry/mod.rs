//! Commands on geometries: case folders from presets, models of EIDORS, forward solutions, sensitivities, transfer
//! matrices. The commands on frames and maps are in `maps`.

mod eidors;
mod frames;
mod mesh;
mod sheet;
mod solve;

pub(crate) use frames::{folder, frames, one_current};
pub(crate) use mesh::{case, mesh, preset, read, with_depth};
pub(crate) use sheet::sheet;
pub(crate) use solve::{forward, jacobian, transfer};
