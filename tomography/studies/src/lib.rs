//! The studies (the paper's experiments, accuracy against computing time, the hard cases and others), and the
//! evaluation of methods on test sets.
//!
//! The crate computes results, writes them to a folder and returns them. The command line and its output are in `lab`.
//! Models and test sets that a study needs are created by commands, through [`Program`].
//!
//! - **paper**: every experiment, figure and claim of the paper; **tradeoff**: error against time, as eight diagrams;
//!   **stability**: the hard cases, each with a naive implementation that fails; **honesty**: quality verdicts of maps
//!   on healthy and faulty frames; **months**: maps while the sheet drifts
//! - **evaluation**: test sets, methods given as command-line options, and figures of merit of their maps

mod artifact_cache;
pub mod evaluation;
mod exit;
mod failure;
pub mod honesty;
mod html;
pub mod months;
pub mod paper;
pub mod progress;
mod readings;
mod sheet;
pub mod stability;
pub mod tradeoff;

pub use artifact_cache::Program;
pub use exit::{EXIT_TABLE, Exit, ExitRow};
pub use failure::{Failure, write};
pub(crate) use failure::{tagged, write_tables};
pub use readings::{add_noise, measured};

/// Seed of draw `draw` of the data that judge methods; differs from `seed`, that of the trainings. Any seed is valid: the
/// product wraps.
pub(crate) fn judging_seed(seed: u64, draw: u64) -> u64 {
    seed.wrapping_add(1).wrapping_mul(1000).wrapping_add(draw)
}

/// The properties of the build on which results depend, in addition to the options of a study.
pub fn build() -> serde_json::Value {
    serde_json::json!({
        "version": env!("CARGO_PKG_VERSION"),
        "build": if cfg!(debug_assertions) { "development" } else { "release" },
    })
}

#[cfg(test)]
mod tests {
    use super::judging_seed;

    #[test]
    fn every_seed_has_other_seeds_for_judging() {
        assert_eq!(judging_seed(4, 3), 5003);
        assert_eq!(judging_seed(u64::MAX, 3), 3);
        assert_ne!(judging_seed(u64::MAX - 1, 3), judging_seed(u64::MAX - 1, 4));
    }
}
