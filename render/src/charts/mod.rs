//! Charts of numbers: curves, and accuracy against time.
//! Maps and meshes are drawn elsewhere.

pub(crate) mod curves;
pub(crate) mod work_precision;
