//! Training of the deep network (section 4.2 of the paper, Eq. 11): Adam on half the squared error of a map.
//!
//! Activations are kept with the samples of a batch side by side, a row a neuron: the products of a layer, its elu and its
//! step of Adam are then passes over tiles of rows that lie in the cache, each tile one task. Tiles do not depend on the
//! number of threads, so the bits do not either.
//!
//! - **command**: settings from profile, file and flags
//! - **descent**: weights, moments and one step; **product**: the three dense products of a layer
//! - **batch**: samples with their jitter, and the normalisation of the input; **training**: epochs, held-out loss, the best
//!   weights; **checkpoint**: all of it in a file from which a killed run goes on to the same bits

mod adam;
mod batch;
mod checkpoint;
mod command;
mod descent;
mod product;
mod training;

pub(crate) use command::train_deep;
