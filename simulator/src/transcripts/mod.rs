//! Recorded conversations with instruments, played to the simulators: compared, or made into golden files.
//! The file format is `rig::transcript`'s.

pub(crate) mod golden;
pub(crate) mod playback;
