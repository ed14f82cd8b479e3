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

/// The properties of the build on which results depend, in addition to the options of a study.
pub fn build() -> serde_json::Value {
    serde_json::json!({
        "version": env!("CARGO_PKG_VERSION"),
        "build": if cfg!(debug_assertions) { "development" } else { "release" },
    })
}
