//! Trained methods: radial-basis-function network, deep network, linear map, and the novelty of a frame relative to
//! their training. `model` reads and writes their files.

pub(crate) mod linear;
pub mod network;
pub(crate) mod novelty;
pub(crate) mod rbf;
pub(crate) mod trained;
