//! Recorded conversations with instruments, replayed to the simulators for comparison, or converted to golden files.
//! `rig::transcript` defines the file format.

pub(crate) mod golden;
pub(crate) mod playback;
