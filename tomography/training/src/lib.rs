//! Training sets and the training of models that `eit` evaluates: linear maps, RBF networks and deep networks.
//!
//! It computes and reports progress through closures; the command line, its files and its printing are `lab`'s.
//!
//! - **samples**: cases of Algorithm 1 and their jitter; **dataset**: training sets in files, in shards
//! - **linear**, **rbf**, **deep**: the three kinds of models; **model_cache**: models that are kept for a case
//! - **noise_figure**: what a method makes of noise, by draws
//! - **symmetry**: a training set seen through every symmetry of its sheet

pub mod dataset;
pub mod deep;
pub mod linear;
mod model_cache;
pub mod noise_figure;
pub mod rbf;
pub mod samples;
pub mod symmetry;

pub use model_cache::{Cached, single_current};
pub use samples::TrainError;
