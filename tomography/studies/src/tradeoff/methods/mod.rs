//! Diagrams of methods and models: reconstruction, width and precision, training, uncertainty.
//! `measuring` compares settings of the measurement.

pub(super) mod precision;
pub(super) mod reconstruction;
pub(super) mod training;
pub(super) mod uncertainty;
