//! Charts of numbers: curves, and accuracy against time.

pub(crate) mod curves;
pub(crate) mod work_precision;
