//! Self-test of a rig: finds faults of its relays, contacts and voltmeter, and describes each for the user.
//!
//! - **probe**: moves relays and takes readings, through the same traits as a frame; the caller switches the source off
//! - **assessment**: compares the readings with the uniform sheet, and names the electrode or relay at fault
//!
//! The crate contains no facts of a particular instrument: the wiring comes with the [`survey::Plan`], ranges and bus
//! relays with the [`Request`].

mod assessment;
mod median;
mod neighbours;
mod probe;
mod report;
mod uniform_sheet;
mod van_der_pauw;

pub use assessment::assess;
pub use neighbours::with_neighbours;
pub use probe::{Measured, PartlyClosed, ProbeError, Request, Retry, Row, probe};
pub use report::{CheckOutcome, Report, ReportLine};
pub use uniform_sheet::ExpectedSheet;
