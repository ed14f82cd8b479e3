//! Self-test and wear: what is wrong with a rig, said so that a person can act on it.
//!
//! - **probe**: moves relays and reads, over the same seams as a frame, source off and verified afterwards
//! - **judge**: compares what was read with the uniform sheet, and names the electrode or relay at fault
//! - **wear**: how often relays have closed, and when they will have closed too often

mod judge;
mod pauw;
mod probe;
mod report;
mod uniform;
mod wear;

pub(crate) use judge::judge;
pub(crate) use probe::{Asked, ProbeError, Raw, probe};
pub(crate) use report::{Line, Report};
pub(crate) use wear::{Wear, wear};
