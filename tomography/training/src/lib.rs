//! Training sets and the training of models that `eit` evaluates: linear maps, RBF networks and deep networks.
//!
//! The crate reports progress through closures; the command line, its files and its output are in `lab`.
//!
//! - **samples**: cases of Algorithm 1 and their jitter; **dataset**: training sets in files, in shards
//! - **linear**, **rbf**, **deep**: the three kinds of models; **model_cache**: models cached for a case
//! - **noise_figure**: noise figures of methods, by draws; **own_misfit**: misfit of maps of held-out cases
//! - **symmetry**: a training set extended by the symmetries of its sheet

pub mod dataset;
pub mod deep;
pub mod linear;
mod model_cache;
pub mod noise_figure;
pub mod own_misfit;
pub mod rbf;
pub mod samples;
pub mod symmetry;

pub use model_cache::{Cached, single_current};
pub use samples::TrainError;
