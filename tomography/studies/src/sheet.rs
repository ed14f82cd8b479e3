//! The model's sheet and protocol.

use eit::Preset;
use imaging::Geometry;
use survey::Protocol;

use crate::failure::{Attempt, Failure};

/// The default sheet on the model's mesh.
pub(crate) fn geometry() -> Result<Geometry, Failure> {
    Geometry::from_preset(&Preset::default()).attempt("the model's sheet")
}

/// The protocol of a ring with this number of electrodes.
pub(crate) fn protocol(electrodes: usize) -> Result<Protocol, Failure> {
    Protocol::sheffield(electrodes).attempt("the protocol")
}
