//! A temporary rig for the demo and the system tests: real programs, each a process of its own, from one binary.
//!
//! `cargo run -p` and `cargo test --workspace` build no other package's binary. Therefore one binary contains all the
//! programs ([`act_as`]); a [`Stage`] starts it as `tactusd` and calls it as `tactus`. Frames are reached only through
//! these two programs.
//!
//! - [`Stage`]: a temporary folder with a configuration, a state directory and a peer socket
//! - [`DaemonProcess`]: the daemon as a child process, ready once it has reported so on its notify socket
//!
//! ```no_run
//! let stage = demo::Stage::new(demo::SIMULATED)?;
//! let daemon = stage.start_daemon()?;
//! let status = stage.tactus(&["status", "--json"])?.succeeded()?;
//! println!("{}", status.stdout);
//! daemon.stop()?;
//! # Ok::<(), demo::StageError>(())
//! ```

mod programs;
mod stage;

pub use programs::act_as;
pub use stage::{DEADLINE, DaemonProcess, SIMULATED, Spoken, Stage, StageError};

/// A scene with 2 uV of voltmeter noise and no other effect.
pub const TWO_MICROVOLTS: &str = include_str!("../rigs/two-microvolts.toml");
