//! Training of models that `eit` evaluates: the deep network, and the symmetries of a training set.
//!
//! It computes and reports progress through closures; the command line, its files and its printing are `lab`'s.
//!
//! - **deep**: Adam on the squared error of a map, with checkpoints from which a killed training goes on
//! - **symmetry**: a training set seen through every symmetry of its sheet

pub mod deep;
pub mod symmetry;
