//! Training of the deep network (section 4.2 of the paper, Eq. 11): Adam on half the squared error of a map.
//!
//! Activations and weights are stored in tiles that fit in the cache (`product`). Each tile is one task: a product with
//! its activation (ELU), or a gradient with its step of Adam, so that the gradient of the whole network is never
//! stored. Neither the tiles nor the bits of the result depend on the number of threads.
//!
//! - **descent**: weights, moments and one step; **product**: the three products of a layer, and their layout
//! - **batch**: samples with their jitter, and the normalisation of the input; **epochs**: epochs, held-out loss, the
//!   best weights; **checkpoint**: a file with the complete state, from which a killed run resumes with the same bits

mod adam;
mod batch;
mod checkpoint;
mod descent;
mod epochs;
mod product;

pub use checkpoint::CheckpointFault;
pub use epochs::{DeepFault, Recipe, TrainingEvent, train};
