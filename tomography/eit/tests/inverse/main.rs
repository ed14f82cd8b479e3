//! Reconstructors, held to independent solutions of the problems that they state.

mod bounded_maps;
mod deep_models;
mod one_step;
mod priors;
mod small_lambda;
mod solved;
mod tv;
