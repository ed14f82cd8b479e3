//! Charts of numbers: curves, and accuracy against time.
//! `image` and `mesh` draw maps and meshes.

pub(crate) mod course;
pub(crate) mod curves;
pub(crate) mod work_precision;
