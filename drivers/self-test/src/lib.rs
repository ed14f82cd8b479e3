//! Self-test of a rig: what is wrong with its relays, contacts and voltmeter, in words that a person can act on.
//!
//! - **probe**: moves relays and reads, over the same traits as a frame; it leaves switching off to its caller
//! - **assessment**: compares what was read with the uniform sheet, and names the electrode or relay at fault
//!
//! The crate knows no instrument's model: the wiring comes with the [`survey::Plan`], ranges and bus relays with the
//! [`Request`].

mod assessment;
mod probe;
mod report;
mod uniform_sheet;
mod van_der_pauw;

pub use assessment::assess;
pub use probe::{Lone, Measured, ProbeError, Request, Retry, Row, probe};
pub use report::{Report, ReportLine, Verdict};
pub use uniform_sheet::ExpectedSheet;
