//! The stage on which the stories and the demo are played: real programs, real processes, one binary.
//!
//! `cargo run -p` and `cargo test --workspace` build no other package's binary, so the binary of this package can be
//! any of the four programs ([`act_as`]); a [`Stage`] starts it as `tactusd` and speaks to it as `tactus`. Nothing here
//! knows how to reach a frame except through those two.
//!
//! - **stage**: a temporary folder with a configuration, a state directory and a peer socket
//! - **keeper**: the daemon as a child process, ready when it has told so on its notify socket
//!
//! ```no_run
//! let stage = stories::Stage::new(stories::SIMULATED)?;
//! let keeper = stage.start_daemon()?;
//! let status = stage.tactus(&["status", "--json"])?.succeeded()?;
//! println!("{}", status.stdout);
//! keeper.stop()?;
//! # Ok::<(), stories::StageError>(())
//! ```

mod programs;
mod stage;

pub use programs::act_as;
pub use stage::{DEADLINE, Keeper, SIMULATED, Spoken, Stage, StageError};
