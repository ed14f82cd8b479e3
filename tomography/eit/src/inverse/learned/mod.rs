//! Trained methods: radial-basis-function network, deep network, linear map, and the distance of a frame to their training.
//! Their files are read and written by `model`.

pub(crate) mod linear;
pub mod network;
pub(crate) mod novelty;
pub(crate) mod rbf;
pub(crate) mod trained;
