//! The hard cases by topic: each is a function that measures what naive code does and what ours does. Left to others: the
//! table of all cases, and the solvers that they compare with.

pub(super) mod contacts;
pub(super) mod contrast;
pub(super) mod creep;
pub(super) mod inverse;
pub(super) mod layers;
pub(super) mod meshes;
pub(super) mod order;
pub(super) mod radial;
pub(super) mod readings;
