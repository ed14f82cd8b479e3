//! Reconstructors, compared with independent solutions of their stated problems.

mod bounded_maps;
mod deep_models;
mod one_step;
mod priors;
mod small_lambda;
mod solved;
mod tv;
