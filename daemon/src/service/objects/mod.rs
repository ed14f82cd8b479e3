//! The D-Bus objects, one file an interface.
//! Who may call them is decided by `access` and `gate`.

pub(crate) mod instrument1;
pub(crate) mod manager1;
pub(crate) mod report;
pub(crate) mod session1;
pub(crate) mod simulation1;
