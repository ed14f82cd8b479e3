//! Diagrams of methods and models: reconstruction, width and precision, training, uncertainty. Left to others: how frames
//! are measured.

pub(super) mod precision;
pub(super) mod reconstruction;
pub(super) mod training;
pub(super) mod uncertainty;
