//! Dense and sparse linear algebra, and loops for the processor's vector instructions. Independent of meshes and
//! electrodes.

pub(crate) mod dense;
pub(crate) mod processor;
pub(crate) mod simd;
pub(crate) mod sparse;

pub use dense::{Definite, Rounded, product, symmetric_eigen, times, view};
pub use simd::squared_distance;
