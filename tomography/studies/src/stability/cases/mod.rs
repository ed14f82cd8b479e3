//! The hard cases by topic. Each function measures a naive implementation and the one of this project ("ours"). The
//! table of all cases is in `stability`, the reference solvers are in `solvers`.

pub(super) mod contacts;
pub(super) mod contrast;
pub(super) mod creep;
pub(super) mod inverse;
pub(super) mod layers;
pub(super) mod loads;
pub(super) mod meshes;
pub(super) mod order;
pub(super) mod radial;
pub(super) mod readings;
pub(super) mod tracked;
