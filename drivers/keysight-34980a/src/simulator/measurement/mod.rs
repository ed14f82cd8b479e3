//! The internal voltmeter and its measurements (fact sheet, section 5). Relays and status are part of the mainframe.

pub(crate) mod computation;
pub(crate) mod deferred;
pub(crate) mod functions;
pub(crate) mod memory;
pub(crate) mod meter;
pub(crate) mod run;
pub(crate) mod setup;
pub(crate) mod temperature;
