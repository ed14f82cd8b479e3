//! Dense and sparse linear algebra, and loops for the processor's vector instructions.
//! Nothing here knows meshes or electrodes.

pub(crate) mod dense;
pub(crate) mod processor;
pub(crate) mod simd;
pub(crate) mod sparse;

pub use dense::product;
pub use simd::squared_distance;
