//! The studies: the paper run again, what accuracy costs in time, and the hard cases; with the evaluation of methods on
//! judging data that all of them use.
//!
//! It computes, writes its results to a folder and returns them. The command line and what is printed are `lab`'s; models
//! and judging data that a study needs are made by commands, through [`Program`].
//!
//! - **paper**: every experiment, figure and claim of the paper; **tradeoff**: error against time, as eight diagrams;
//!   **stability**: the hard cases, each with the naive form that breaks
//! - **evaluation**: judging data, a method as words give it, and figures of its maps of them

mod artifact_cache;
pub mod evaluation;
mod failure;
mod html;
pub mod paper;
pub mod progress;
pub mod stability;
pub mod tradeoff;

pub use artifact_cache::Program;
pub use failure::{Failure, write};
