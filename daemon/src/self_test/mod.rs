//! Self-test and wear: what is wrong with a rig, said so that a person can act on it.
//!
//! - **probe**: moves relays and reads, over the same seams as a frame, source off and verified afterwards
//! - **judge**: compares what was read with the uniform sheet, and names the electrode or relay at fault
//! - **wear**: how often relays have closed, and when they will have closed too often

mod assessment;
mod probe;
mod report;
mod uniform_sheet;
mod van_der_pauw;

pub(crate) use crate::instruments::relay_wear::Wear;
pub(crate) use crate::self_test::assessment::judge;
pub(crate) use crate::self_test::probe::{Asked, ProbeError, Raw, probe};
pub(crate) use crate::self_test::report::{Line, Report};
