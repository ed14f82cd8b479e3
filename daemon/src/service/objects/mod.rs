//! The D-Bus objects, one file for each interface. `access` and `gate` decide who may call them.

pub(crate) mod alarms1;
pub(crate) mod instrument1;
pub(crate) mod manager1;
pub(crate) mod report;
pub(crate) mod session1;
pub(crate) mod simulation1;
