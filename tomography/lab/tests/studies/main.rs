//! The studies that `tactus-lab` runs: presses, paper, trade-off, stability.

mod paper;
mod presses;
mod stability;
mod tradeoff;
#[path = "../workshop/mod.rs"]
mod workshop;
