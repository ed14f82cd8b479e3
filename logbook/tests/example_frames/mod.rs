//! Test fixtures: plain frames with given readings, noisy frames like those of a rig, and a session of plain frames.

// each test binary uses only a part of this
#![allow(dead_code)]

pub mod noisy;
pub mod taken;
pub mod written;
