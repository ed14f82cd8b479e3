//! Frames for tests: plain ones around given readings, noisy ones as a rig gives them, and a session of plain ones.
//! The tests' own assertions are in the folders of the test binaries.

// each binary uses what it needs of it
#![allow(dead_code)]

pub mod noisy;
pub mod taken;
pub mod written;
